//! Light probes as a game looks them up: furnaces, skies, lamps, walls, and the files that engines take.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use glam::Vec3;
use half::f16;
use serde_json::json;
use std::f32::consts::PI;
use std::io::Read as _;
use suite::baked::Baked;
use suite::gltf::{Glb, Kind, Material, Node};
use suite::scenes::closed::{self, Room, room};
use suite::scenes::open;
use suite::shape::Shape;
use suite::tool;
use tables::harmonics::real;
use tables::probes::{Basis, Light, MOST_COEFFICIENTS, ProbeVolume};

/// What bakes take whose lightmaps nobody looks at.
const COARSE: [&str; 4] = ["--samples", "1", "--texels-per-metre", "2"];

fn volume(baked: &Baked) -> ProbeVolume {
    let m = &baked.manifest.probes[0];
    let v = ProbeVolume::from_bytes(&baked.files[&m.file]).expect("a probe file");
    assert_eq!((m.probes, m.bricks, m.basis.as_str()), (v.probes.len(), v.bricks.len(), v.basis.name()));
    v
}

fn baked(scene: &[u8], args: &[&str]) -> ProbeVolume {
    volume(&tool::baked(scene, &[&COARSE[..], args].concat()))
}

fn baked_in(scene: &[u8], medium: &str, args: &[&str]) -> ProbeVolume {
    volume(&tool::baked_in(scene, medium, &[&COARSE[..], args].concat()))
}

/// Nothing comes from one side more than from another: coefficient 0 is sqrt(4 pi) times emission / (1 - albedo), the others are 0, with and without
/// a medium that takes nothing.
#[test]
fn a_white_furnace_has_coefficient_0_alone() {
    let scene = closed::furnace(0.5, 1.0);
    let want = 2.0 * (4.0 * PI).sqrt();
    let args = ["--probes", "l3", "--probe-count", "200", "--probe-samples", "256"];
    let fog = "{ sigma_s = 2, g = 0.5 }";
    for (what, v) in [
        ("air", baked(&scene, &args)),
        ("air, reference", baked(&scene, &[&args[..], &["--media", "reference"]].concat())),
        ("fog, bounded", baked_in(&scene, fog, &args)),
        ("fog, reference", baked_in(&scene, fog, &[&args[..], &["--media", "reference"]].concat())),
    ] {
        let inside = |p: &[f32; 3]| p.iter().all(|x| x.abs() < 0.5);
        let probes: Vec<_> = v.probes.iter().filter(|p| inside(&p.position)).collect();
        assert!(30 < probes.len(), "{what}: {} probes", probes.len());
        let mut means = [0.0f32; MOST_COEFFICIENTS];
        let (mut worst, mut rest) = (0.0f32, 0.0f32);
        for p in &probes {
            let c = p.light.coefficients();
            for (m, c) in means.iter_mut().zip(c) {
                *m += c[1] / probes.len() as f32;
            }
            worst = worst.max((c[0][1] / want - 1.0).abs());
            rest = c[1..].iter().fold(rest, |m, c| m.max(c[1].abs() / want));
        }
        let other = means[1..].iter().fold(0.0f32, |m, c| m.max(c.abs() / want));
        println!(
            "{what}: {} probes, mean {:+.3} %, worst {:.2} %, other coefficients mean {:.3} %, worst {:.2} %",
            probes.len(),
            100.0 * (means[0] / want - 1.0),
            100.0 * worst,
            100.0 * other,
            100.0 * rest
        );
        assert!((means[0] / want - 1.0).abs() < 0.01, "{what}");
        assert!(other < 0.015 && worst < 0.15 && rest < 0.15, "{what}");
    }
}

