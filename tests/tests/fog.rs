//! `--media table` against what a medium without bounds does, and what a folder says of media, lamps and sky.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use glam::Mat3;
use serde_json::json;
use std::f64::consts::{FRAC_PI_2, PI};
use suite::baked::{Baked, Page};
use suite::scenes::{closed, open};
use suite::shape::Shape;
use suite::tool;
use tables::format::manifest::{HeightDensity, Light, Medium, Sky};
use tables::harmonics::zonal::{CLAMPED_COSINE, double_product};
use tables::response::patch;
use tables::response::quadrature::tanh_sinh;
use tables::table::file::Emitter;
use tables::table::{Orders, Query, Tables};

/// Radiance scattered once at an angle to the way to a lamp of 1 cd, times the sine of the angle; sigma_t = 1, albedo 1: design by the angle
/// that points of the ray are seen under from the lamp (\[KF12\]).
fn once(depth: f64, theta: f64, g: f64) -> f64 {
    tanh_sinh(96)
        .iter()
        .map(|node| {
            // From the far end: the lamp's angle there is 0.
            let angle = node.x * (PI - theta);
            let r = depth * theta.sin() / angle.sin();
            let t = depth * (theta + angle).sin() / angle.sin();
            let x = -angle.cos();
            let phase = (1.0 - g * g) / (4.0 * PI * (1.0 + g * g - 2.0 * g * x).powf(1.5));
            node.w * (PI - theta) * (-(t + r)).exp() * phase / depth
        })
        .filter(|v| v.is_finite())
        .sum()
}

/// Clamped cosine of a plane, averaged around an axis that its normal has the angle `gamma` to, at the angle `theta` to the axis.
fn cosine_around(gamma: f64, theta: f64) -> f64 {
    let (a, b) = (gamma.cos() * theta.cos(), gamma.sin() * theta.sin());
    if b <= a.abs() {
        return a.max(0.0);
    }
    let turn = (-a / b).acos();
    (a * turn + b * turn.sin()) / PI
}

/// Irradiance by light that a medium without bounds scatters, of a lamp of 1 cd at an optical depth: once by quadrature, twice and more by
/// the file, whose error is below 1e-3.
fn truth(tables: &Tables, depth: f64, g: f64, albedo: f64, gamma: f64) -> f64 {
    let single: f64 = tanh_sinh(128)
        .iter()
        .map(|node| {
            let theta = node.x * PI;
            node.w * PI * 2.0 * PI * once(depth, theta, g) * cosine_around(gamma, theta)
        })
        .sum();
    let q = Query { emitter: Emitter::Point, depth, theta: 0.0, g, albedo, orders: Orders::Rest };
    let rest = tables.query(&q).expect("an answer").zh;
    albedo * single + double_product(&rest, &CLAMPED_COSINE, gamma.cos())
}

/// A lamp over a small patch in a medium with nothing else in it: 1 % of what a patch that faces the lamp receives for |g| up to 0.5, 3 % up to
/// 0.9. Behind the patch and beside it order 11 costs more of the little that arrives there; that is printed.
#[test]
fn a_lamp_in_endless_fog() {
    let tables = Tables::embedded().expect("the embedded file");
    let gammas: Vec<f64> = (0..=12).map(|i| f64::from(i) * PI / 12.0).collect();
    for g in [-0.9, -0.5, 0.0, 0.5, 0.8, 0.9] {
        let (mut worst, mut local) = (0.0f64, 0.0f64);
        for (depth, albedo) in [(0.01, 1.0), (0.1, 0.5), (0.5, 1.0), (1.0, 0.9), (3.0, 1.0), (8.0, 0.6)] {
            let height = 2.0;
            let sigma_t = depth / height;
            let fog = json!({ "sigma_s": albedo * sigma_t, "sigma_a": (1.0 - albedo) * sigma_t, "g": g });
            let dir = tool::folder_with(&open::lamp_in_fog(2.0, 1000.0, &fog));
            let at: Vec<_> = gammas.iter().map(|x| [[0.0; 3], [x.sin(), x.cos(), 0.0]]).collect();
            let got =
                tool::points(&dir.path().join("scene.glb"), &at, &["--media", "table", "--samples", "16"]);
            let unit = 1000.0 * sigma_t * sigma_t;
            let direct = |gamma: f64| 1000.0 / (height * height) * gamma.cos().max(0.0) * (-depth).exp();
            let facing = direct(0.0) + unit * truth(&tables, depth, g, albedo, 0.0);
            for (gamma, [value, _]) in gammas.iter().zip(&got) {
                let scattered = unit * truth(&tables, depth, g, albedo, *gamma);
                let off = value[0] - direct(*gamma) - scattered;
                worst = worst.max(off.abs() / facing);
                if FRAC_PI_2 <= *gamma {
                    local = local.max(off.abs() / scattered);
                }
            }
        }
        println!(
            "g {g}: {worst:.1e} of a receiver that faces the lamp, beside and behind {local:.1e} of the value there"
        );
        assert!(worst < if f64::abs(g) <= 0.5 { 0.01 } else { 0.03 }, "{g}: {worst}");
    }
}

