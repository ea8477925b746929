//! Media that emit: equilibrium, closed forms, and unbiased paths.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use glam::{DVec3, Vec3};
use std::path::Path;
use suite::baked::Baked;
use suite::gltf::{Glb, Material, Node};
use suite::scenes::{closed, fire};
use suite::shape::Shape;
use suite::tool;
use tables::probes::ProbeVolume;

/// Mean over all covered texels of the channel that is farthest from `want`.
fn farthest(baked: &Baked, want: f64) -> f64 {
    let page = &baked.pages[0];
    let covered = || (0..page.channels["A"].len()).filter(|i| 0.0 < page.channels["A"][*i]);
    let mean =
        |c: &str| covered().map(|i| f64::from(page.channels[c][i])).sum::<f64>() / covered().count() as f64;
    ["R", "G", "B"]
        .map(mean)
        .into_iter()
        .max_by(|a, b| (a - want).abs().total_cmp(&(b - want).abs()))
        .unwrap_or(0.0)
}

/// A medium that emits as much as it absorbs of the light in a furnace changes nothing, wherever it is, however dense it is, and
/// whatever it scatters (Kirchhoff's law): walls and medium are as bright.
#[test]
fn a_furnace_in_equilibrium_stays_white() {
    let mut faults = Vec::new();
    let cube = "box = { min = [-0.5, -0.5, -0.5], max = [0.5, 0.5, 0.5] }";
    let half = "box = { min = [-0.3, -0.5, -0.4], max = [0.5, 0.2, 0.1] }";
    let noise = "density = { noise = { seed = 3, scale = 2, resolution = 24 } }";
    for (medium, modes) in [
        ("sigma_a = 1, emission = 2".to_owned(), &["attenuate", "bounded", "reference", "table"][..]),
        (
            format!("sigma_a = [0.3, 1, 8], emission = [0.6, 2, 16], {half}"),
            &["attenuate", "bounded", "reference"],
        ),
        (format!("sigma_a = 5, emission = 10, {noise}, {cube}"), &["attenuate", "bounded", "reference"]),
        (format!("sigma_a = 2, emission = 4, sigma_s = 3, g = 0.4, {half}"), &["bounded", "reference"]),
        (format!("sigma_a = 2, emission = 4, sigma_s = 1, {noise}, {cube}"), &["bounded", "reference"]),
    ] {
        for mode in modes {
            let args = ["--samples", "128", "--texels-per-metre", "6", "--media", mode, "--probes", "off"];
            let baked = tool::baked_in(&closed::furnace(0.5, 1.0), &format!("{{ {medium} }}"), &args);
            let off = farthest(&baked, 2.0) / 2.0 - 1.0;
            println!("{medium}, {mode}: {:+.2} %", 100.0 * off);
            faults.extend((0.005 < off.abs()).then(|| format!("{medium}, {mode}: {off}")));
        }
    }
    assert!(faults.is_empty(), "{faults:?}");
}

/// A black floor of 4 m, at y = 0.
fn black_floor() -> Vec<u8> {
    let mut glb = Glb::new();
    let black = glb.material(&Material::matte("black", [0.0; 3]));
    let mut s = Shape::default();
    s.grid(Vec3::new(-2.0, 0.0, 2.0), Vec3::X * 4.0, Vec3::Z * -4.0, 1, 1);
    let mesh = glb.mesh("floor", &[(&s, black)]);
    glb.node(Node::new("floor").mesh(mesh));
    glb.finish()
}

/// `E / pi` at a place on the floor of a stencil of 2 x 2 x 2 voxels of half a metre above it, which emit and absorb: a sum over small cubes,
/// each weakened by what is on a straight line to the place.
fn brute(at: DVec3, values: &[f64; 8], sigma: f64, emission: f64) -> f64 {
    const FINE: u32 = 24;
    let (low, voxel) = (DVec3::new(-0.5, 0.5, -0.5), 0.5);
    let density = |p: DVec3| {
        let v = ((p - low) / voxel).floor();
        let inside = 0.0 <= v.min_element() && v.max_element() < 2.0;
        let number = v.x + 2.0 * v.y + 4.0 * v.z;
        let found = (0..8).find(|i| f64::from(*i) == number).filter(|_| inside);
        found.map_or(0.0, |i: u8| values[usize::from(i)])
    };
    let side = 2.0 * voxel / f64::from(FINE);
    let mut sum = 0.0;
    for i in 0..FINE * FINE * FINE {
        let cell = DVec3::new(f64::from(i % FINE), f64::from(i / FINE % FINE), f64::from(i / (FINE * FINE)));
        let p = low + (cell + 0.5) * side;
        let way = p - at;
        let steps = 1000;
        let depth: f64 =
            (0..steps).map(|k| density(at + way * ((f64::from(k) + 0.5) / f64::from(steps)))).sum();
        let left = (-sigma * depth * way.length() / f64::from(steps)).exp();
        let r2 = way.length_squared();
        sum += density(p) * emission * left * (way.y / r2.sqrt()) / r2 * side.powi(3);
    }
    sum / std::f64::consts::PI
}

