//! Bakes whose result is known in closed form, at every texel.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use suite::{
    baked::{Baked, Piece},
    scenes::{closed, open},
    stats::{Case, judge},
    tool,
};

/// Bias allowed on top of noise.
const RELATIVE: f64 = 1e-3;

#[track_caller]
fn check(what: &str, cases: &[Case], at_least: usize) {
    assert!(at_least <= cases.len(), "{what}: only {} values", cases.len());
    if let Err(e) = judge(cases, RELATIVE) {
        panic!("{what}: {e}");
    }
}

fn any(_: &Piece) -> bool {
    true
}

#[track_caller]
fn check_all(what: &str, baked: &Baked, exact: impl Fn(DVec3, DVec3) -> DVec3) {
    check(what, &baked.cases(any, exact), 3 * 200);
}

#[test]
fn furnace_is_one_over_one_minus_rho() {
    // Long paths have a skewed distribution, which takes more of them to become normal.
    for (rho, samples) in [(0.0f32, "64"), (0.5, "256"), (0.9, "1024")] {
        let want = 1.0 / (1.0 - f64::from(rho));
        let args = ["--samples", samples, "--texels-per-metre", "6"];
        let baked = tool::baked(&closed::furnace(rho, 1.0), &args);
        check_all(&format!("furnace, rho {rho}"), &baked, |_, _| DVec3::splat(want));
        let baked = tool::baked(&closed::round_furnace(rho, 1.0), &args);
        check_all(&format!("round furnace, rho {rho}"), &baked, |_, _| DVec3::splat(want));
    }
}

#[test]
fn furnace_with_few_bounces_is_a_finite_series() {
    for bounces in [0i32, 1, 3] {
        let rho = 0.5f64;
        let want = (1.0 - rho.powi(bounces + 1)) / (1.0 - rho);
        let n = bounces.to_string();
        let args = ["--samples", "256", "--texels-per-metre", "6", "--bounces", &n];
        let baked = tool::baked(&closed::furnace(0.5, 1.0), &args);
        check_all(&format!("furnace, {bounces} bounces"), &baked, |_, _| DVec3::splat(want));
    }
}

#[test]
fn an_open_plane_shows_the_sky() {
    let baked = tool::baked(
        &open::under_sky(3.0, 4, [0.25, 1.0, 3.0]),
        &["--samples", "64", "--texels-per-metre", "5"],
    );
    check_all("uniform sky", &baked, |_, _| DVec3::new(0.25, 1.0, 3.0));
    let baked = tool::baked(
        &open::under_gradient(3.0, [0.75, 1.5, 3.0]),
        &["--samples", "256", "--texels-per-metre", "5"],
    );
    check_all("gradient sky", &baked, |_, _| DVec3::new(0.5, 1.0, 2.0));
}

#[test]
fn point_lamp_over_a_plane_falls_with_the_cosine_and_the_square() {
    for height in [0.5f32, 2.0] {
        let candela = [100.0f32, 50.0, 25.0];
        let baked = tool::baked(
            &open::under_point(height, candela),
            &["--samples", "256", "--texels-per-metre", "8"],
        );
        check_all(&format!("lamp at {height} m"), &baked, |p, n| {
            let to = DVec3::new(0.0, f64::from(height), 0.0) - p;
            let d2 = to.length_squared();
            Vec3::from(candela).as_dvec3() * (to.dot(n) / d2.sqrt() / d2 / PI)
        });
    }
}

#[test]
fn spot_falls_off_between_its_cones() {
    let (inner, outer) = (0.4f32, 0.9f32);
    let baked = tool::baked(
        &open::under_spot(1.0, 100.0, inner, outer),
        &["--samples", "256", "--texels-per-metre", "8"],
    );
    let (ci, co) = (f64::from(inner).cos(), f64::from(outer).cos());
    check_all("spot", &baked, |p, n| {
        let to = DVec3::Y - p;
        let d2 = to.length_squared();
        let cos = to.dot(n) / d2.sqrt();
        let window = ((cos - co) / (ci - co)).clamp(0.0, 1.0).powi(2);
        DVec3::splat(100.0 * window * cos / d2 / PI)
    });
}

#[test]
fn sun_on_a_plane_is_lux_times_cosine() {
    let direction = Vec3::new(0.3, -1.0, 0.4);
    let cos = f64::from(-direction.normalize().y);
    for diameter in [0.0, 0.53, 5.0] {
        let scene = open::under_sun(1000.0, direction, diameter);
        let baked = tool::baked(&scene, &["--samples", "64", "--texels-per-metre", "5"]);
        check_all(&format!("sun of {diameter} degrees"), &baked, |_, _| DVec3::splat(1000.0 * cos / PI));
    }
}

