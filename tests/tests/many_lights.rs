//! Many lights: lightcuts against other ways to choose, and through the whole tool.

#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test may panic and print")]

use glam::Vec3;
use serde_json::{Value, json};
use std::fs;
use suite::baked::Page;
use suite::divided::{Divided, Method};
use suite::gltf::{Glb, Kind, Material, Node, looking};
use suite::scenes::lamps::lamps;
use suite::shape::{ALL, Shape};
use suite::tool;

/// The paper's order, and how far ours is below what it publishes.
#[test]
fn fewer_errors_than_other_ways() {
    let scene = Divided::new(24);
    let rmse = |method, samples| scene.runs(method, samples, 10).0[0].all;
    for samples in [10, 100] {
        let [intensity, splitting, published, ours] =
            [Method::Intensity, Method::Splitting, Method::Published, Method::Ours].map(|m| rmse(m, samples));
        println!("{samples}: {intensity:.4} {splitting:.4} {published:.4} {ours:.4}");
        assert!(splitting < intensity && published < splitting, "{samples}: the order of [SLC20] table 1");
        assert!(ours < 0.75 * published, "{samples}: {ours} {published}");
        if samples == 10 {
            let ratio = intensity / published;
            assert!((1.31 * 0.7..1.31 * 1.3).contains(&ratio), "{ratio}");
        }
    }
}

fn write(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> String {
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    path.display().to_string()
}

fn plan(scene: &str, args: &[&str], folder: &tempfile::TempDir) -> Vec<(String, String)> {
    let all = [&["plan", scene, "--json", "--texels-per-metre", "0.5"], args].concat();
    let out = tool::bake(&all, folder.path()).expect(0);
    let plan: Value = serde_json::from_str(&out.stdout).unwrap();
    let effects = plan["effects"].as_array().unwrap();
    let text = |v: &Value| v.as_str().unwrap().to_owned();
    effects.iter().map(|e| (text(&e["name"]), text(&e["why"]))).collect()
}

/// Few lights are all asked, many are in a tree, and the plan says so.
#[test]
fn plans_say_how_lights_are_chosen() {
    let folder = tempfile::tempdir().unwrap();
    for (lights, triangles, args, lamp, emitter) in [
        (2, 24, &[][..], "few, all", "few, each"),
        (12, 24, &[], "few, each", "few, each"),
        (40, 240, &[], "many, chosen from a tree", "many, chosen from a tree"),
        (2, 24, &["--direct", "lightcuts"], "chosen from a tree", "chosen from a tree"),
        (40, 240, &["--direct", "all"], "a ray to each", "a ray to each"),
    ] {
        let scene = write(&folder, "lamps.glb", &lamps(lights, triangles));
        let effects = plan(&scene, args, &folder);
        let why = |name: &str| &effects.iter().find(|e| e.0 == name).unwrap().1;
        assert!(why("point and spot lights").contains(lamp), "{effects:?}");
        assert!(why("emissive surfaces").contains(emitter), "{effects:?}");
    }
    let config = write(&folder, "bake.toml", b"[run]\ndirect = \"published\"\n");
    let scene = write(&folder, "lamps.glb", &lamps(40, 240));
    let effects = plan(&scene, &["--config", &config], &folder);
    assert!(effects.iter().any(|e| e.1.contains("to compare with")), "{effects:?}");
    let effects = plan(&scene, &["--direct", "grid"], &folder);
    assert!(effects.iter().any(|e| e.1.contains("in a lighting grid hierarchy of")), "{effects:?}");
    for (args, remedy) in [
        (&["--direct", "grid", "--media", "table"][..], "--direct auto"),
        (&["--direct-alpha", "4"], "--direct grid"),
        (&["--fire-blend", "published"], "--fire grid"),
    ] {
        let out = tool::bake(&[&["run", &scene], args].concat(), folder.path()).expect(2);
        assert!(out.stderr.contains(remedy), "{args:?}: {}", out.stderr);
    }
}

/// Lamps in a lighting grid hierarchy: near to all of them with a ray each, nearer with a larger alpha, and less noise than as many rays to lamps that are chosen from a tree.
#[test]
fn a_hierarchy_of_lamps_is_near_and_smooth() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("lamps.glb");
    fs::write(&scene, lamps(600, 0)).unwrap();
    let at: Vec<[[f64; 3]; 2]> = (0..45)
        .map(|k| {
            let x = f64::from(k) * 1.25 - 27.5;
            let z = f64::from(k * 7 % 12) * 2.25 - 12.5;
            [[x, 0.125, z], [0.0, 1.0, 0.0]]
        })
        .collect();
    let by = |args: &[&str]| {
        tool::points(&scene, &at, &[&["--bounces", "0", "--media", "off", "--direct"], args].concat())
    };
    let truth = by(&["all", "--samples", "1"]);
    let compare = |got: &[[[f64; 3]; 2]]| {
        let (mut off, mut mean, mut noise) = (0.0, 0.0, 0.0);
        for ([value, error], [want, _]) in got.iter().zip(&truth) {
            let of = |v: &[f64; 3]| 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2];
            off += (of(value) / of(want) - 1.0).abs() / 45.0;
            mean += (of(value) / of(want) - 1.0) / 45.0;
            noise += of(error) / of(want) / 45.0;
        }
        (off, mean, noise)
    };
    let by = |way: &[&str], samples: &str| compare(&by(&[way, &["--samples", samples]].concat()));
    let curve = ["1", "2", "4"].map(|a| by(&["grid", "--direct-alpha", a], "1024"));
    println!("alpha 1, 2, 4: error, mean, stated noise: {curve:?}");
    assert!(curve[1].0 < 0.5 * curve[0].0 && curve[2].0 < 0.6 * curve[1].0, "{curve:?}");
    assert!(curve[2].0 < 0.03 && curve[2].1.abs() < 0.015, "{curve:?}");
    let (tree, grid) = (by(&["lightcuts"], "16"), by(&["grid"], "16"));
    println!("16 samples: {grid:?}, lightcuts {tree:?}");
    assert!(grid.2 < 0.8 * tree.2, "{grid:?} {tree:?}");
}