/// A black plane hides the lower half of a sky of 1 nit: the coefficients of a hemisphere, 2 pi y_l0 integrated over the cosine.
#[test]
fn half_a_sky_by_bands() {
    let mut glb = Glb::new();
    let mut s = Shape::default();
    s.grid(Vec3::new(-500.0, 0.0, 500.0), Vec3::X * 1000.0, Vec3::NEG_Z * 1000.0, 1, 1);
    let black = glb.material(&Material::matte("black", [0.0; 3]));
    let mesh = glb.mesh("plane", &[(&s, black)]);
    glb.node(Node::new("plane").mesh(mesh));
    glb.scene_extra("sky", json!([1, 1, 1]));
    let corner = json!({"min": [-1, 0.5, -1], "max": [1, 2.5, 1]});
    glb.scene_extra("probes", json!([{"box": corner, "spacing": 0.5}]));
    let args = ["--samples", "1", "--texels-per-metre", "0.01", "--probes", "l3", "--probe-samples", "4096"];
    let v = volume(&tool::baked(&glb.finish(), &args));
    assert_eq!(v.probes.len(), 125);
    // About +y: 1/2 sqrt(4 pi), sqrt(3 pi) / 2, 0, and for band 3 -sqrt(7 pi) / 8.
    let zonal = [PI.sqrt(), (3.0 * PI).sqrt() / 2.0, 0.0, -(7.0 * PI).sqrt() / 8.0];
    let y: [f32; MOST_COEFFICIENTS] = real::first([0.0, 1.0, 0.0]);
    let mut worst = [0.0f32; 4];
    for p in &v.probes {
        for (i, c) in p.light.coefficients().iter().enumerate() {
            let l = i.isqrt();
            let want = zonal[l] * y[i] * (4.0 * PI / (2 * l + 1) as f32).sqrt();
            worst[l] = worst[l].max((c[0] - want).abs());
        }
    }
    let relative = worst.map(|w| w / PI.sqrt());
    println!("worst of 125 probes by band, parts of coefficient 0: {relative:?}");
    assert!(relative.iter().all(|w| *w < 0.01), "{relative:?}");
}

/// A lamp alone: I / d^2 times the harmonics of its direction, band by band, and what a medium that scatters nothing leaves of it.
#[test]
fn a_lamp_by_bands() {
    for sigma in [0.0f32, 0.5] {
        let fog = json!({ "sigma_s": 0, "sigma_a": sigma });
        let scene = open::lamp_in_fog(1.0, 100.0, &fog);
        let probes = "probes = [{ box = { min = [0.5, -1, -1], max = [2.5, 1, 1] }, spacing = 0.5 }]\n";
        let dir = tempfile::tempdir().expect("a folder");
        let config = dir.path().join("probes.toml");
        std::fs::write(&config, probes).expect("a file");
        let config = config.to_str().expect("a path");
        let v = baked(&scene, &["--probes", "l3", "--config", config, "--probe-samples", "16"]);
        assert_eq!(v.probes.len(), 125);
        for p in &v.probes {
            let to = Vec3::new(0.0, 1.0, 0.0) - Vec3::from(p.position);
            let d = to.length();
            let lux = 100.0 * (-sigma * d).exp() / (d * d);
            let y: [f32; MOST_COEFFICIENTS] = real::first((to / d).to_array());
            // A lamp alone rings, and is windowed so that no irradiance is negative.
            assert!(0.0 < p.window, "{p:?}");
            let band = |l: f32| 1.0 / (1.0 + p.window * (l * (l + 1.0)).powi(2));
            for (i, c) in p.light.coefficients().iter().enumerate() {
                let want = lux * y[i] * band(i.isqrt() as f32);
                assert!((c[1] - want).abs() < 2e-4 * lux, "sigma {sigma}, {i}: {} {want}", c[1]);
            }
            let back = p.light.irradiance((-to / d).to_array())[1];
            assert!((-1e-5..0.01).contains(&(back / lux)), "{back} of {lux} lux from behind");
        }
    }
}