/// What a lit or shining square sends to places above it, beside it and in its own plane: its patches' responses added up.
#[test]
fn a_square_in_endless_fog() {
    let tables = Tables::embedded().expect("the embedded file");
    let (sigma_t, albedo, g) = (0.6, 0.8, 0.3);
    let fog = json!({ "sigma_s": albedo * sigma_t, "sigma_a": (1.0 - albedo) * sigma_t, "g": g });
    // Position and normal; one lies in the square's plane, one looks away from it.
    let at = [
        [[0.2, 1.5, 0.1], [0.0, -1.0, 0.0]],
        [[1.5, 0.3, 0.0], [0.0, 1.0, 0.0]],
        [[0.9, 0.0, 0.2], [0.0, 1.0, 0.0]],
        [[0.7, 0.1, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, 2.0, 0.5], [0.0, 1.0, 0.0]],
    ];
    let lamp = |p: [f64; 3], n: [f64; 3]| {
        let d = [-p[0], 1.0 - p[1], -p[2]];
        let length = d.iter().map(|x| x * x).sum::<f64>().sqrt();
        let cos = (0..3).map(|i| d[i] * n[i]).sum::<f64>() / length;
        let depth = sigma_t * length;
        let q = Query { emitter: Emitter::Point, depth, theta: 0.0, g, albedo, orders: Orders::All };
        let zh = tables.query(&q).expect("an answer").zh;
        let glow = sigma_t * sigma_t * double_product(&zh, &CLAMPED_COSINE, cos);
        100.0 * (cos.max(0.0) * (-depth).exp() / (length * length) + glow)
    };
    for (emission, candela) in [(10.0f32, 0.0f32), (0.0, 100.0)] {
        let dir = tool::folder_with(&open::square_in_fog(emission, candela, &fog));
        let got = tool::points(
            &dir.path().join("scene.glb"),
            &at,
            &["--media", "table", "--bounces", "1", "--target-error", "0.002"],
        );
        for ([p, n], [value, error]) in at.iter().zip(&got) {
            let cells = 24;
            let mut want = 0.0;
            for i in 0..cells * cells {
                let on = |k: i32| (f64::from(k) + 0.5) / f64::from(cells) - 0.5;
                let y = [on(i % cells), 0.0, on(i / cells)];
                let d: [f64; 3] = std::array::from_fn(|k| y[k] - p[k]);
                let length = d.iter().map(|x| x * x).sum::<f64>().sqrt();
                let wi = d.map(|x| x / length);
                // Towards the square the way falls, so its upper side shines this way.
                let cos = -wi[1];
                let radiance = if candela == 0.0 { 10.0 } else { 0.5 / PI * lamp(y, [0.0, 1.0, 0.0]) };
                let z: f64 = (0..3).map(|k| wi[k] * n[k]).sum();
                let across = [wi[0] * cos, 1.0 + wi[1] * cos, wi[2] * cos];
                let sine = (1.0 - cos * cos).max(0.0).sqrt();
                let x = (0..3).map(|k| across[k] * n[k]).sum::<f64>() / sine.max(1e-12);
                let normal = [x, (1.0 - x * x - z * z).max(0.0).sqrt(), z];
                let q = Query {
                    emitter: Emitter::Area,
                    depth: sigma_t * length,
                    theta: cos.clamp(-1.0, 1.0).acos(),
                    g,
                    albedo,
                    orders: Orders::All,
                };
                let light = tables.query(&q).expect("an answer").light;
                let glow = sigma_t * sigma_t * patch::irradiance(&light, normal);
                let clear = cos.max(0.0) * z.max(0.0) * (-q.depth).exp() / (length * length);
                want += radiance * (glow + clear) / f64::from(cells * cells);
            }
            let lamp = if candela == 0.0 { 0.0 } else { lamp(*p, *n) };
            let got = value[0] - lamp;
            // Bands beyond the fourth are left out of what baking asks: 2 % of what a receiver that faces the square gets.
            let allowed = 0.02 * want + 3e-4 * lamp + 3.0 * error[0];
            println!("{p:?} {n:?}: {got} +- {} wanted {want}, and {lamp} of the lamp", error[0]);
            assert!((got - want).abs() < allowed, "{p:?} {n:?}: {value:?} {want}");
        }
    }
}

/// Signed volume of a closed shape, cubic metres.
fn volume(shape: &Shape) -> f64 {
    let six = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| shape.positions[i as usize].as_dvec3());
        a.dot(b.cross(c))
    };
    shape.triangles.iter().map(six).sum::<f64>() / 6.0
}