/// Irradiance at places is the same however lights are chosen: all of them with a ray each is the truth.
#[test]
fn all_ways_agree() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("lamps.glb");
    fs::write(&scene, lamps(60, 480)).unwrap();
    let at: Vec<[[f64; 3]; 2]> = (0..12)
        .map(|k| {
            let x = f64::from(k) * 4.75 - 27.0;
            let z = f64::from(k * 7 % 12) * 2.25 - 12.5;
            [[x, 0.125, z], [0.0, 1.0, 0.0]]
        })
        .collect();
    let by = |direct: &str, samples: &str| {
        tool::points(&scene, &at, &["--direct", direct, "--bounces", "1", "--samples", samples])
    };
    let truth = by("all", "1024");
    for direct in ["auto", "lightcuts", "published", "splitting"] {
        let got = by(direct, "4096");
        let mut off = Vec::new();
        for ([value, error], [want, uncertain]) in got.iter().zip(&truth) {
            for c in 0..3 {
                let sigma = (error[c].powi(2) + uncertain[c].powi(2)).sqrt() + 1e-3 * want[c];
                off.push((value[c] - want[c]) / sigma);
            }
        }
        let worst = off.iter().fold(0.0f64, |w, z| w.max(z.abs()));
        let mean = off.iter().sum::<f64>() / (off.len() as f64).sqrt();
        assert!(worst < 5.0 && mean.abs() < 5.0, "{direct}: {worst} {mean}");
    }
}

/// The same in fog, for paths that scatter and for the grid of light.
#[test]
fn all_ways_agree_in_fog() {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("lamps.glb");
    fs::write(&scene, lamps(60, 480)).unwrap();
    fs::write(folder.path().join("lamps.toml"), "[[media]]\nsigma_s = 0.03\ng = 0.3\n").unwrap();
    let config = folder.path().join("lamps.toml").display().to_string();
    let at: Vec<[[f64; 3]; 2]> = (0..8)
        .map(|k| [[f64::from(k) * 6.5 - 24.0, 0.125, f64::from(k * 5 % 8) * 3.0 - 10.5], [0.0, 1.0, 0.0]])
        .collect();
    let by = |args: &[&str]| {
        let first = ["--config", &config, "--bounces", "1"];
        let got = tool::points(&scene, &at, &[&first[..], args].concat());
        let sum = |v: [f64; 3]| v.iter().sum::<f64>();
        got.iter().map(|[v, e]| (sum(*v), sum(*e))).collect::<Vec<_>>()
    };
    for media in ["reference", "bounded"] {
        let by =
            |direct: &str, samples: &str| by(&["--media", media, "--direct", direct, "--samples", samples]);
        let truth = by("all", "512");
        for direct in ["auto", "published"] {
            for ((value, error), (want, uncertain)) in by(direct, "2048").iter().zip(&truth) {
                // Errors themselves are rough: light next to a lamp in fog is rare and bright.
                let sigma = (error * error + uncertain * uncertain).sqrt();
                let off = (value - want).abs();
                assert!(off < 5.0 * sigma + 0.01 * want, "{media} {direct}: {value} {want} {sigma}");
            }
        }
    }
}

