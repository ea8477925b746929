//! Denoised lightmaps are nearer to the truth, say what they were, and keep what is not noise.

use glam::Vec3;
use std::collections::BTreeSet;
use suite::{
    baked::{Baked, NO_LIGHT},
    gltf::{Glb, Kind, Material, Node},
    scenes::{
        closed::{Room, room, two_rooms},
        open::wall_outdoors,
    },
    shape::Shape,
    tool,
};

const MODES: [&str; 2] = ["draft", "final"];

/// Without seams stitched, which comes after denoising and would be in all that is compared.
fn bake(scene: &[u8], denoise: &str, args: &[&str]) -> Baked {
    tool::baked(scene, &[args, &["--denoise", denoise, "--seams", "off", "--probes", "off"]].concat())
}

/// Luminance of layer `prefix` in every covered texel.
fn luminance(baked: &Baked, prefix: &str) -> Vec<f64> {
    let mut all = Vec::new();
    for page in &baked.pages {
        for y in 0..page.height {
            for x in (0..page.width).filter(|&x| 0.0 < page.get("A", x, y).expect("coverage")) {
                let c = page.rgb(prefix, x, y).as_dvec3();
                all.push(0.2126 * c.x + 0.7152 * c.y + 0.0722 * c.z);
            }
        }
    }
    all
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Root mean squared difference.
fn rmse(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    mean(&a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).collect::<Vec<_>>()).sqrt()
}

/// Bakes `scene` noisy and denoised and checks all that has to hold. The error has to fall to `most` of what it was, and
/// at most this part of the texels may change by more than three standard errors.
#[track_caller]
fn better(scene: &[u8], density: &str, samples: &str, most: [f64; 2], most_changed: f64) {
    let args = ["--texels-per-metre", density, "--samples", samples];
    let off = bake(scene, "off", &args);
    let seed =
        ["--texels-per-metre", density, "--samples", "512", "--seed", "1", "--irradiance-cache", "off"];
    let truth = luminance(&bake(scene, "off", &seed), "");
    let noisy = luminance(&off, "");
    let before = rmse(&noisy, &truth);
    assert!(off.manifest.denoised.is_none() && !off.pages[0].channels.contains_key("noisy.R"));
    for (mode, most) in MODES.into_iter().zip(most) {
        let clean = bake(scene, mode, &args);
        let values = luminance(&clean, "");
        let after = rmse(&values, &truth);
        assert!(after < most * before, "{mode}: the error was {before} and is {after}");
        // A hidden texel is filled from others, which changes the mean by a little.
        let drift = mean(&values) / mean(&noisy) - 1.0;
        assert!(drift.abs() < 1e-3, "{mode}: the mean changed by {drift}");
        assert!(values.iter().all(|v| v.is_finite() && 0.0 <= *v));

        // What was before is still told, to the bit.
        assert_eq!(clean.manifest.error, off.manifest.error);
        assert_eq!(clean.manifest.samples, off.manifest.samples);
        for c in ["R", "G", "B"] {
            // Gutters go on with the slope of the light, which is known for what is shown alone.
            let channel = |b: &Baked, name: String| -> Vec<f32> {
                let page = &b.pages[0].channels;
                let covered = page[&name].iter().zip(&page["A"]).filter(|(_, a)| 0.0 < **a);
                covered.map(|(v, _)| *v).collect()
            };
            assert!(channel(&clean, format!("noisy.{c}")) == channel(&off, c.to_owned()), "{mode} {c}");
            let name = format!("stderr.{c}");
            assert!(channel(&clean, name.clone()) == channel(&off, name), "{mode} {c}");
        }

        // What is left is stated, and not hidden.
        let figures = clean.manifest.denoised.expect("denoised");
        assert_eq!(Some(figures), clean.manifest.pages[0].denoised);
        let stated = figures.rms_error / after;
        assert!((0.35..2.0).contains(&stated), "{mode}: {} is stated for {after}", figures.rms_error);
        let left = luminance(&clean, "rmse.");
        let rms = mean(&left.iter().map(|e| e * e).collect::<Vec<_>>()).sqrt();
        assert!((rms / figures.rms_error - 1.0).abs() < 1e-4);
        let error = luminance(&clean, "stderr.");
        let changed =
            values.iter().zip(&noisy).zip(&error).filter(|((a, b), e)| 3.0 * **e < (*a - *b).abs()).count();
        let part = changed as f64 / values.len() as f64;
        assert!((part - figures.changed).abs() < 1e-3, "{mode}: {part} and {}", figures.changed);
        assert!(figures.changed < most_changed, "{mode}: {}", figures.changed);
    }
}

#[test]
fn a_room_with_a_lamp_and_hard_shadows() {
    better(&room(Room::default()), "8", "16", [0.7, 0.6], 0.05);
}

#[test]
fn a_wall_in_the_sun() {
    // Far from the wall no path of 16 meets it, and the standard error is 0, but what the wall takes of the sky is not.
    better(&wall_outdoors(), "3", "16", [0.8, 0.7], 0.6);
}