/// Shorter bases hold the same light: L1 the first four coefficients of L2, ZH3 these and of band 2 the part about the axis.
#[test]
fn bases_hold_the_same_light() {
    let scene = room(Room::default());
    let of =
        |basis: &str| baked(&scene, &["--probes", basis, "--probe-count", "200", "--probe-samples", "64"]);
    let [l1, l2, l3, zh3] = ["l1", "l2", "l3", "zh3"].map(of);
    let mut compared = 0;
    for (((a, b), c), z) in l1.probes.iter().zip(&l2.probes).zip(&l3.probes).zip(&zh3.probes) {
        if [a, b, c, z].iter().any(|p| 0.0 < p.window) {
            continue;
        }
        compared += 1;
        assert_eq!(a.light.coefficients(), &b.light.coefficients()[..4]);
        assert_eq!(b.light.coefficients(), &c.light.coefficients()[..9]);
        let mut full = [[0.0; 3]; MOST_COEFFICIENTS];
        full[..9].copy_from_slice(b.light.coefficients());
        assert_eq!(z.light, Light::project(Basis::Zh3, &full));
    }
    println!("{compared} of {} probes of a room need no window", l2.probes.len());
    assert!(20 < compared);
    for p in [&l1, &l2, &l3, &zh3].into_iter().flat_map(|v| &v.probes) {
        for i in 0..200 {
            let z = 1.0 - (i as f32 + 0.5) / 100.0;
            let (s, c) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let least = p.light.irradiance([r * c, r * s, z]).into_iter().fold(f32::INFINITY, f32::min);
            let mean = p.light.coefficients()[0].into_iter().fold(0.0f32, f32::max);
            assert!(-1e-5 * mean <= least, "{least} of {mean}");
        }
    }
}

/// A grey plane of 8 m and a lamp of 100 cd 3 m above its middle.
fn lamp_over_plane(mode: &str) -> Glb {
    let mut glb = Glb::new();
    let mut s = Shape::default();
    s.grid(Vec3::new(-4.0, 0.0, 4.0), Vec3::X * 8.0, Vec3::NEG_Z * 8.0, 1, 1);
    let grey = glb.material(&Material::matte("grey", [0.5; 3]));
    let mesh = glb.mesh("plane", &[(&s, grey)]);
    glb.node(Node::new("plane").mesh(mesh));
    let light = glb.light("lamp", Kind::Point, [1.0; 3], 100.0);
    let lamp = Node::new("lamp").at([0.0, 3.0, 0.0]).extras(json!({ "mode": mode }));
    glb.node(Node { light: Some(light), ..lamp });
    glb
}

/// Without reflections a probe has the light of lamps alone; of lamps whose direct light the game adds it has what is left, which is nothing then.
#[test]
fn only_what_is_wanted_is_gathered() {
    let with = |mode: &str, args: &[&str]| {
        let mut glb = lamp_over_plane(mode);
        let corner = json!({"min": [0.5, 0.5, 0.5], "max": [1.5, 1.5, 1.5]});
        glb.scene_extra("probes", json!([{"box": corner, "spacing": 0.25}]));
        let all = [&["--probe-samples", "512", "--samples", "16"][..], args].concat();
        let v = volume(&tool::baked(&glb.finish(), &[&COARSE[2..], &all].concat()));
        let n = v.probes.len() as f32;
        v.probes.iter().map(|p| p.light.coefficients()[0][1] / n).sum::<f32>()
    };
    let [all, lamp] = ["64", "0"].map(|b| with("baked", &["--bounces", b]));
    let [rest, nothing] = ["64", "0"].map(|b| with("mixed", &["--bounces", b]));
    println!("lamp and floor {all}, lamp {lamp}, floor {rest}, nothing {nothing}");
    assert!(nothing == 0.0 && 0.0 < rest && (all / (lamp + rest) - 1.0).abs() < 0.01);
    for media in ["off", "attenuate", "bounded", "reference"] {
        let same = with("mixed", &["--media", media, "--irradiance-cache", "off"]);
        assert!((same / rest - 1.0).abs() < 0.03, "{media}: {same} {rest}");
    }
}