/// Spots that shine past a place light it by way of the fog: none of them is left out.
#[test]
fn beams_in_fog_count() {
    let mut glb = Glb::new();
    let grey = glb.material(&Material::matte("grey", [0.5; 3]));
    let mut floor = Shape::default();
    floor.cuboid([-4.0, -0.1, -4.0], [4.0, 0.0, 4.0], ALL);
    let mesh = glb.mesh("floor", &[(&floor, grey)]);
    glb.node(Node::new("floor").mesh(mesh));
    for k in 0..20u8 {
        let place = [-4.0, 1.0 + 0.1 * f32::from(k), 0.2 * f32::from(k) - 2.0];
        let mut node = Node::new(&format!("spot {k}")).at(place).turned(looking(Vec3::X));
        let kind = Kind::Spot { inner: 0.1, outer: 0.2 };
        node.light = Some(glb.light(&format!("spot {k}"), kind, [1.0; 3], 100.0));
        glb.node(node);
    }
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("beams.glb");
    fs::write(&scene, glb.finish()).unwrap();
    let config = folder.path().join("fog.toml").display().to_string();
    fs::write(&config, "[[media]]\nsigma_s = 0.05\n").unwrap();
    let at = [[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]]];
    let by = |media: &str, direct: &str| {
        let args = ["--config", &config, "--bounces", "0", "--samples", "4096", "--media", media];
        tool::points(&scene, &at, &[&args[..], &["--direct", direct]].concat())
    };
    for media in ["reference", "bounded"] {
        let truth = by(media, "all");
        for direct in ["auto", "published"] {
            for ([value, error], [want, uncertain]) in by(media, direct).iter().zip(&truth) {
                let sigma = (error[0].powi(2) + uncertain[0].powi(2)).sqrt();
                let off = (value[0] - want[0]).abs();
                assert!(off < 5.0 * sigma + 0.01 * want[0], "{media} {direct}: {value:?} {want:?} {sigma}");
            }
        }
    }
}

/// Light straight from a thin closed body far from the origin: what it shows must not be hidden by its own rounding. A small sphere
/// brings `pi L (r / d)^2`.
#[test]
fn thin_bodies_do_not_hide_themselves() {
    let mut glb = Glb::new();
    let grey = glb.material(&Material::matte("grey", [0.5; 3]));
    let glowing = glb.material(&Material::matte("glowing", [0.0; 3]).emitting([100.0; 3]));
    let mut floor = Shape::default();
    floor.cuboid([30.0, -1.0, 30.0], [32.0, -0.9, 32.0], ALL);
    let mut bulb = Shape::default();
    bulb.icosphere(0.01, 3, false);
    let body = bulb.moved([31.0, 0.0625, 31.0]);
    for (name, shape, material) in [("floor", &floor, grey), ("bulb", &body, glowing)] {
        let mesh = glb.mesh(name, &[(shape, material)]);
        glb.node(Node::new(name).mesh(mesh));
    }
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("bulb.glb");
    fs::write(&scene, glb.finish()).unwrap();
    let at = [0.03125, 0.0625, 0.1875].map(|d| [[31.0, 0.0625 - d, 31.0], [0.0, 1.0, 0.0]]);
    // The flat triangles between the sphere's points cover a little less than it does.
    let cover = {
        let area: f64 = body
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| body.positions[i as usize].as_dvec3());
                0.5 * (b - a).cross(c - a).length()
            })
            .sum();
        area / (4.0 * std::f64::consts::PI * 1e-4)
    };
    for direct in ["lightcuts", "all", "intensity", "published"] {
        let got = tool::points(&scene, &at, &["--direct", direct, "--bounces", "0", "--samples", "16384"]);
        for ([value, _], [place, _]) in got.iter().zip(&at) {
            let want = std::f64::consts::PI * 100.0 * (0.01 / (0.0625 - place[1])).powi(2) * cover;
            assert!((value[0] / want - 1.0).abs() < 0.015, "{direct} {}: {} {want}", place[1], value[0]);
        }
    }
}