/// Whether the whole piece keeps `margin` metres from every line of a grid of `cell` metres, along X and Z.
fn off_grid(piece: &Piece, cell: f64, margin: f64) -> bool {
    let index = |v: f64| (v / cell).floor();
    let first = piece.points[0].0;
    piece.points.iter().all(|(p, _, _)| {
        [(p.x, first.x), (p.z, first.z)].into_iter().all(|(v, first)| {
            let from = v - index(v) * cell;
            index(v) == index(first) && margin < from && from < cell - margin
        })
    })
}

#[test]
fn a_masked_pane_lets_the_sun_through_its_holes() {
    let cells = 4;
    let baked = tool::baked(&open::masked_pane(cells), &["--samples", "16", "--texels-per-metre", "16"]);
    let cell = 2.0 / f64::from(cells);
    let cases = baked.cases(
        // One texel of the page and half a texel of the mask.
        |piece| off_grid(piece, cell, 1.0 / 16.0 + cell / 32.0),
        |p, _| {
            // The image's first row and column is at -X, -Z: the pane's top left corner.
            let (x, z) = ((p.x + 1.0) / cell, (p.z + 1.0) / cell);
            let on_pane = p.x.abs() < 1.0 && p.z.abs() < 1.0;
            let opaque = (x.floor() + z.floor()).rem_euclid(2.0) == 0.0;
            DVec3::splat(if on_pane && opaque { 0.0 } else { 1.0 })
        },
    );
    check("masked pane", &cases, 3 * 500);
    assert!(cases.iter().any(|c| c.want == 0.0) && cases.iter().any(|c| c.want == 1.0));
}

#[test]
fn glass_tints_what_passes() {
    let baked = tool::baked(
        &open::glass_pane(0.75, [1.0, 0.5, 0.25]),
        &["--samples", "64", "--texels-per-metre", "8"],
    );
    let cases = baked.cases(
        |piece| off_grid(piece, 1.0, 1.0 / 8.0),
        |p, _| {
            let below = p.x.abs() < 1.0 && p.z.abs() < 1.0;
            if below { 0.75 * DVec3::new(1.0, 0.5, 0.25) } else { DVec3::ONE }
        },
    );
    check("glass pane", &cases, 3 * 200);
}

/// Writes a configuration with media and gives its path.
fn fog(dir: &tempfile::TempDir, media: &str) -> String {
    let path = dir.path().join("fog.toml");
    std::fs::write(&path, format!("media = [{media}]\n")).expect("a file");
    path.to_string_lossy().into_owned()
}

/// Fog that only scatters changes nothing in a furnace, however dense and whichever way it scatters.
#[test]
fn furnace_with_fog_is_a_furnace() {
    let dir = tempfile::tempdir().expect("a folder");
    for (sigma, g) in [("0.3", "0"), ("[0.1, 1, 5]", "0.8"), ("2", "-0.5")] {
        let config = fog(&dir, &format!("{{ sigma_s = {sigma}, g = {g} }}"));
        let args =
            ["--samples", "256", "--texels-per-metre", "4", "--media", "reference", "--config", &config];
        let baked = tool::baked(&closed::furnace(0.5, 1.0), &args);
        let what = format!("furnace with fog of {sigma}, g {g}");
        check(&what, &baked.cases(any, |_, _| DVec3::splat(2.0)), 3 * 90);
    }
}

/// A slab that absorbs weakens a sun by exp(-sigma length), in closed form and by unbiased paths alike.
#[test]
fn absorbing_slab_weakens_the_sun() {
    let dir = tempfile::tempdir().expect("a folder");
    let medium = "{ sigma_a = [0.25, 1, 4], box = { min = [-99, 0.5, -99], max = [99, 1, 99] } }";
    let config = fog(&dir, medium);
    let direction = Vec3::new(0.3, -1.0, 0.4).normalize();
    let cos = f64::from(-direction.y);
    let want = DVec3::new(0.25, 1.0, 4.0).to_array().map(|s| 1000.0 * cos / PI * (-s * 0.5 / cos).exp());
    for mode in ["attenuate", "reference"] {
        let args = ["--samples", "16", "--texels-per-metre", "5", "--media", mode, "--config", &config];
        let baked = tool::baked(&open::under_sun(1000.0, direction, 0.0), &args);
        check_all(&format!("slab, {mode}"), &baked, |_, _| DVec3::from(want));
    }
}