/// The mass that a medium's texture has: its mean times its volume.
fn mass(baked: &Baked, medium: &Medium) -> f64 {
    let texture = medium.texture.as_ref().expect("a texture");
    let reader = ktx2::Reader::new(&baked.files[&texture.file][..]).expect("a KTX2 file");
    let h = reader.header();
    assert_eq!(h.format, Some(ktx2::Format::R16_SFLOAT));
    assert_eq!([h.pixel_width, h.pixel_height, h.pixel_depth], texture.size);
    let data = reader.levels().next().expect("a level").data;
    let values: Vec<f64> =
        data.as_chunks::<2>().0.iter().map(|b| half::f16::from_le_bytes(*b).to_f64()).collect();
    assert!(values.iter().all(|v| (0.0..=65504.0).contains(v)));
    let matrix = Mat3::from_cols_array_2d(&[0, 1, 2].map(|i| texture.unit_from_world[i]));
    values.iter().sum::<f64>() / values.len() as f64 / f64::from(matrix.determinant())
}

/// What a game needs to draw fog and lamps is in the folder: media of every kind with their mass, and lamps in the units that they are read in.
#[test]
fn folders_say_what_media_and_lamps_are() {
    let few = ["--samples", "1", "--texels-per-metre", "2", "--grid-nodes", "64", "--probes", "off"];
    let scene = open::all_media();
    let baked = tool::baked(&scene, &few);
    let [cloud, haze, grid] = &baked.manifest.media[..] else { panic!("{:?}", baked.manifest.media) };
    assert_eq!(haze.height, Some(HeightDensity { base: 0.5, falloff: 2.0 }));
    assert!(haze.unit_from_world.is_none() && haze.texture.is_none());
    assert_eq!((haze.sigma_s, haze.sigma_a), ([0.01; 3], [0.0; 3]));
    // Voxels of 0.5 x 1/3 x 1 m.
    let want = (0..24u8).map(|i| f64::from(i % 5)).sum::<f64>() / 6.0;
    assert!((mass(&baked, grid) / want - 1.0).abs() < 1e-3, "{} {want}", mass(&baked, grid));
    let texture = grid.texture.as_ref().expect("a texture");
    assert_eq!((texture.file.as_str(), texture.size), ("medium-2.ktx2", [2, 3, 4]));
    assert_eq!(grid.unit_from_world, Some(texture.unit_from_world));
    let want = volume(&open::ball());
    println!("{} of {want} cubic metres", mass(&baked, cloud));
    assert!((mass(&baked, cloud) / want - 1.0).abs() < 1e-3, "{} {want}", mass(&baked, cloud));
    assert_eq!((cloud.path.as_str(), cloud.g, cloud.sigma_s), ("cloud", 0.5, [0.5, 0.25, 0.125]));
    assert!(cloud.height.is_none() && cloud.unit_from_world.is_some());

    let off = tool::baked(&scene, &[&few[..], &["--media", "off"]].concat());
    assert!(off.manifest.media.is_empty() && !off.files.contains_key("medium-2.ktx2"));
    let watts =
        tool::baked(&scene, &[&few[..], &["--media", "off", "--light-units", "blender-raw"]].concat());
    for (baked, candela, lux) in [(&off, 1.0, 1.0), (&watts, 683.0 / (4.0 * std::f32::consts::PI), 683.0)] {
        let [point, spot, sun] = &baked.manifest.lights[..] else { panic!("{:?}", baked.manifest.lights) };
        let is = |light: &Light, want: [f32; 3]| {
            let got = light.intensity.expect("numbers");
            assert!((0..3).all(|c| (got[c] / want[c] - 1.0).abs() < 1e-5), "{got:?} {want:?}");
        };
        is(point, [8.0, 4.0, 2.0].map(|v| v * candela));
        is(spot, [4.0 * candela; 3]);
        is(sun, [2.0 * lux; 3]);
        assert_eq!((point.position, point.direction, point.cone), (Some([1.0, 1.5, -0.5]), None, None));
        assert_eq!((spot.position, spot.cone), (Some([-1.0, 2.0, 0.0]), Some([0.25, 0.5])));
        assert_eq!((sun.position, sun.range), (None, None));
        for light in [spot, sun] {
            let down = glam::Vec3::from(light.direction.expect("a direction"));
            assert!((down + glam::Vec3::Y).length() < 1e-6, "{down}");
        }
    }
}

