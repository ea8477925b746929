//! Directional lightmaps: what a normal map makes of them, against closed forms.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use glam::Vec3;
use std::f32::consts::PI;
use std::io::Read as _;
use suite::baked::{Baked, Page};
use suite::scenes::closed::{Room, room};
use suite::scenes::open;
use suite::tool;

/// Means of `E / pi` and of the vector over whole texels.
fn means(baked: &Baked) -> (f32, Vec3) {
    let (mut flat, mut s, mut n) = (0.0, Vec3::ZERO, 0.0);
    for page in &baked.pages {
        let of = |c: &str| &page.channels[c];
        for i in (0..of("A").len()).filter(|i| 0.99 < of("A")[*i]) {
            flat += of("G")[i];
            s += Vec3::new(of("sh1.x.G")[i], of("sh1.y.G")[i], of("sh1.z.G")[i]);
            n += 1.0;
        }
    }
    assert!(30.0 < n);
    (flat / n, s / n)
}

/// Half of the value upwards and nothing across, texel by texel as far as paths go.
#[test]
fn a_sky_comes_from_everywhere() {
    let scene = open::under_sky(4.0, 1, [1.0, 2.0, 3.0]);
    let args = ["--samples", "256", "--texels-per-metre", "4", "--directional"];
    let baked = tool::baked(&scene, &args);
    let (flat, s) = means(&baked);
    println!("E/pi {flat}, s {s}");
    assert!((flat - 2.0).abs() < 0.02 && (s.y - 1.0).abs() < 0.01, "{flat} {s}");
    assert!(s.x.abs() < 0.01 && s.z.abs() < 0.01, "{s}");
    let page = &baked.pages[0];
    let worst = page.channels["sh1.x.G"].iter().fold(0.0f32, |m, v| m.max(v.abs()));
    println!("across the normal a texel has up to {worst} nits");
    assert!(worst < 0.25);
}

/// A sun at 45 degrees: illuminance over 2 pi along its direction, and so a normal that leans towards it has more.
#[test]
fn a_sun_comes_from_its_place() {
    let wi = Vec3::new(1.0, 1.0, 0.0).normalize();
    let scene = open::under_sun(100.0, -wi, 0.0);
    let args = ["--samples", "16", "--texels-per-metre", "2", "--directional"];
    let (flat, s) = means(&tool::baked(&scene, &args));
    let want = wi * (100.0 / (2.0 * PI));
    println!("E/pi {flat}, s {s}, wanted {want}");
    assert!((flat - 100.0 * wi.y / PI).abs() < 1e-3 * flat);
    assert!((s - want).length() < 5e-3 * want.length(), "{s} {want}");
    let lean = Vec3::new(0.6, 0.8, 0.0);
    let value = flat + s.dot(lean - Vec3::Y);
    let first_bands = 100.0 / PI * (0.5 * wi.y + 0.5 * wi.dot(lean));
    assert!((value - first_bands).abs() < 0.01 * value, "{value} {first_bands}");
}

/// What is written is finite, half of `E / pi` along flat surfaces' normals, and leaves `E / pi` as it is without it.
#[test]
fn every_light_of_a_room_has_a_direction() {
    let args = ["--samples", "32", "--texels-per-metre", "6", "--seams", "off"];
    let plain = tool::baked(&room(Room::default()), &args);
    let baked = tool::baked(&room(Room::default()), &[&args[..], &["--directional"]].concat());
    assert!(!plain.pages[0].channels.keys().any(|c| c.starts_with("sh1")));
    let mut across = 0;
    for (a, b) in plain.pages.iter().zip(&baked.pages) {
        assert_eq!(a.channels["G"], b.channels["G"]);
        assert_eq!(b.channels.keys().filter(|c| c.starts_with("sh1")).count(), 9);
        assert_eq!(texture_of(&baked)[0], half_floats(b));
        for i in (0..b.channels["A"].len()).filter(|i| 0.0 < b.channels["A"][*i]) {
            let s = Vec3::new(b.channels["sh1.x.G"][i], b.channels["sh1.y.G"][i], b.channels["sh1.z.G"][i]);
            let e = b.channels["G"][i];
            // The part along the normal is half of the value.
            assert!((0.495 * e..=1.001 * e).contains(&s.length()), "{s} {e}");
            across += usize::from(0.75 * e < s.length());
        }
    }
    assert!(50 < across, "{across} texels lit from the side");
}

/// Texels of the texture of directions, layer by layer; read with another reader.
fn texture_of(baked: &Baked) -> Vec<Vec<u16>> {
    let of = |page: &tables::format::manifest::Page| {
        let name = page.directions.as_ref().expect("a texture of directions");
        let reader = ktx2::Reader::new(&baked.files[name][..]).expect("a KTX2 file");
        let h = reader.header();
        assert_eq!((h.format, h.layer_count), (Some(ktx2::Format::R16G16B16A16_SFLOAT), 3));
        assert_eq!([h.pixel_width, h.pixel_height], [page.width, page.height]);
        let packed = reader.levels().next().expect("a level").data;
        let mut bytes = Vec::new();
        let mut decoder = ruzstd::decoding::StreamingDecoder::new(packed).expect("Zstandard");
        decoder.read_to_end(&mut bytes).expect("Zstandard");
        bytes.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])).collect()
    };
    baked.manifest.pages.iter().map(of).collect()
}

/// What that texture has to be: the EXR, rounded.
fn half_floats(page: &Page) -> Vec<u16> {
    let half = |c: &str, i: usize| half::f16::from_f32(page.channels[c][i]).to_bits();
    let mut out = Vec::new();
    for axis in ["x", "y", "z"] {
        for i in 0..page.width * page.height {
            out.extend(["R", "G", "B"].map(|c| half(&format!("sh1.{axis}.{c}"), i)));
            out.push(half("A", i));
        }
    }
    out
}

#[test]
fn what_directional_maps_cannot_have_is_said() {
    let dir = tool::folder_with(&open::under_sky(1.0, 1, [1.0; 3]));
    for (args, word) in [(["--media", "table"], "table"), (["--time-budget", "10s"], "time budget")] {
        let run = ["run", "scene.glb", "-o", "out", "--directional"];
        let done = tool::bake(&[&run[..], &args].concat(), dir.path()).expect(2);
        assert!(done.stderr.contains(word), "{done}");
    }
}