/// Fog that thins out with height, under a sun: the integral to the sky in closed form, and of all light that unbiased paths
/// scatter nothing is lost in a furnace.
#[test]
fn height_fog_weakens_the_sun_and_keeps_a_furnace() {
    let dir = tempfile::tempdir().expect("a folder");
    let medium = "{ sigma_a = [0.1, 0.3, 1], density = { height = { base = 0.5, falloff = 2 } } }";
    let config = fog(&dir, medium);
    let direction = Vec3::new(0.3, -1.0, 0.4).normalize();
    let cos = f64::from(-direction.y);
    // From the floor at y = 0 upwards.
    let metres = 2.0 * 0.25f64.exp() / cos;
    let want = [0.1, 0.3, 1.0].map(|s| 1000.0 * cos / PI * (-s * metres).exp());
    for mode in ["attenuate", "reference"] {
        let args = ["--samples", "16", "--texels-per-metre", "5", "--media", mode, "--config", &config];
        let baked = tool::baked(&open::under_sun(1000.0, direction, 0.0), &args);
        check_all(&format!("height fog, {mode}"), &baked, |_, _| DVec3::from(want));
    }
    let config = fog(&dir, "{ sigma_s = [0.5, 1, 2], g = 0.3, density = { height = { falloff = 0.5 } } }");
    let args = ["--samples", "256", "--texels-per-metre", "4", "--media", "reference", "--config", &config];
    let baked = tool::baked(&closed::furnace(0.5, 1.0), &args);
    check("furnace with height fog", &baked.cases(any, |_, _| DVec3::splat(2.0)), 3 * 90);
}

/// Fog of every kind that varies from place to place, alone and one in the other, loses and adds nothing in a furnace.
#[test]
fn furnace_with_clouds_is_a_furnace() {
    let dir = tempfile::tempdir().expect("a folder");
    let space = "box = { min = [-2, -2, -2], max = [2, 2, 2] }";
    let noise = format!(
        "{{ sigma_s = [0.5, 2, 4], g = 0.4, {space}, density = {{ noise = {{ scale = 0.7, resolution = 24 }} }} }}"
    );
    let stencil = format!(
        "{{ sigma_s = [3, 1, 0.2], g = -0.3, {space}, density = {{ stencil = {{ size = [2, 1, 2], values = [0, 1, 0.5, 2] }} }} }}"
    );
    let haze = "{ sigma_s = 0.3, density = { height = { base = 0, falloff = 1 } } }";
    for (what, media) in [("noise", noise.clone()), ("all together", format!("{noise}, {stencil}, {haze}"))] {
        let config = fog(&dir, &media);
        let args =
            ["--samples", "256", "--texels-per-metre", "4", "--media", "reference", "--config", &config];
        let baked = tool::baked(&closed::furnace(0.5, 1.0), &args);
        check(&format!("furnace, {what}"), &baked.cases(any, |_, _| DVec3::splat(2.0)), 3 * 90);
    }
}

/// Slabs that absorb, as a stencil, as a file of bare numbers, and around a hole, weaken a sun as their depths say.
#[test]
fn absorbing_grids_weaken_the_sun() {
    let dir = tempfile::tempdir().expect("a folder");
    // Two layers: 1 below, 3 above.
    std::fs::write(dir.path().join("layers.raw"), [1.0f32, 3.0].map(f32::to_le_bytes).concat())
        .expect("a file");
    let space = "box = { min = [-99, 0.5, -99], max = [99, 1, 99] }";
    let direction = Vec3::new(0.3, -1.0, 0.4).normalize();
    let cos = f64::from(-direction.y);
    let want =
        DVec3::new(0.25, 1.0, 4.0).to_array().map(|s| 1000.0 * cos / PI * (-s * 0.5 * 2.0 / cos).exp());
    for density in [
        "{ stencil = { size = [1, 2, 1], values = [1, 3] } }",
        "{ raw = \"layers.raw\", size = [1, 2, 1], format = \"f32\" }",
    ] {
        let config = fog(&dir, &format!("{{ sigma_a = [0.25, 1, 4], {space}, density = {density} }}"));
        for mode in ["attenuate", "table", "reference"] {
            let args = ["--samples", "16", "--texels-per-metre", "5", "--media", mode, "--config", &config];
            let baked = tool::baked(&open::under_sun(1000.0, direction, 0.0), &args);
            check_all(&format!("{density}, {mode}"), &baked, |_, _| DVec3::from(want));
        }
    }
}