/// A lamp under a small plate, 3 cm from a probe: where the light at the probe itself is a hundred times that of the cells around it, the probe stands for
/// these.
#[test]
fn a_lamp_beside_a_probe_does_not_flood_its_cells() {
    let mut glb = lamp_over_plane("baked");
    let mut plate = Shape::default();
    plate.cuboid([-0.05, 3.02, -0.05], [0.05, 3.03, 0.05], suite::shape::ALL);
    let white = glb.material(&Material::matte("white", [0.8; 3]));
    let mesh = glb.mesh("plate", &[(&plate, white)]);
    glb.node(Node::new("plate").mesh(mesh));
    let around = json!({"min": [-1, 1.97, -1], "max": [1, 3.97, 1]});
    glb.scene_extra("probes", json!([{"box": around, "spacing": 0.5}]));
    let scene = glb.finish();
    let v = baked(&scene, &["--probe-samples", "1024"]);
    let far = |p: [f32; 3]| (Vec3::from(p) - Vec3::Y * 3.0).length();
    let nearest = v.probes.iter().map(|p| far(p.position)).fold(f32::INFINITY, f32::min);
    assert!(nearest < 0.04, "{nearest} m from the lamp");
    let at: Vec<[[f64; 3]; 2]> = places(400)
        .map(|[x, y, z, _]| [x, y, z].map(|u| u - 0.5))
        .map(|[x, y, z]| Vec3::new(x, y + 2.97, z))
        .filter(|p| (0.2..0.5).contains(&far(p.to_array())))
        .take(60)
        .enumerate()
        .map(|(i, p)| {
            let n = [Vec3::Y, Vec3::NEG_Y, Vec3::X, Vec3::NEG_X, Vec3::Z, Vec3::NEG_Z][i % 6];
            [p, n].map(|v| v.to_array().map(|x| (f64::from(x) * 1e3).round() / 1e3))
        })
        .collect();
    let dir = tool::folder_with(&scene);
    let truth = tool::points(&dir.path().join("scene.glb"), &at, &["--samples", "4096"]);
    let n = at.len() as f64;
    let wanted: Vec<f64> = truth.iter().map(|[e, _]| e[1] / std::f64::consts::PI).collect();
    let mean = wanted.iter().sum::<f64>() / n;
    let (mut found, mut squares) = (0.0, 0.0);
    for ([p, normal], want) in at.iter().zip(&wanted) {
        let single = |v: &[f64; 3]| glam::DVec3::from(*v).as_vec3().to_array();
        let got = f64::from(v.light(single(p)).expect("air").irradiance(single(normal))[1]);
        found += got / n;
        squares += ((got - want) / (want + mean)).powi(2) / n;
    }
    let rms = squares.sqrt();
    println!(
        "{n} places: mean {mean:.1} nits, by probes {:.2} of it, rms {rms:.2} in proportion",
        found / mean
    );
    assert!((0.3..3.0).contains(&(found / mean)) && rms < 0.6, "{rms}");
}

/// Probes that a box puts into the floor of a room know nothing of the bright sky beneath it.
#[test]
fn probes_in_walls_are_moved_out_of_them() {
    let mut glb = Glb::new();
    let mut s = Shape::default();
    s.cuboid([-1.0; 3], [1.0; 3], suite::shape::ALL);
    let grey = glb.material(&Material::matte("grey", [0.5; 3]));
    let mesh = glb.mesh("room", &[(&s.inside_out(), grey)]);
    glb.node(Node::new("room").mesh(mesh));
    glb.scene_extra("sky", json!([100, 100, 100]));
    glb.scene_extra("probes", json!([{"box": {"min": [-1, -1, -1], "max": [1, 1, 1]}, "spacing": 0.5}]));
    let v = baked(&glb.finish(), &["--probe-samples", "64"]);
    let out = v.probes.iter().filter(|p| p.position.iter().any(|x| 1.0 <= x.abs())).count();
    let light = |[x, y, z, _]: [f32; 4]| v.light([x, y, z].map(|u| 1.99 * u - 0.995)).expect("a probe");
    let worst = places(1000).map(|u| light(u).coefficients()[0][0]).fold(0.0f32, f32::max);
    println!("{} probes, {out} on or outside of walls, at most {worst} within", v.probes.len());
    assert!(out <= 8 && worst == 0.0, "only corners have no way out, and nobody inside sees them");
}