/// What arrives of a grid that emits and absorbs, against a sum over its volume; all ways to follow light agree where nothing scatters.
#[test]
fn a_glowing_grid_lights_the_floor_as_its_volume_does() {
    let values = [1.0, 0.0, 0.5, 4.0, 0.0, 2.0, 1.0, 0.25];
    let medium = "{ sigma_a = 0.8, emission = { color = [1, 0.5, 0.25], strength = 3, stencil = { size = [2, 2, 2], values = [1, 0, 0.5, 4, 0, 2, 1, 0.25] } }, \
        density = { stencil = { size = [2, 2, 2], values = [1, 0, 0.5, 4, 0, 2, 1, 0.25] } }, \
        box = { min = [-0.5, 0.5, -0.5], max = [0.5, 1.5, 0.5] } }";
    let dir = tempfile::tempdir().expect("a folder");
    let (scene, config) = (dir.path().join("scene.glb"), dir.path().join("fire.toml"));
    std::fs::write(&scene, black_floor()).expect("a file");
    std::fs::write(&config, format!("media = [{medium}]\n")).expect("a file");
    let places = [[0.0, 0.0, 0.0], [0.4, 0.0, -0.3], [1.5, 0.0, 1.0], [-1.0, 0.0, 0.2]];
    let at: Vec<[[f64; 3]; 2]> = places.iter().map(|p| [*p, [0.0, 1.0, 0.0]]).collect();
    for mode in ["attenuate", "bounded", "reference"] {
        let args = ["--config", config.to_str().expect("a path"), "--media", mode, "--samples", "16384"];
        for (p, [lux, error]) in places.iter().zip(tool::points(&scene, &at, &args)) {
            let want = std::f64::consts::PI * brute(DVec3::from(*p), &values, 0.8, 3.0);
            for (k, part) in [1.0, 0.5, 0.25].into_iter().enumerate() {
                let off = lux[k] / (want * part) - 1.0;
                println!("{mode}, {p:?}: {:.5} of {:.5} lux, {:+.2} %", lux[k], want * part, 100.0 * off);
                assert!(off.abs() < 0.003 + 3.0 * error[k] / (want * part), "{mode} {p:?}: {off}");
            }
        }
    }
}

/// A bake of the dark room with what `media` writes into its folder: the configuration.
fn dark_room(media: impl Fn(&Path) -> String, args: &[&str]) -> Baked {
    let dir = tool::folder_with(&fire::dark_room());
    let config = dir.path().join("fire.toml");
    std::fs::write(&config, media(dir.path())).expect("a file");
    let fixed = ["run", "scene.glb", "-o", "out", "--config", "fire.toml", "--texels-per-metre", "3"];
    let plain = ["--seams", "off", "--progress", "none"];
    let probes: &[&str] = if args.contains(&"--probes") { &[] } else { &["--probes", "off"] };
    let media: &[&str] = if args.contains(&"--media") { &[] } else { &["--media", "attenuate"] };
    let _ = tool::bake(&[&fixed[..], &plain, probes, media, args].concat(), dir.path()).expect(0);
    Baked::read(&dir.path().join("out")).expect("a bake")
}

/// A fireball of 24^3 voxels.
fn fireball(sigma: f32) -> impl Fn(&Path) -> String {
    move |folder| fire::explosion(24, 0.5).write(folder, (20_000.0, sigma), None)
}

/// Texels of a bake, and their mean luminance.
fn texels(baked: &Baked) -> (Vec<f64>, f64) {
    let page = &baked.pages[0];
    let covered = (0..page.channels["A"].len()).filter(|i| 0.0 < page.channels["A"][*i]);
    let texels: Vec<f64> = covered
        .map(|i| {
            [("R", 0.2126), ("G", 0.7152), ("B", 0.0722)].map(|(c, w)| w * f64::from(page.channels[c][i]))
        })
        .map(|rgb| rgb.iter().sum())
        .collect();
    let mean = texels.iter().sum::<f64>() / texels.len() as f64;
    (texels, mean)
}

/// Texels of a bake of the dark room with a fireball, and their mean luminance.
fn lit_room(sigma: f32, args: &[&str]) -> (Vec<f64>, f64) {
    texels(&dark_room(fireball(sigma), args))
}