/// Lights at the edges, through the whole tool: every texel is a number, none negative, and one light inside a wall lights nothing.
#[test]
fn hard_lights_leave_numbers() {
    let scene = |places: &[([f32; 3], f32)], extras: Value| {
        let mut glb = Glb::new();
        let grey = glb.material(&Material::matte("grey", [0.5; 3]));
        let mut room = Shape::default();
        room.cuboid([-2.0, 0.0, -2.0], [2.0, 3.0, 2.0], ALL);
        let mut block = Shape::default();
        block.cuboid([-1.0, 0.0, -1.0], [0.0, 1.0, 0.0], ALL);
        for (name, shape) in [("room", room.inside_out()), ("block", block)] {
            let mesh = glb.mesh(name, &[(&shape, grey)]);
            glb.node(Node::new(name).mesh(mesh));
        }
        for (k, (place, candela)) in places.iter().enumerate() {
            let mut node = Node::new(&format!("lamp {k}")).at(*place);
            node.light = Some(glb.light(&format!("lamp {k}"), Kind::Point, [1.0; 3], *candela));
            node.extras = extras.clone();
            glb.node(node);
        }
        glb.finish()
    };
    let args = ["--texels-per-metre", "4", "--samples", "16", "--strict", "--direct", "lightcuts"];
    let mean = |places: &[([f32; 3], f32)]| {
        let baked = tool::baked(&scene(places, json!({})), &args);
        let means = baked.node_means();
        for page in &baked.pages {
            for (y, x) in (0..page.height).flat_map(|y| (0..page.width).map(move |x| (y, x))) {
                let light = page.rgb("", x, y);
                assert!(light.is_finite() && 0.0 <= light.min_element(), "{x} {y}: {light}");
            }
        }
        means["room"][0].x
    };
    let one = mean(&[([0.5, 1.5, 0.5], 100.0)]);
    assert!(1.0 < one, "{one}");
    // Many in one place are one of their sum.
    let many = mean(&vec![([0.5, 1.5, 0.5], 1.0); 100]);
    assert!((many / one - 1.0).abs() < 0.03, "{many} {one}");
    // Inside of a wall, on the floor, twelve orders of magnitude dimmer, dark.
    assert_eq!(mean(&vec![([-0.5, 0.5, -0.5], 100.0); 40]), 0.0);
    let mut mixed = vec![([0.5, 1.5, 0.5], 100.0); 1];
    mixed.extend(vec![([0.4, 1.6, 0.5], 1e-10); 20]);
    mixed.extend(vec![([1.0, 0.0, 1.0], 1e-3); 3]);
    mixed.extend(vec![([-0.5, 0.5, -0.5], 50.0); 20]);
    mixed.push(([1.0, 1.0, 1.0], 0.0));
    let mixed = mean(&mixed);
    assert!((mixed / one - 1.0).abs() < 0.03, "{mixed} {one}");
}

/// The scene with all light doubled.
fn doubled(glb: &[u8]) -> Vec<u8> {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let mut json: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    let twice = |v: &mut Value| *v = json!(v.as_f64().unwrap() * 2.0);
    for light in json["extensions"]["KHR_lights_punctual"]["lights"].as_array_mut().unwrap() {
        twice(&mut light["intensity"]);
    }
    for material in json["materials"].as_array_mut().unwrap() {
        if let Some(strength) =
            material.pointer_mut("/extensions/KHR_materials_emissive_strength/emissiveStrength")
        {
            twice(strength);
        }
    }
    let mut text = serde_json::to_vec(&json).unwrap();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut out = glb[..12].to_vec();
    out.extend(u32::try_from(text.len()).unwrap().to_le_bytes());
    out.extend(&glb[16..20]);
    out.extend(text);
    out.extend(&glb[20 + length..]);
    let all = u32::try_from(out.len()).unwrap().to_le_bytes();
    out[8..12].copy_from_slice(&all);
    out
}

/// Doubled lights give doubled texels and threads make no difference, to the bit.
#[test]
fn trees_are_exact() {
    let scene = lamps(300, 2400);
    let args = ["--texels-per-metre", "0.5", "--samples", "8"];
    let (a, b) = (
        tool::baked(&scene, &[&args[..], &["--threads", "1"]].concat()),
        tool::baked(&scene, &[&args[..], &["--threads", "3"]].concat()),
    );
    assert_eq!(a.files["lightmap-0.exr"], b.files["lightmap-0.exr"]);
    let lux = |baked: &suite::baked::Baked| {
        let page = &baked.pages[0];
        let all = (0..page.height).flat_map(|y| (0..page.width).map(move |x| page.rgb("", x, y)));
        all.collect::<Vec<_>>()
    };
    let twice = tool::baked(&doubled(&scene), &args);
    assert!(lux(&a).iter().zip(lux(&twice)).all(|(one, two)| *one * 2.0 == two));
}