/// Places that are evenly spread by chance.
fn places(n: u32) -> impl Iterator<Item = [f32; 4]> {
    (0..n).map(|i| {
        let r = |k: f64| ((f64::from(i) + 0.5) * k).fract();
        // The roots of x^5 = x + 1 make a sequence of low discrepancy in four dimensions.
        [0.856_674_883_854_5, 0.733_891_856_627, 0.628_706_721_037_8, 0.538_597_256_973].map(|k| {
            #[expect(clippy::cast_possible_truncation, reason = "rounding is meant")]
            let x = r(k) as f32;
            x
        })
    })
}

/// At 1,000 places of a dark room, for normals of all kinds, behind walls of 0 to 30 cm, at three densities of probes: less than a thousandth of what the bright room has.
#[test]
fn nothing_leaks_through_walls() {
    for thickness in [0.0f32, 0.01, 0.05, 0.3] {
        for count in ["250", "1000", "4000"] {
            let scene = closed::rooms_beside(thickness, Vec3::new(2.9, 0.7, -1.7));
            let v = baked(&scene, &["--probe-count", count, "--probe-samples", "16"]);
            let half = 0.5 * thickness;
            let look = |x: f32, [y, z, a, b]: [f32; 4]| {
                let p = [x, 0.001 + 1.998 * y, 1.998 * z - 0.999];
                let light = v.light(p).unwrap_or_else(|| panic!("no probe at {p:?}"));
                let cos = 1.0 - 2.0 * a;
                let (s, c) = (2.0 * PI * b).sin_cos();
                let r = (1.0 - cos * cos).sqrt();
                light.irradiance([r * c, r * s, cos])[1].max(0.0)
            };
            let (mut bright, mut dark, mut worst) = (0.0, 0.0, 0.0f32);
            for (i, u) in places(1000).enumerate() {
                let along = 2.0 * (i as f32 * 0.754_877_7).fract();
                bright += look(-half - 0.001 - 0.998 * along, u) / 1000.0;
                let there = look(half + 0.001 + 0.998 * along, u);
                dark += there / 1000.0;
                worst = worst.max(there);
            }
            println!(
                "wall of {thickness} m, {} probes {} m apart: {bright} nits in the light, {:.2e} of it in the dark, at worst {:.2e}",
                v.probes.len(),
                v.lattice.spacing,
                dark / bright,
                worst / bright
            );
            assert!(1.0 < bright && worst < 1e-3 * bright, "{thickness} {count}");
        }
    }
}

/// In the bright room the look-up is that of irradiance at the place itself, by `bake points`.
#[test]
fn lookups_are_what_points_say() {
    let scene = closed::two_rooms(0.1);
    let v = baked(&scene, &["--probe-count", "4000", "--probe-samples", "512"]);
    let dir = tool::folder_with(&scene);
    let normals = [Vec3::Y, Vec3::NEG_Y, Vec3::X, Vec3::Z, Vec3::new(0.6, 0.0, -0.8)];
    let at: Vec<[[f64; 3]; 2]> = places(40)
        .enumerate()
        .map(|(i, [x, y, z, _])| {
            let p = Vec3::new(-0.3 - 1.5 * x, 0.2 + 1.4 * y, 1.6 * z - 0.8);
            // Numbers that text keeps as they are.
            [p, normals[i % normals.len()]].map(|v| v.to_array().map(|x| (f64::from(x) * 1e3).round() / 1e3))
        })
        .collect();
    let truth = tool::points(&dir.path().join("scene.glb"), &at, &["--target-error", "0.01"]);
    let (mut squares, mut mean) = (0.0, 0.0);
    for ([p, n], [e, _]) in at.iter().zip(&truth) {
        let single = |v: &[f64; 3]| glam::DVec3::from(*v).as_vec3().to_array();
        let got = f64::from(v.light(single(p)).expect("air").irradiance(single(n))[1]);
        let want = e[1] / std::f64::consts::PI;
        squares += (got - want).powi(2) / at.len() as f64;
        mean += want / at.len() as f64;
    }
    let rms = squares.sqrt() / mean;
    println!("rms of the look-up over {} places: {:.1} % of the mean", at.len(), 100.0 * rms);
    assert!(rms < 0.1, "{rms}");
}