/// By how much texels and their mean are off, of the mean.
fn off((got, own): &(Vec<f64>, f64), (want, mean): &(Vec<f64>, f64)) -> (f64, f64) {
    let off = want.iter().zip(got).map(|(a, b)| (a - b).abs()).sum::<f64>() / (mean * want.len() as f64);
    (own / mean - 1.0, off)
}

/// A fireball as a lighting grid hierarchy, against directions and places that are chosen for what it emits: within 1 % where hardly anything dims it, and 4 % in
/// dense smoke.
#[test]
fn a_hierarchy_of_lights_is_as_bright_as_the_fire() {
    for (sigma, most) in [(0.004, 0.01), (4.0, 0.04)] {
        let (want, mean) = lit_room(sigma, &["--samples", "1024", "--fire", "paths"]);
        let (got, own) = lit_room(sigma, &["--samples", "128", "--fire", "grid"]);
        let off = want.iter().zip(&got).map(|(a, b)| (a - b).abs()).sum::<f64>() / (mean * want.len() as f64);
        println!("sigma {sigma}: mean {:+.2} %, texels {:.2} % off", 100.0 * (own / mean - 1.0), 100.0 * off);
        assert!((own / mean - 1.0).abs() < most, "{own} of {mean}");
    }
}

/// Frames are baked one after the other into folders of their own, each as it is alone; frames that are not there leave those that are.
#[test]
fn frames_of_a_sequence_are_baked_as_they_are_alone() {
    let dir = tool::folder_with(&fire::dark_room());
    let mut config = String::new();
    for k in 2..=4u8 {
        config = fire::explosion(12, 0.15 * f32::from(k)).write(dir.path(), (2e4, 4.0), Some(u32::from(k)));
    }
    std::fs::write(dir.path().join("fire.toml"), config).expect("a file");
    let fixed = ["run", "scene.glb", "--config", "fire.toml", "--texels-per-metre", "2", "--samples", "8"];
    let more = ["--probes", "off", "--media", "attenuate", "--fire", "grid", "--progress", "none"];
    let args = |own: &[&'static str]| [&fixed[..], &more, own].concat();
    let _ = tool::bake(&args(&["-o", "all", "--frames", "2..4"]), dir.path()).expect(0);
    let _ = tool::bake(&args(&["-o", "alone", "--frame", "3"]), dir.path()).expect(0);
    let read = |path: &str| std::fs::read(dir.path().join(path)).expect("a file");
    assert!(read("all/frame-0003/lightmap-0.exr") == read("alone/lightmap-0.exr"), "a frame alone differs");
    assert!(read("all/frame-0002/lightmap-0.exr") != read("alone/lightmap-0.exr"), "frames are alike");
    let json: serde_json::Value = serde_json::from_slice(&read("all/frames.json")).expect("JSON");
    let list = json["frames"].as_array().expect("a list");
    assert_eq!(list.iter().map(|f| f["frame"].as_u64()).collect::<Vec<_>>(), [Some(2), Some(3), Some(4)]);
    assert!(list[0]["change"].is_null() && 0.0 < list[2]["change"]["rms"].as_f64().expect("a number"));
    // Without a number, and with one too many.
    let none = tool::bake(&args(&["-o", "none"]), dir.path()).expect(2);
    assert!(
        none.stderr.contains("media[0].density.raw") && none.stderr.contains("--frames"),
        "{}",
        none.stderr
    );
    let many = tool::bake(&args(&["-o", "many", "--frames", "4..5"]), dir.path()).expect(2);
    assert!(many.stderr.contains("smoke.0005.raw"), "{}", many.stderr);
    let left: serde_json::Value = serde_json::from_slice(&read("many/frames.json")).expect("JSON");
    assert_eq!(left["frames"].as_array().map(Vec::len), Some(1));
    assert!(
        dir.path().join("many/frame-0004/manifest.json").is_file()
            && !dir.path().join("many/frame-0005").exists()
    );
}

/// What smoke scatters of its fire, as lights beside those of the fire, against paths that find it by directions.
#[test]
fn smoke_that_scatters_is_as_bright_as_lights() {
    let args = |own: &[&'static str]| [&["--media", "bounded"][..], own].concat();
    let (want, mean) = lit_room(4.0, &args(&["--samples", "1024", "--fire", "paths"]));
    let (got, own) = lit_room(4.0, &args(&["--samples", "64", "--fire", "grid"]));
    let off = want.iter().zip(&got).map(|(a, b)| (a - b).abs()).sum::<f64>() / (mean * want.len() as f64);
    println!("mean {:+.2} %, texels {:.2} % off", 100.0 * (own / mean - 1.0), 100.0 * off);
    assert!((own / mean - 1.0).abs() < 0.04 && off < 0.07, "{own} of {mean}, {off}");
    // What the smoke scatters is a good part of the light: without it the test would mean little.
    let (_, alone) = lit_room(4.0, &["--samples", "64", "--fire", "grid"]);
    assert!(alone < 0.8 * own, "{alone} of {own} without scattering");
}

/// Levels built from levels and the published blending are as good as they are said to be: the same light within some per cent, and not the same texels.
#[test]
fn hierarchies_can_be_built_and_blended_otherwise() {
    let by =
        |args: &[&'static str]| lit_room(4.0, &[&["--samples", "64", "--fire", "grid"][..], args].concat());
    let usual = by(&[]);
    for args in [["--fire-build", "below"], ["--fire-blend", "published"]] {
        let (mean, texels) = off(&by(&args), &usual);
        println!("{args:?}: mean {:+.2} %, texels {:.2} % apart", 100.0 * mean, 100.0 * texels);
        assert!(mean.abs() < 0.05 && 1e-4 < texels && texels < 0.1, "{args:?}: {mean}, {texels}");
    }
}

/// Probes lit by a hierarchy against probes whose rays meet the fire: by coefficients, with smoke that only takes and with smoke that scatters.
#[test]
fn probes_by_a_hierarchy_are_as_bright() {
    for media in ["attenuate", "bounded"] {
        let of = |fire: &str, samples: &str| {
            let args = ["--media", media, "--samples", "1", "--fire", fire, "--probes", "l2"];
            let more = ["--probe-count", "150", "--probe-samples", samples];
            let baked = dark_room(fireball(4.0), &[&args[..], &more].concat());
            ProbeVolume::from_bytes(&baked.files[&baked.manifest.probes[0].file]).expect("probes")
        };
        let (want, got) = (of("paths", "2048"), of("grid", "256"));
        assert_eq!(want.probes.len(), got.probes.len());
        let (mut all, mut mean, mut off, mut direction) = (0.0, 0.0, 0.0, 0.0);
        for (a, b) in want.probes.iter().zip(&got.probes) {
            let (a, b) = (a.light.coefficients(), b.light.coefficients());
            let of = |c: &[f32; 3]| f64::from(c[0] * 0.2126 + c[1] * 0.7152 + c[2] * 0.0722);
            all += of(&a[0]);
            mean += of(&b[0]) - of(&a[0]);
            off += (of(&b[0]) - of(&a[0])).abs();
            direction += (1..4).map(|k| (of(&b[k]) - of(&a[k])).powi(2)).sum::<f64>().sqrt();
        }
        let [mean, off, direction] = [mean, off, direction].map(|x| x / all);
        println!(
            "{media}, {} probes: mean {:+.2} %, {:.2} % off, directions {:.2} %",
            want.probes.len(),
            100.0 * mean,
            100.0 * off,
            100.0 * direction
        );
        assert!(mean.abs() < 0.05 && off < 0.08 && direction < 0.08, "{media}: {mean}, {off}, {direction}");
    }
}

/// An ember within smoke that was simulated elsewhere: 2.8 million voxels.
#[test]
fn an_ember_shines_through_real_smoke() {
    let Some(shared) = suite::shared("an_ember_shines_through_real_smoke") else { return };
    let smoke = shared.join("scenes/volumes/openvdb-smoke.vdb");
    let media = |_: &Path| {
        format!(
            "media = [{{ sigma_s = 1.5, sigma_a = 1.5, density = {{ vdb = {:?} }}, box = {{ min = [-1, 0.1, -1], max = [1, 3.9, 1] }} }},
             {{ emission = [60000, 20000, 5000], box = {{ min = [-0.15, 0.7, -0.15], max = [0.15, 1, 0.15] }} }}]\n",
            smoke.to_str().expect("a readable path")
        )
    };
    let by = |args: &[&'static str]| texels(&dark_room(media, args));
    for mode in ["attenuate", "bounded"].into_iter().filter(|m| *m == "bounded" || suite::slow()) {
        let (want, got) = (
            by(&["--media", mode, "--samples", "512", "--fire", "paths"]),
            by(&["--media", mode, "--samples", "64", "--fire", "grid"]),
        );
        let (mean, texels) = off(&got, &want);
        println!("{mode}: mean {:+.2} %, texels {:.2} % off", 100.0 * mean, 100.0 * texels);
        assert!(mean.abs() < 0.05 && texels < 0.1, "{mode}: {mean}, {texels}");
    }
}
