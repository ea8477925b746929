//! `lightmap-N.ktx2` as an engine reads it, beside the EXR of the same page.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use half::f16;
use ktx2::SupercompressionScheme;
use std::io::Read;
use suite::baked::{Baked, Page};
use suite::scenes::closed::{Room, room};
use suite::scenes::open;
use suite::tool;

/// Some seconds for a room of several charts.
const COARSE: [&str; 6] = ["--samples", "8", "--texels-per-metre", "6", "--probes", "off"];

/// Rows of red, green, blue and alpha from the file of a page; reader and decoders are none of the tool's encoders.
fn decoded(baked: &Baked, page: usize) -> Vec<[f32; 4]> {
    let m = &baked.manifest.pages[page];
    let name = m.texture.as_ref().expect("a texture in the manifest");
    let file = &baked.files[name];
    let figures = m.texture_figures.as_ref().expect("figures of the texture");
    assert_eq!(figures.bytes, file.len() as u64);
    let reader = ktx2::Reader::new(&file[..]).expect("a KTX2 file");
    let h = reader.header();
    assert_eq!([h.pixel_width, h.pixel_height, h.pixel_depth], [m.width, m.height, 0]);
    assert_eq!([h.layer_count, h.face_count, h.level_count], [0, 1, 1]);
    assert_eq!(h.supercompression_scheme, Some(SupercompressionScheme::Zstandard));
    let texts: Vec<_> = reader.key_value_data().collect();
    let writer = texts.iter().find(|(key, _)| *key == "KTXwriter").expect("a writer").1;
    assert!(texts.contains(&("KTXorientation", &b"rd\0"[..])) && writer.starts_with(b"bake "));
    let level = reader.levels().next().expect("a level");
    let mut data = Vec::new();
    let mut frame = ruzstd::decoding::StreamingDecoder::new(level.data).expect("a frame");
    frame.read_to_end(&mut data).expect("blocks");
    assert_eq!(data.len() as u64, level.uncompressed_byte_length);
    let (width, height) = (m.width as usize, m.height as usize);
    let half = |b: &[u8]| f16::from_le_bytes([b[0], b[1]]).to_f32();
    match h.format {
        Some(ktx2::Format::R16G16B16A16_SFLOAT) => {
            assert_eq!(figures.format, "rgba16f");
            data.chunks_exact(8).map(|t| std::array::from_fn(|c| half(&t[2 * c..]))).collect()
        }
        Some(ktx2::Format::BC6H_UFLOAT_BLOCK) => {
            assert_eq!(figures.format, "bc6h_ufloat");
            let columns = width.div_ceil(4);
            assert_eq!(data.len(), columns * height.div_ceil(4) * 16);
            let blocks: Vec<[u16; 48]> = data
                .chunks_exact(16)
                .map(|b| {
                    let mut out = [0; 48];
                    bcdec_rs::bc6h_half(b, &mut out, 12, false);
                    out
                })
                .collect();
            let texel = |x: usize, y: usize| {
                let at = (y % 4 * 4 + x % 4) * 3;
                let block = &blocks[y / 4 * columns + x / 4][at..at + 3];
                [block[0], block[1], block[2], 0x3c00].map(|v| f16::from_bits(v).to_f32())
            };
            (0..width * height).map(|i| texel(i % width, i / width)).collect()
        }
        other => panic!("{other:?}"),
    }
}

fn texels(page: &Page) -> impl Iterator<Item = [f32; 4]> {
    let channel = |name: &str| page.channels[name].clone();
    let all = ["R", "G", "B", "A"].map(channel);
    (0..page.width * page.height).map(move |i| all.each_ref().map(|c| c[i]))
}

/// Root mean squared difference over covered texels and channels, over the mean luminance, and the mean itself.
fn difference(page: &Page, texture: &[[f32; 4]]) -> (f64, f64) {
    let (mut squares, mut light, mut n) = (0.0, 0.0, 0.0);
    for (a, b) in texels(page).zip(texture).filter(|(a, _)| 0.0 < a[3]) {
        squares += a.iter().zip(b).take(3).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>() / 3.0;
        light += [0.2126, 0.7152, 0.0722].iter().zip(a).map(|(w, c)| w * f64::from(c)).sum::<f64>();
        n += 1.0;
    }
    ((squares / n).sqrt() / (light / n), light / n)
}

/// What the manifest says of the textures of a bake is what other decoders find; gives the relative differences.
fn checked(baked: &Baked) -> Vec<f64> {
    let page = |(i, page): (usize, &Page)| {
        let m = &baked.manifest.pages[i];
        let (relative, mean) = difference(page, &decoded(baked, i));
        let said = m.texture_figures.as_ref().expect("figures of the texture");
        assert!((said.relative_rmse.expect("light") / relative - 1.0).abs() < 1e-3, "{said:?} {relative}");
        assert!((said.rmse / (relative * mean) - 1.0).abs() < 1e-3, "{said:?}");
        assert!((m.mean_luminance / mean - 1.0).abs() < 1e-4);
        println!("page {i}, {} x {}: {said:?}", page.width, page.height);
        relative
    };
    baked.pages.iter().enumerate().map(page).collect()
}