/// Where one goes from a brick to one of another size through free air, light does not jump: probes of the finer one that the coarser
/// one lacks hold what that has there.
#[test]
fn light_does_not_jump_between_bricks() {
    // A lamp by a pillar on a wide floor: most of the air is far from surfaces.
    let mut glb = Glb::new();
    let (mut floor, mut pillar) = (Shape::default(), Shape::default());
    floor.grid(Vec3::new(-10.0, 0.0, 10.0), Vec3::X * 20.0, Vec3::NEG_Z * 20.0, 1, 1);
    pillar.cuboid([-0.5, 0.0, -0.5], [0.5, 16.0, 0.5], suite::shape::NO_BOTTOM);
    let grey = glb.material(&Material::matte("grey", [0.5; 3]));
    let mesh = glb.mesh("floor", &[(&floor, grey), (&pillar, grey)]);
    glb.node(Node::new("floor").mesh(mesh));
    let light = glb.light("lamp", Kind::Point, [1.0; 3], 500.0);
    glb.node(Node { light: Some(light), ..Node::new("lamp") }.at([4.0, 5.0, 1.0]));
    let v = baked(&glb.finish(), &["--probe-count", "8000", "--probe-samples", "16"]);
    println!(
        "{} bricks of {:?}",
        v.bricks.len(),
        [0, 1, 2].map(|l| v.bricks.iter().filter(|b| b.level == l).count())
    );
    let [nx, ny, nz] = v.lattice.size.map(|n| n as usize);
    let side = v.lattice.spacing * 4.0;
    assert!(v.index.iter().all(|b| *b != tables::probes::NONE), "bricks fill the lattice");
    let brick = |b: [usize; 3]| &v.bricks[v.index[(b[2] * ny + b[1]) * nx + b[0]] as usize];
    let free = |p: Vec3| {
        let w = v.weights(p.to_array()).expect("a probe").weights;
        (w.iter().sum::<f32>() - 1.0).abs() < 1e-5
    };
    // Steps over light, at places on faces between bricks of one size and of two, in free air and next to walls.
    let mut steps: [Vec<f32>; 3] = Default::default();
    let mean = v.probes.iter().map(|p| p.light.coefficients()[0][1]).sum::<f32>() / v.probes.len() as f32;
    for (z, y, x) in (0..nz).flat_map(|z| (0..ny).flat_map(move |y| (0..nx).map(move |x| (z, y, x)))) {
        for axis in 0..3 {
            let (here, mut next) = ([x, y, z], [x, y, z]);
            next[axis] += 1;
            if next[0] == nx || next[1] == ny || next[2] == nz {
                continue;
            }
            let (a, b) = (brick(here), brick(next));
            if a == b {
                continue;
            }
            for [s, t, ..] in places(16) {
                let mut u = Vec3::new(x as f32, y as f32, z as f32);
                u[axis] += 1.0;
                u[(axis + 1) % 3] += s;
                u[(axis + 2) % 3] += t;
                let p = Vec3::from(v.lattice.origin) + u * side;
                let off = Vec3::AXES[axis] * (2e-5 * side);
                let coefficient = |p: Vec3| v.light(p.to_array()).expect("a probe").coefficients()[0][1];
                let [c, d] = [p + off, p - off].map(coefficient);
                let step = (c - d).abs() / mean.max(c);
                // A cell that surfaces pass through leaves out probes.
                let walls = [(a, p - off), (b, p + off)].iter().any(|(brick, p)| {
                    let scale = v.lattice.spacing * (1u32 << brick.level) as f32;
                    let first = Vec3::from(v.lattice.origin)
                        + glam::UVec3::from(brick.corner).as_vec3() * v.lattice.spacing;
                    let cell = ((*p - first) / scale).as_uvec3().min(glam::UVec3::splat(3));
                    brick.cells[((cell.z * 4 + cell.y) * 4 + cell.x) as usize] != tables::probes::NONE
                });
                assert!(free(p));
                steps[if walls { 2 } else { usize::from(a.level != b.level) }].push(step);
            }
        }
    }
    for (steps, what) in
        steps.iter_mut().zip(["bricks of one size", "bricks of two sizes", "cells with walls"])
    {
        steps.sort_by(f32::total_cmp);
        let rms = (steps.iter().map(|s| s * s).sum::<f32>() / steps.len().max(1) as f32).sqrt();
        let worst = steps.last().copied().unwrap_or(0.0);
        println!(
            "{what}: {} places, rms {:.4}, at worst {worst:.4} of the light there or the mean",
            steps.len(),
            rms
        );
    }
    assert!(500 < steps[1].len(), "{}", steps[1].len());
    assert!(steps[..2].iter().flatten().all(|s| *s < 2e-3), "{:?}", steps[1].last());
}

