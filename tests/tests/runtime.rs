//! The runtime sample shows what was baked, from the folder alone.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::{fs, path::Path, time::Duration};

use glam::Vec3;
use serde_json::json;
use suite::{
    gltf::{Glb, Material, Node},
    shape::Shape,
    tool::{self, Finished},
};

fn show(args: &[&str], dir: &Path) -> Finished {
    tool::start(tool::runtime_sample_path(), args, dir).wait(Duration::from_secs(60))
}

/// A floor of albedo 0.5 under a sky of 1 nit, seen from above, baked into `out`.
fn baked_floor() -> tempfile::TempDir {
    let mut glb = Glb::new();
    let grey = glb.material(&Material::matte("grey", [0.5, 0.25, 0.125]));
    let mut quad = Shape::default();
    quad.grid(Vec3::new(-50.0, 0.0, 50.0), Vec3::X * 100.0, Vec3::NEG_Z * 100.0, 1, 1);
    let mesh = glb.mesh("floor", &[(&quad, grey)]);
    glb.node(Node::new("floor").mesh(mesh));
    glb.camera("above", Vec3::new(0.0, 2.0, 0.0), Vec3::new(0.0, 0.0, -2.0), 0.8);
    glb.scene_extra("sky", json!([1, 1, 1]));
    let dir = tool::folder_with(&glb.finish());
    let args = ["run", "scene.glb", "-o", "out", "--samples", "64", "--texels-per-metre", "0.5"];
    let _ = tool::bake(&args, dir.path()).expect(0);
    dir
}

#[test]
fn pictures_show_albedo_times_lightmap() {
    let dir = baked_floor();
    let args = ["out", "--screenshot", "view.png", "--exposure", "2"];
    let done = show(&args, dir.path()).expect(0);
    assert!(done.stdout.contains("page 0") && done.stdout.contains("1 surfaces"), "{done}");
    let picture = image::open(dir.path().join("view.png")).unwrap().to_rgb8();
    // Radiance 0.5, 0.25, 0.125 times 2, then v / (1 + v): 1/2, 1/3, 1/5 in sRGB.
    for (x, y) in [(0.5, 0.5), (0.1, 0.9), (0.9, 0.3)] {
        let at = |n: u32, part: f64| (0..n).find(|i| part * f64::from(n) < f64::from(i + 1)).unwrap();
        let got = picture.get_pixel(at(picture.width(), x), at(picture.height(), y));
        for (got, want) in got.0.into_iter().zip([188u8, 156, 124]) {
            assert!(got.abs_diff(want) <= 1, "{got} and {want} at {x}, {y}");
        }
    }
    let done = show(&["out", "--screenshot", "view.png", "--camera", "1"], dir.path()).expect(2);
    assert!(done.stderr.contains("camera 1 of 1"), "{done}");
}

#[test]
fn what_is_missing_or_damaged_is_named() {
    let dir = baked_floor();
    let out = dir.path().join("out");
    let refused = |word: &str| {
        let done = show(&["out"], dir.path()).expect(2);
        assert!(done.stderr.contains(word), "`{word}` is not said\n{done}");
    };
    let page = out.join("lightmap-0.exr");
    let bytes = fs::read(&page).unwrap();
    fs::write(&page, &bytes[..bytes.len() / 2]).unwrap();
    refused("lightmap-0.exr");
    fs::remove_file(&page).unwrap();
    refused("lightmap-0.exr");
    let manifest = fs::read_to_string(out.join("manifest.json")).unwrap();
    fs::write(out.join("manifest.json"), manifest.replacen("\"version\": 1", "\"version\": 99", 1)).unwrap();
    refused("version 99 is newer");
    fs::remove_file(out.join("manifest.json")).unwrap();
    refused("is this a folder that `bake run` wrote?");
}