#[test]
fn textures_hold_the_light_of_the_exr() {
    let scene = room(Room::default());
    let blocks = tool::baked(&scene, &COARSE);
    assert_eq!(blocks.manifest.settings["texture"], "bc6h");
    // Eight paths a texel: there is noise of a third that blocks keep in part only.
    assert!(checked(&blocks).iter().all(|r| *r < 0.1));
    assert_eq!(blocks.manifest.counts.half_overflows, 0);
    let halves = tool::baked(&scene, &[&COARSE[..], &["--texture", "rgba16f"]].concat());
    assert_eq!(halves.manifest.settings["texture"], "rgba16f");
    // Half a unit in the last of 11 digits, in bright texels a few times the mean.
    assert!(checked(&halves).iter().all(|r| *r < 1e-3));
    for (i, page) in halves.pages.iter().enumerate() {
        let texture = decoded(&halves, i);
        assert!(texels(page).map(|t| t.map(|v| f16::from_f32(v).to_f32())).eq(texture), "page {i}");
    }
    assert!(blocks.files["lightmap-0.exr"] == halves.files["lightmap-0.exr"]);
}

#[test]
fn pages_are_multiples_of_four() {
    // A square of 26 texels and its gutter would just fit; cards want whole blocks.
    for texels in [["--texels-per-metre", "6.5"], ["--quality", "draft"]] {
        let args = [&["--samples", "8", "--max-size", "31"][..], &texels].concat();
        let baked = tool::baked(&open::under_point(1.0, [100.0, 80.0, 30.0]), &args);
        let page = &baked.manifest.pages[0];
        assert_eq!((page.width, page.height), (28, 28), "{page:?}");
        assert!(checked(&baked).iter().all(|r| *r < 0.1));
    }
}

#[test]
fn light_beyond_half_floats_is_clamped_and_said() {
    // E / pi is 3e5 nits below the lamp, and falls below 65504 further away.
    let dir = tool::folder_with(&open::under_point(1.0, [1e6, 5e5, 1e5]));
    for texture in ["bc6h", "rgba16f"] {
        let args = ["run", "scene.glb", "-o", texture, "--texture", texture, "--progress", "none"];
        let done = tool::bake(&[&args[..], &COARSE].concat(), dir.path()).expect(0);
        let baked = Baked::read(&dir.path().join(texture)).unwrap_or_else(|e| panic!("{e}\n{done}"));
        let page = &baked.pages[0];
        let values = || texels(page).flat_map(|t| [t[0], t[1], t[2]]);
        let beyond = values().filter(|v| 65504.0 < *v).count() as u64;
        assert!(0 < beyond && values().any(|v| 0.0 < v && v < 65504.0), "{beyond}");
        assert_eq!(baked.manifest.counts.half_overflows, beyond);
        assert_eq!(baked.manifest.pages[0].texture_figures.as_ref().map(|t| t.clamped), Some(beyond));
        let said = format!("lightmap-0.ktx2: {beyond} values exceed 65504 nits");
        assert!(done.stderr.contains(&said), "{done}");
        let got = decoded(&baked, 0);
        let greatest = got.iter().flat_map(|t| &t[..3]).fold(0.0f32, |a, v| a.max(*v));
        assert!(got.iter().flatten().all(|v| v.is_finite()) && 65000.0 < greatest && greatest <= 65504.0);
        // The difference that clamping makes is in the figures.
        assert!(0.1 < checked(&baked)[0]);
    }
}

#[test]
fn bytes_do_not_depend_on_threads_and_none_means_none() {
    let dir = tool::folder_with(&room(Room::default()));
    let config = |text: &str| {
        std::fs::write(dir.path().join("bake.toml"), format!("[run]\ntexture = \"{text}\"\n"))
            .expect("a file");
    };
    let bake = |threads: &str, more: &[&str]| {
        let first = ["run", "scene.glb", "-o", "out", "--progress", "none", "--threads", threads];
        let second =
            ["--samples", "2", "--texels-per-metre", "8", "--config", "bake.toml", "--probes", "off"];
        let done = tool::bake(&[&first[..], &second, more].concat(), dir.path()).expect(0);
        Baked::read(&dir.path().join("out")).unwrap_or_else(|e| panic!("{e}\n{done}"))
    };
    for format in ["bc6h", "rgba16f"] {
        config(format);
        let (one, two) = (bake("1", &[]), bake("2", &[]));
        assert!(one.files.contains_key("lightmap-0.ktx2") && one.files == two.files, "{format}");
        assert_eq!(one.manifest.settings["texture"], format);
    }
    config("none");
    let none = bake("2", &[]);
    assert!(!none.files.keys().any(|name| name.ends_with(".ktx2")), "{:?}", none.files.keys());
    assert!(none.manifest.pages.iter().all(|p| p.texture.is_none() && p.texture_figures.is_none()));
    assert_eq!(none.manifest.settings["texture"], "none");
    let glb = &none.files["scene.glb"];
    let named = |word: &[u8]| glb.windows(word.len()).any(|w| w == word);
    assert!(!named(b".ktx2") && !named(b"MOZ_lightmap") && named(b"lightmap-0.exr"));
    // The command line stands above the configuration.
    assert!(bake("2", &["--texture", "bc6h"]).files.contains_key("lightmap-0.ktx2"));
    config("bc7");
    let args = ["check", "scene.glb", "--config", "bake.toml"];
    let done = tool::bake(&args, dir.path()).expect(2);
    assert!(format!("{}{}", done.stdout, done.stderr).contains("run.texture"), "{done}");
}