/// Of two rooms side by side one is black. All their walls are charts of one page, parted by its gutter alone.
#[test]
fn nothing_bleeds_from_a_bright_chart_into_a_black_one() {
    for thickness in [0.1, 0.0] {
        let scene = two_rooms(thickness);
        for mode in MODES {
            let baked = bake(&scene, mode, &["--texels-per-metre", "8", "--samples", "16"]);
            let page = &baked.pages[0];
            let (mut dark, mut bright) = (0, BTreeSet::new());
            for ((x, y), pieces) in baked.texels() {
                let light = page.rgb("", x, y);
                let of = |name: &str| pieces.iter().all(|p| p.node.starts_with(name));
                if of("dark room") {
                    assert_eq!(light, glam::Vec3::ZERO, "{mode}: texel {x},{y} of the dark room");
                    dark += 1;
                } else if of("lit room") && 0.0 < light.max_element() {
                    bright.insert((x, y));
                }
            }
            assert!(500 < dark && 500 < bright.len(), "{dark} dark and {} bright texels", bright.len());
        }
    }
}

/// A room that a sheet parts in two, on a floor and below a ceiling that run through; only the left half has a lamp, small and over a plate, so
/// that light comes to the floor by way of the ceiling and is noisy up to the sheet.
fn halves() -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.7; 3]));
    let both = glb.material(&Material::matte("sheet", [0.7; 3]).double_sided());
    let mut room = Shape::default();
    room.cuboid([-2.0, 0.0, -1.0], [2.0, 2.0, 1.0], suite::shape::ALL);
    let mut sheet = Shape::default();
    sheet.quad([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 2.0, 1.0], [0.0, 2.0, -1.0]].map(Vec3::from));
    let mut plate = Shape::default();
    plate.quad([[-1.7, 1.7, 0.4], [-1.0, 1.7, 0.4], [-1.0, 1.7, -0.4], [-1.7, 1.7, -0.4]].map(Vec3::from));
    let lamp = glb.light("lamp", Kind::Point, [1.0; 3], 20.0);
    glb.node(Node { light: Some(lamp), ..Node::new("lamp") }.at([-1.35, 1.75, 0.0]));
    for (name, shape, material) in
        [("room", room.inside_out(), white), ("sheet", sheet, both), ("plate", plate, both)]
    {
        let mesh = glb.mesh(name, &[(&shape, material)]);
        glb.node(Node::new(name).mesh(mesh));
    }
    glb.finish()
}

/// Nor through a wall that stands on a floor of one chart.
#[test]
fn nothing_bleeds_under_a_wall() {
    let args = ["--texels-per-metre", "8", "--samples", "16", "--irradiance-cache", "off"];
    for mode in MODES {
        let baked = bake(&halves(), mode, &args);
        let page = &baked.pages[0];
        let (mut dark, mut changed) = (0, 0);
        for ((x, y), pieces) in baked.texels() {
            if !pieces.iter().all(|p| p.node == "room") {
                continue;
            }
            let (light, before) = (page.rgb("", x, y), page.rgb("noisy.", x, y));
            // Texels that both halves share are lit by one of them, and noise may leave some of the lit half black.
            if before == Vec3::ZERO && pieces.iter().flat_map(|p| &p.points).all(|(at, ..)| 0.0 < at.x) {
                assert_eq!(light, Vec3::ZERO, "{mode}: texel {x},{y} of the dark half");
                dark += 1;
            }
            changed += usize::from(light != before);
        }
        assert!(500 < dark && 300 < changed, "{mode}: {dark} dark, {changed} changed");
    }
}

#[test]
fn bytes_do_not_depend_on_threads() {
    let bake = |threads| {
        let args = ["--samples", "16", "--texels-per-metre", "6", "--threads", threads];
        bake(&room(Room::default()), "final", &args).files
    };
    let one = bake("1");
    for threads in ["2", "5"] {
        let other = bake(threads);
        assert!(one.keys().eq(other.keys()));
        for (name, bytes) in &one {
            assert!(bytes == &other[name], "{name} differs between 1 and {threads} threads");
        }
    }
}

/// Twice the light is twice every texel, and another unit of length changes nothing, all to the bit.
#[test]
fn nothing_is_absolute() {
    let bake = |r: Room, density: f32| {
        let density = density.to_string();
        bake(&room(r), "final", &["--samples", "16", "--texels-per-metre", &density])
    };
    let one = bake(Room::default(), 6.0);
    let two = bake(Room { radiance: 2.0, candela: 2.0, lux: 2.0, ..Room::default() }, 6.0);
    let s = 2f32.powi(-10);
    let small = bake(Room { length: s, candela: s * s, ..Room::default() }, 6.0 / s);
    for (name, values) in one.pages[0].channels.iter().filter(|(name, _)| !NO_LIGHT.contains(&name.as_str()))
    {
        for (i, v) in values.iter().enumerate() {
            let [twice, same] = [&two, &small].map(|b| b.pages[0].channels[name][i]);
            assert_eq!((2.0 * v).to_bits(), twice.to_bits(), "{name} at {i}: {v} became {twice}");
            assert_eq!(v.to_bits(), same.to_bits(), "{name} at {i}: {v} became {same}");
        }
    }
}

/// A word in a configuration file does what the option does.
#[test]
fn a_configuration_file_asks_for_it_as_well() {
    let dir = tool::folder_with(&room(Room::default()));
    std::fs::write(dir.path().join("bake.toml"), "[run]\ndenoise = \"draft\"\n").expect("a file");
    let args = ["run", "scene.glb", "-o", "out", "--samples", "4", "--texels-per-metre", "4"];
    let done = tool::bake(&[&args[..], &["--config", "bake.toml"]].concat(), dir.path()).expect(0);
    assert!(!done.stderr.contains("reserved"), "{done}");
    let baked = Baked::read(&dir.path().join("out")).expect("a bake");
    assert_eq!(baked.manifest.settings["denoise"], "draft");
    assert!(baked.manifest.denoised.is_some());
}