/// Texels of a bake of a file, a number each, and processor seconds.
fn hall(folder: &tempfile::TempDir, args: &[&str]) -> (Vec<f64>, f64) {
    let _ = tool::bake(&[&["run"], args, &["-o", "out"]].concat(), folder.path()).expect(0);
    let out = folder.path().join("out");
    let page = Page::read(&out.join("lightmap-0.exr")).unwrap();
    let timings: Value = serde_json::from_slice(&fs::read(out.join("timings.json")).unwrap()).unwrap();
    fs::remove_dir_all(out).unwrap();
    let texels = (0..page.height).flat_map(|y| (0..page.width).map(move |x| (x, y)));
    let covered = texels.filter(|&(x, y)| page.get("A", x, y).is_some_and(|a| 0.5 < a));
    let light = covered.map(|(x, y)| f64::from(page.rgb("", x, y).element_sum())).collect();
    (light, timings["cpu_seconds"].as_f64().unwrap())
}

/// Light straight from 600 and 5,000 lamps of the hall, with as many rays: what a hierarchy costs, how much noise it saves, and how far its mean is off.
#[test]
fn a_hall_by_a_hierarchy() {
    if !suite::slow() {
        println!("skipped: a_hall_by_a_hierarchy: RUN_SLOW_TESTS is not 1");
        return;
    }
    for n in [600, 5000] {
        let folder = tempfile::tempdir().unwrap();
        let path = write(&folder, "lamps.glb", &lamps(n, 0));
        let by = |args: &[&str]| {
            let fixed = [&path, "--texels-per-metre", "1", "--bounces", "0", "--seams", "off"];
            hall(&folder, &[&fixed[..], &["--probes", "off", "--direct"], args].concat())
        };
        let (want, _) = by(&["all", "--samples", "4"]);
        let mean = want.iter().sum::<f64>() / want.len() as f64;
        let measured = |way: &[&str]| {
            let of = |seed| by(&[way, &["--samples", "16", "--seed", seed]].concat());
            let ((p, seconds), (q, _)) = (of("1"), of("2"));
            let square = p.iter().zip(&q).map(|(p, q)| (p - q).powi(2)).sum::<f64>() / p.len() as f64;
            let off = p.iter().chain(&q).sum::<f64>() / (2.0 * mean * p.len() as f64) - 1.0;
            let noise = (0.5 * square).sqrt() / mean;
            println!(
                "{n} lamps, {way:?}: noise {:.1} %, mean {:+.2} %, {seconds:.1} s",
                100.0 * noise,
                100.0 * off
            );
            (noise, off)
        };
        let tree = measured(&["lightcuts"]);
        let _ = measured(&["grid", "--direct-alpha", "2"]);
        let grid = measured(&["grid"]);
        assert!(grid.0 < 0.7 * tree.0 && grid.1.abs() < 0.015, "{grid:?} {tree:?}");
    }
}

/// The hall with 5,000 lamps and 50,000 emissive triangles, in equal time at least ten times the efficiency of choosing by intensity.
#[test]
fn a_hall_of_lamps() {
    if !suite::slow() {
        println!("skipped: a_hall_of_lamps: RUN_SLOW_TESTS is not 1");
        return;
    }
    let scene = lamps(5000, 50_000);
    let folder = tempfile::tempdir().unwrap();
    let path = write(&folder, "lamps.glb", &scene);
    let efficiency = |direct: &str| {
        let bake = |seed: &str| {
            let args = [&path, "--texels-per-metre", "2", "--samples", "64", "--direct", direct];
            hall(&folder, &[&args[..], &["--seed", seed]].concat())
        };
        let ((p, seconds), (q, _)) = (bake("1"), bake("2"));
        let mean = p.iter().sum::<f64>() / p.len() as f64;
        let square = p.iter().zip(&q).map(|(p, q)| (p - q).powi(2)).sum::<f64>() / p.len() as f64;
        let error = (0.5 * square).sqrt() / mean;
        println!("{direct}: {:.2} % in {seconds:.1} s", 100.0 * error);
        1.0 / (error * error * seconds)
    };
    let ours = efficiency("lightcuts");
    println!("{:.1} times as published", ours / efficiency("published"));
    let ratio = ours / efficiency("intensity");
    println!("{ratio:.1} times");
    assert!(10.0 < ratio, "{ratio}");
}