/// Another unit of length, other lights, another number of threads.
#[test]
fn the_same_scene_gives_the_same_probes() {
    let args = ["--probe-count", "150", "--probe-samples", "32"];
    let one = baked(&room(Room::default()), &args);
    let threads =
        |n: &str| tool::baked(&room(Room::default()), &[&COARSE[..], &args, &["--threads", n]].concat());
    let (a, b) = (threads("1"), threads("2"));
    for file in ["probes.bin", "probes.vxgi.ktx2", "probes.three.ktx2", "manifest.json"] {
        assert_eq!(a.files[file], b.files[file], "{file}");
    }
    let bright = baked(&room(Room { radiance: 2.0, candela: 2.0, lux: 2.0, ..Room::default() }), &args);
    let s = 2f32.powi(-7);
    let small = room(Room { length: s, candela: s * s, ..Room::default() });
    let small =
        volume(&tool::baked(&small, &[&["--samples", "1", "--texels-per-metre", "256"], &args[..]].concat()));
    assert_eq!(one.probes.len(), small.probes.len());
    assert_eq!((&one.bricks, &one.index), (&small.bricks, &small.index));
    for ((p, twice), scaled) in one.probes.iter().zip(&bright.probes).zip(&small.probes) {
        assert_eq!(p.position.map(|x| x * s), scaled.position);
        assert_eq!((p.light, p.window, p.std_err), (scaled.light, scaled.window, scaled.std_err));
        assert_eq!(p.position, twice.position);
        for (a, b) in p.light.coefficients().iter().zip(twice.light.coefficients()) {
            assert_eq!(a.map(|a| 2.0 * a), *b);
        }
    }
}