/// Texels below the block that stands on the floor lie inside of it, and pages say so; where no texel does, they do not.
#[test]
fn pages_say_which_texels_were_filled() {
    let few = ["--samples", "1", "--texels-per-metre", "8", "--media", "off", "--probes", "off"];
    let baked = tool::baked(&closed::room(closed::Room::default()), &few);
    let filled = baked.manifest.counts.filled_texels;
    assert!(0 < filled, "{:?}", baked.manifest.counts);
    let mut marked = 0;
    for page in &baked.pages {
        let Some(flags) = page.channels.get("filled") else { continue };
        for (flag, coverage) in flags.iter().zip(&page.channels["A"]) {
            assert!(*flag == 0.0 || (*flag == 1.0 && 0.0 < *coverage), "{flag} {coverage}");
            marked += u64::from(*flag == 1.0);
        }
    }
    assert_eq!(marked, filled);
    let clear = tool::baked(&open::under_sky(2.0, 1, [1.0; 3]), &few);
    assert_eq!(clear.manifest.counts.filled_texels, 0);
    assert!(!clear.pages[0].channels.contains_key("filled"));
}

/// The image of a sky is in the folder with its scale, and without its rotation.
#[test]
fn folders_hold_the_image_of_the_sky() {
    let dir = tool::folder_with(&open::under_sky(2.0, 1, [1.0; 3]));
    let image =
        image::Rgb32FImage::from_fn(4, 2, |x, y| image::Rgb([f32::from(u8::from(x == 1)), y as f32, 0.5]));
    image.save(dir.path().join("dome.hdr")).expect("saved");
    let words = "sky = { file = \"dome.hdr\", scale = 3, rotation = 90 }\n";
    std::fs::write(dir.path().join("sky.toml"), words).expect("a file");
    let args = ["run", "scene.glb", "-o", "out", "--progress", "none", "--config", "sky.toml"];
    let few = ["--samples", "1", "--texels-per-metre", "2", "--probes", "off"];
    let _ = tool::bake(&[&args[..], &few].concat(), dir.path()).expect(0);
    let baked = Baked::read(&dir.path().join("out")).expect("a bake");
    let Sky::Image { file: Some(file), scale, .. } = &baked.manifest.sky else {
        panic!("{:?}", baked.manifest.sky)
    };
    assert_eq!((file.as_str(), *scale), ("sky.exr", 3.0));
    assert!(baked.manifest.files.iter().any(|f| f.name == *file));
    let page = Page::read(&dir.path().join("out").join(file)).expect("an EXR");
    for (x, y) in (0..2).flat_map(|y| (0..4).map(move |x| (x, y))) {
        let want = glam::Vec3::new(f32::from(u8::from(x == 1)), y as f32, 0.5) * 3.0;
        assert!((page.rgb("", x, y) - want).length() < 0.02, "{x} {y}: {}", page.rgb("", x, y));
    }
}

/// Real smoke that only absorbs, in front of a lamp: what `attenuate` and `table` say is what unbiased paths find. Level sets are refused.
#[test]
fn smoke_that_absorbs() {
    let Some(shared) = suite::shared("smoke_that_absorbs") else { return };
    let volumes = shared.join("scenes/volumes");
    let smoke = |file: &str, more: &str| {
        let path = volumes.join(file);
        format!(
            "media = [{{ sigma_a = [2, 4, 8], {more} density = {{ vdb = {:?} }}, box = {{ min = [-0.7, 0.6, -0.7], max = [0.7, 3.4, 0.7] }} }}]\n",
            path.to_str().expect("a readable path")
        )
    };
    let dir = tempfile::tempdir().expect("a folder");
    let config = dir.path().join("smoke.toml");
    let config_path = config.to_str().expect("a readable path");
    std::fs::write(&config, smoke("openvdb-smoke.vdb", "")).expect("a file");
    let room = shared.join("oracles/rooms/surface_point.glb");
    let at = [
        [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[0.3, 0.0, -0.2], [0.0, 1.0, 0.0]],
        [[1.5, 0.0, 0.0], [0.0, 1.0, 0.0]],
    ];
    let of = |mode: &str| {
        tool::points(&room, &at, &["--config", config_path, "--media", mode, "--target-error", "0.005"])
    };
    let reference = of("reference");
    for mode in ["attenuate", "table"] {
        for ((got, want), [p, _]) in of(mode).iter().zip(&reference).zip(&at) {
            for c in 0..3 {
                let allowed = 4.0 * got[1][c].hypot(want[1][c]);
                assert!((got[0][c] - want[0][c]).abs() < allowed, "{mode} {p:?}: {got:?} {want:?}");
            }
        }
    }
    assert!(reference[0][0][2] < 0.9 * reference[0][0][0], "{reference:?}: the smoke is in the way");
    std::fs::write(&config, smoke("openvdb-sphere.vdb", "")).expect("a file");
    let scene = room.to_str().expect("a readable path");
    let refused = tool::bake(&["check", scene, "--config", config_path], dir.path()).expect(2);
    assert!(
        refused.stderr.contains("level set") && refused.stderr.contains("media[0].density.vdb"),
        "{refused}"
    );
}
