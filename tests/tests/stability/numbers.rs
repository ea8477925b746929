//! Numbers that leave: half floats, windows of probes, and the gate.

use crate::Group;
use crate::whole::{bake, off};
use glam::Vec3;
use std::f32::consts::PI;
use suite::scenes::{closed, open};
use suite::tool;
use tables::probes::{Basis, Light, ProbeVolume, least_window};

pub(crate) fn group() -> Group {
    let mut group = Group::new("numbers");
    halves(&mut group);
    windows(&mut group);
    gate(&mut group);
    group
}

fn halves(group: &mut Group) {
    for (nits, clamped) in [(65_000.0f32, false), (66_000.0, true), (1e30, true)] {
        for texture in ["rgba16f", "bc6h"] {
            group.add(
                format!("{nits:e} nits as {texture}: clamped values that are not counted"),
                0.0,
                move || {
                    let scene = open::under_sun(nits * PI, Vec3::NEG_Y, 0.0);
                    let args = [
                        "--samples",
                        "1",
                        "--texels-per-metre",
                        "2",
                        "--probes",
                        "off",
                        "--texture",
                        texture,
                    ];
                    let baked = tool::baked(&scene, &args);
                    let page = &baked.pages[0];
                    let beyond = |c: &str| page.channels[c].iter().filter(|v| 65_504.0 < **v).count();
                    let want = ["R", "G", "B"].map(beyond).into_iter().sum::<usize>();
                    let counted = baked.manifest.counts.half_overflows;
                    // What clamping leaves is the greatest half float, in gutters as well.
                    let lit = (want != 0) == clamped;
                    if lit { (counted as f64 - want as f64).abs() } else { f64::INFINITY }
                },
            );
        }
    }
}

/// Normals all over the sphere.
fn normals() -> impl Iterator<Item = [f32; 3]> {
    (0..2000u16).map(|i| {
        let z = 1.0 - (2.0 * f32::from(i) + 1.0) / 2000.0;
        let (sin, cos) = (f32::from(i) * 2.399_963).sin_cos();
        let r = (1.0 - z * z).sqrt();
        [r * cos, r * sin, z]
    })
}

/// Least irradiance over all normals and channels, as a part of the mean.
fn least(light: &Light) -> f64 {
    let least = normals().flat_map(|n| light.irradiance(n)).fold(f32::INFINITY, f32::min);
    f64::from(least / (light.coefficients()[0][0] * 0.282_094_8))
}

/// A sharp light from one side.
fn beam(basis: Basis, strength: f32) -> Light {
    let y: [f32; 16] = tables::harmonics::real::first([0.6, 0.64, 0.48]);
    Light::project(basis, &y.map(|y| [strength * y, 0.5 * strength * y, 0.0]))
}

fn windows(group: &mut Group) {
    for basis in Basis::ALL {
        group.add(format!("a beam in {}: how far irradiance is below 0", basis.name()), 1e-6, move || {
            let light = beam(basis, 1.0);
            let (w, windowed) = least_window(&light);
            let bad = least(&light) < -1e-4 && w <= 0.0;
            if bad { f64::INFINITY } else { (-least(&windowed)).max(0.0) }
        });
    }
    for basis in [Basis::L1, Basis::L2] {
        group.add(format!("a beam in {}: the window is the least", basis.name()), 2e-2, move || {
            let (_, windowed) = least_window(&beam(basis, 1.0));
            // With the least window that helps, the darkest normal has no light at all.
            least(&windowed).abs()
        });
    }
    for strength in [1e-30f32, 1e30] {
        group.add(format!("a beam of {strength:e} nits has the window of one of 1"), 1e-5, move || {
            let (one, other) =
                (least_window(&beam(Basis::L2, 1.0)).0, least_window(&beam(Basis::L2, strength)).0);
            off(f64::from(other), f64::from(one))
        });
    }
    group.add("even light and darkness need no window", 0.0, || {
        let even = Light::new(Basis::L2, &[[1.0; 3]]);
        let all = [even, Light::black(Basis::L2), Light::black(Basis::Zh3)];
        let worst =
            all.map(|l| if least_window(&l).1 == l { f64::from(least_window(&l).0) } else { f64::INFINITY });
        worst.into_iter().fold(0.0, f64::max)
    });
    group.add("probes of a room with a bright panel: how far irradiance is below 0", 1e-5, || {
        let args = ["--samples", "1", "--texels-per-metre", "1", "--texture", "none", "--probe-count", "64"];
        let baked = tool::baked(&closed::panel(true), &args);
        let volume = ProbeVolume::from_bytes(&baked.files["probes.bin"]).expect("probes");
        let lit = volume.probes.iter().filter(|p| 0.0 < p.light.coefficients()[0][0]);
        let worst: Vec<f64> = lit.map(|p| -least(&p.light)).collect();
        if worst.is_empty() { f64::INFINITY } else { worst.into_iter().fold(0.0, f64::max) }
    });
}

fn gate(group: &mut Group) {
    group.add("a lamp of 1e38 cd a millimetre over a floor: values that are not finite", 0.0, || {
        let baked = bake(&open::under_point(1e-3, [1e38; 3]), &["--samples", "4", "--texels-per-metre", "8"]);
        let values = baked.pages[0].channels.values().flatten();
        let bad = values.filter(|v| !v.is_finite()).count();
        // And what was left out is counted.
        if baked.manifest.counts.rejected_samples == 0 { f64::INFINITY } else { bad as f64 }
    });
    group.add("the same beside a lamp of 1 cd in haze, bounded", 0.0, || {
        let args = ["--samples", "4", "--texels-per-metre", "4", "--media", "bounded", "--grid-nodes", "64"];
        let baked = crate::whole::bake_in(&open::under_point(1e-3, [1e38; 3]), "{ sigma_s = 0.5 }", &args);
        baked.pages[0].channels.values().flatten().filter(|v| !v.is_finite()).count() as f64
    });
}