/// The even grids are read with another reader, at the places that the manifest states, and hold what the bricks hold there.
#[test]
fn engines_find_what_the_bricks_hold() {
    let baked = tool::baked(&room(Room::default()), &[&COARSE[..], &["--probe-count", "300"]].concat());
    let v = volume(&baked);
    let grid = &baked.manifest.probes[0].grid;
    let [nx, ny, nz] = grid.size;
    let texture = |name: &str, size: [u32; 3]| {
        let reader = ktx2::Reader::new(&baked.files[name][..]).expect("a KTX2 file");
        let h = reader.header();
        assert_eq!(h.format, Some(ktx2::Format::R16G16B16A16_SFLOAT));
        assert_eq!([h.pixel_width, h.pixel_height, h.pixel_depth], size);
        assert_eq!(h.supercompression_scheme, Some(ktx2::SupercompressionScheme::Zstandard));
        let mut data = Vec::new();
        let packed = reader.levels().next().expect("a level").data;
        let mut decoder = ruzstd::decoding::StreamingDecoder::new(packed).expect("Zstandard");
        decoder.read_to_end(&mut data).expect("Zstandard");
        let halves: Vec<f32> =
            data.chunks_exact(2).map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32()).collect();
        move |[x, y, z]: [u32; 3]| -> [f32; 4] {
            let at = 4 * ((z * size[1] + y) * size[0] + x) as usize;
            std::array::from_fn(|c| halves[at + c])
        }
    };
    let cubes = texture(&grid.irradiance_volume, [nx, 2 * ny, 3 * nz]);
    let atlas = texture(&grid.harmonics, [nx, ny, 7 * (nz + 2)]);
    let first = Vec3::from(grid.centre) - 0.5 * Vec3::from(grid.extent);
    let side = Vec3::from(grid.extent) / Vec3::new(nx as f32, ny as f32, nz as f32);
    let mut seen = 0;
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let centre = first + (Vec3::new(x as f32, y as f32, z as f32) + 0.5) * side;
                let Some(light) = v.light(centre.to_array()) else { continue };
                seen += 1;
                let scale = light.coefficients()[0][0].abs();
                for axis in 0..3 {
                    for (negative, sign) in [(0, 1.0), (1, -1.0)] {
                        let mut n = [0.0; 3];
                        n[axis as usize] = sign;
                        let want = light.irradiance(n)[0].max(0.0);
                        let texel = cubes([x, y + negative * ny, z + axis * nz])[0];
                        assert!((texel - want).abs() <= 1e-3 * scale, "{x} {y} {z}, {n:?}: {texel} {want}");
                    }
                }
                let full = light.expand();
                for (k, want) in (0u32..).zip(full[..9].as_flattened()) {
                    let texel = atlas([x, y, (k / 4) * (nz + 2) + z + 1])[(k % 4) as usize];
                    assert!((texel - want).abs() <= 1e-3 * scale, "{x} {y} {z}, value {k}: {texel} {want}");
                }
            }
        }
    }
    assert!(100 < seen);
}

/// Probes are switched off, or asked for in boxes; what is wrong with these is said.
#[test]
fn probes_are_asked_for() {
    let scene = |probes| {
        let mut glb = lamp_over_plane("baked");
        glb.scene_extra("probes", probes);
        glb.finish()
    };
    let corner = |x: f32| json!({"box": {"min": [x, 0, 0], "max": [x + 1.0, 1, 1]}, "spacing": 0.25});
    let two = tool::baked(&scene(json!([corner(-1.0), corner(0.0)])), &COARSE);
    assert_eq!(two.manifest.probes.len(), 2);
    for (m, file) in two.manifest.probes.iter().zip(["probes.bin", "probes-1.bin"]) {
        assert_eq!((m.file.as_str(), m.size, m.levels, m.spacing), (file, [1; 3], 1, 0.25));
        assert!(two.files.contains_key(file) && two.files.contains_key(&m.grid.irradiance_volume));
    }
    let off = tool::baked(&scene(json!([corner(0.0)])), &[&COARSE[..], &["--probes", "off"]].concat());
    assert!(off.manifest.probes.is_empty() && !off.files.keys().any(|f| f.starts_with("probes")));
    let dir = tool::folder_with(&scene(json!([{"box": {"min": [0, 0, 0], "max": [1, 1, 1]}}])));
    let wrong = tool::bake(&["run", "scene.glb", "-o", "out"], dir.path()).expect(2);
    assert!(wrong.stderr.contains("extras.probes[0]") && wrong.stderr.contains("spacing"), "{wrong}");
    assert!(!dir.path().join("out").exists());
}
