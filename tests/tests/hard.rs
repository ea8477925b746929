//! Geometry that breaks careless code: every value is finite and not negative, and right where it is known.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use glam::{DVec3, Vec3};
use suite::{
    baked::Baked,
    scenes::{closed, hard},
    stats::judge,
    tool,
};

#[track_caller]
fn sane(baked: &Baked) {
    let page = &baked.pages[0];
    for (name, values) in &page.channels {
        let bad = values.iter().enumerate().find(|(_, v)| !v.is_finite() || **v < 0.0);
        assert_eq!(bad, None, "channel {name}");
    }
    assert_eq!(baked.manifest.counts.rejected_samples, 0);
    assert!(page.channels["R"].iter().any(|v| 0.0 < *v), "all black");
}

#[test]
fn instances_keep_their_transforms() {
    let baked = tool::baked(&hard::instances(), &["--samples", "64", "--texels-per-metre", "8"]);
    sane(&baked);
    let surfaces = &baked.manifest.surfaces;
    assert_eq!(surfaces.iter().filter(|s| s.path == "instanced").count(), 3);
    assert_eq!(surfaces.iter().filter_map(|s| s.gpu_instance).collect::<Vec<_>>(), [0, 1, 2]);
    let means = baked.node_means();
    // All of the sky is above every wedge, and nothing but sky and floor is near: an upward slope gets most of it.
    for node in ["plain", "turned", "scaled", "stretched", "mirrored"] {
        let mean = means[node][0].max_element();
        assert!(0.3 < mean && mean < 1.0, "{node}: {mean}");
    }
    // A mirrored wedge is the plain one seen in a mirror: its light comes to the same.
    let off = (means["mirrored"][0] - means["turned"][0]).abs().max_element();
    assert!(off < 0.15, "{:?} and {:?}", means["mirrored"], means["turned"]);
}

#[test]
fn degenerate_triangles_leave_the_rest_as_it_is() {
    let baked = tool::baked(&hard::degenerate(), &["--samples", "64", "--texels-per-metre", "16"]);
    sane(&baked);
    let largest = |t: &suite::baked::Triangle| {
        let [a, b, c] = t.uvs;
        (b - a).perp_dot(c - a).abs()
    };
    assert!(baked.triangles.iter().any(|t| 0.0 < largest(t)));
    // The quad faces up and nothing hides the sky from it.
    let up = |p: &suite::baked::Piece| p.points.iter().all(|q| 0.99 < q.1.y);
    let cases = baked.cases(up, |_, _| DVec3::ONE);
    assert!(3 * 100 < cases.len(), "{} values", cases.len());
    judge(&cases, 1e-3).unwrap();
}

#[test]
fn duplicate_surfaces_do_not_shadow_each_other() {
    let baked = tool::baked(&hard::duplicates(), &["--samples", "64", "--texels-per-metre", "16"]);
    sane(&baked);
    for node in ["first", "second"] {
        let cases = baked.cases(
            |p| p.node == node,
            |p, n| {
                let to = DVec3::Y - p;
                DVec3::splat(to.dot(n) / to.length().powi(3) / std::f64::consts::PI)
            },
        );
        assert!(3 * 200 < cases.len(), "{node}");
        judge(&cases, 1e-3).unwrap_or_else(|e| panic!("{node}: {e}"));
    }
}

#[test]
fn size_and_place_do_not_matter() {
    let bake = |size: f32, offset: Vec3| {
        let density = (24.0 / size).to_string();
        let args = ["--samples", "128", "--texels-per-metre", &density];
        let baked = tool::baked(&hard::sized(size, offset), &args);
        sane(&baked);
        baked.node_means()
    };
    let one = bake(1.0, Vec3::ZERO);
    let far = Vec3::new(1e5, 0.0, -1e5);
    for (size, offset) in [(1e-3, Vec3::ZERO), (1e5, Vec3::ZERO), (16.0, far)] {
        let other = bake(size, offset);
        for (node, [mean, error]) in &one {
            let [mean_2, error_2] = other[node];
            for c in 0..3 {
                let allowed = 0.01 * mean[c] + 5.0 * error[c].hypot(error_2[c]);
                let off = (mean[c] - mean_2[c]).abs();
                assert!(off <= allowed, "{size} m at {offset}: {node}: {mean} and {mean_2}");
            }
        }
    }
}

#[test]
fn a_textured_lamp_gives_half_the_light_of_a_plain_one() {
    let bake = |textured| {
        let args = ["--samples", "256", "--texels-per-metre", "5", "--bounces", "0"];
        let baked = tool::baked(&closed::quad_lamp(0.5, 8.0, textured), &args);
        sane(&baked);
        baked.node_means()["walls"]
    };
    let ([plain, e], [half, e_2]) = (bake(false), bake(true));
    // The two halves see the symmetric room alike; the image is interpolated across its middle, evenly.
    for c in 0..3 {
        let off = (plain[c] - 2.0 * half[c]).abs();
        assert!(off <= 5e-3 * plain[c] + 5.0 * e[c].hypot(2.0 * e_2[c]), "{plain} and {half}");
    }
}

/// Light 2^90 times as bright gives texels 2^90 times as bright to the bit, and figures that are finite.
#[test]
fn absurdly_bright_light_keeps_its_figures() {
    let bake = |bright: f32, samples: &[&str]| {
        let room = closed::Room { radiance: bright, candela: bright, lux: bright, ..closed::Room::default() };
        let args = ["--texels-per-metre", "6", "--denoise", "final", "--directional"];
        tool::baked(&closed::room(room), &[&args, samples].concat())
    };
    for samples in [["--samples", "8"], ["--quality", "draft"]] {
        let (one, many) = (bake(1.0, &samples), bake(2f32.powi(90), &samples));
        same(&one, &many);
    }
}

#[track_caller]
fn same(one: &Baked, many: &Baked) {
    let [a, b] = [one, many].map(|b| b.manifest.error.relative.unwrap());
    assert!((a / b - 1.0).abs() < 1e-6, "{a} {b}");
    for name in ["R", "noisy.G", "sh1.y.B"] {
        let [a, b] = [one, many].map(|b| &b.pages[0].channels[name]);
        for (a, b) in a.iter().zip(b) {
            assert_eq!((a * 2f32.powi(90)).to_bits(), b.to_bits(), "{name}: {a} {b}");
        }
    }
}

/// Whether light reaches the inside of a body is asked for its charts, not for every texel, whose paths would not end in there: 20,000 rays each.
#[test]
fn a_white_body_that_no_light_enters_takes_few_rays() {
    let dir = tool::folder_with(&hard::white_box());
    let args =
        ["run", "scene.glb", "-o", "out", "--samples", "8", "--texels-per-metre", "64", "--probes", "off"];
    let _ = tool::bake(&args, dir.path()).expect(0);
    let out = dir.path().join("out");
    let timings: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("timings.json")).unwrap()).unwrap();
    let texels: u64 = Baked::read(&out).unwrap().manifest.pages.iter().map(|p| p.covered_texels).sum();
    let each = timings["rays"].as_f64().unwrap() / texels as f64;
    assert!(20_000 < texels && 8.0 < each && each < 200.0, "{each} rays for each of {texels} texels");
}
