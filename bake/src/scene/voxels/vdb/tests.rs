use super::*;
use flate2::read::GzDecoder;
use serde_json::Value;
use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

const ENOUGH: usize = 1 << 30;

macro_rules! sample {
    ($name:literal) => {
        ($name, include_bytes!(concat!("../samples/", $name, ".vdb.gz")).as_slice())
    };
}

/// Written by OpenVDB 10 with samples/make.cpp: the same grid in every way of packing it.
const PACKINGS: [(&str, &[u8]); 14] = [
    sample!("none"),
    sample!("none-half"),
    sample!("none-mask"),
    sample!("none-mask-half"),
    sample!("zip"),
    sample!("zip-half"),
    sample!("zip-mask"),
    sample!("zip-mask-half"),
    sample!("blosc"),
    sample!("blosc-half"),
    sample!("blosc-mask"),
    sample!("blosc-mask-half"),
    sample!("stream"),
    // Version 221, by samples/old.py.
    sample!("old"),
];
const MANY: (&str, &[u8]) = sample!("many");
const MAPS: (&str, &[u8]) = sample!("maps");

fn unzip(packed: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    GzDecoder::new(packed).read_to_end(&mut bytes).expect("gzip");
    bytes
}

fn message(file: &[u8], name: Option<&str>) -> String {
    read(file, name, ENOUGH).expect_err("refused").what
}

/// What samples/make.cpp puts at an index.
fn made(p: IVec3) -> f32 {
    let value = ((p.x * 7 + p.y * 13 + p.z * 29).rem_euclid(64) + 1) as f32 / 64.0;
    let within = |a: IVec3, b: IVec3| a.cmple(p).all() && p.cmplt(b).all();
    if within(ivec3(-5, 3, 0), ivec3(12, 10, 21)) && (p.x + p.y + p.z) % 3 != 0 {
        return value;
    }
    if within(ivec3(16, 0, 0), ivec3(24, 8, 32)) {
        return match (p.z / 8, p.y < 4) {
            _ if (p.x + p.y) % 2 == 0 => value,
            (0, _) | (1, true) => 0.25,
            (1, false) => 0.75,
            (2, true) => 0.0,
            (2, false) => 0.5,
            _ => value,
        };
    }
    if within(ivec3(-8, 16, 0), ivec3(0, 24, 8)) {
        return 0.5;
    }
    if within(ivec3(128, 0, 0), ivec3(256, 128, 128)) { 0.125 } else { 0.0 }
}

#[test]
fn every_packing_gives_the_same_grid() {
    let mut first: Option<Voxels> = None;
    for (name, packed) in PACKINGS {
        let grid = read(&unzip(packed), Some("density"), ENOUGH).unwrap_or_else(|e| panic!("{name}: {e}"));
        let least = ivec3(-8, 0, 0);
        assert_eq!(grid.size(), uvec3(264, 128, 128), "{name}");
        assert_eq!(grid.place(), Some(Affine3A::from_translation(least.as_vec3())), "{name}");
        assert_eq!(grid.most(), 1.0);
        let first = first.get_or_insert_with(|| {
            for z in -1..130 {
                for y in -1..130 {
                    for x in -10..258 {
                        let p = ivec3(x, y, z);
                        assert_eq!(grid.at((p - least).as_vec3a() + 0.5), made(p), "{name}: {p}");
                    }
                }
            }
            // The tiles take no room.
            assert!(grid.memory() < 100_000, "{}", grid.memory());
            grid.clone()
        });
        assert_eq!(*first, grid, "{name}");
    }
}

#[test]
fn grids_are_chosen_by_name() {
    let file = unzip(MANY.1);
    let density = read(&file, None, ENOUGH).expect("density");
    assert_eq!(density.size(), uvec3(264, 128, 128), "the first of that name");
    let again = read(&file, Some("again"), ENOUGH).expect("shares the voxels of another grid");
    assert_eq!(again.size(), density.size());
    let half = Affine3A::from_scale(glam::Vec3::splat(0.5));
    assert_eq!(again.place(), density.place().map(|p| half * p), "at a place of its own");
    assert_eq!(again.at(glam::Vec3A::splat(150.5)), density.at(glam::Vec3A::splat(150.5)));
    for (name, kind) in [("v", "vec3s"), ("d", "double"), ("b", "bool")] {
        let said = message(&file, Some(name));
        assert_eq!(said, format!("the grid `{name}` is one of {kind}"));
    }
    let said = message(&file, Some("smoke"));
    assert!(
        said.contains("no grid `smoke`")
            && said.contains("`density` (float), ")
            && said.contains("`v` (vec3s)"),
        "{said}"
    );
    let said = message(&unzip(MAPS.1), None);
    assert!(said.contains("none of the file's grids is called `density`"), "{said}");
    // The only one of floats needs no name.
    assert_eq!(
        read(&unzip(PACKINGS[0].1), None, ENOUGH),
        read(&unzip(PACKINGS[0].1), Some("density"), ENOUGH)
    );
}

#[test]
fn transforms_lead_where_the_file_says() {
    let file = unzip(MAPS.1);
    let p = DVec3::new(3.0, 4.0, 5.0);
    let (scale, move_by) = (DVec3::new(1.0, 2.0, 4.0), DVec3::new(10.0, 20.0, 30.0));
    let cases = [
        ("scale", p * scale),
        ("uniform", p * 0.5),
        ("translate", p + move_by),
        ("scale-translate", p * scale + move_by),
        ("uniform-translate", p * 0.5 + move_by),
        ("affine", DVec3::new(-4.0, 6.0, 20.0) + move_by),
    ];
    for (name, want) in cases {
        let grid = read(&file, Some(name), ENOUGH).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!((grid.size(), grid.at(glam::Vec3A::splat(0.5))), (uvec3(1, 1, 1), 1.0));
        let place = grid.place().expect("a place");
        assert_eq!(place.transform_point3(glam::Vec3::ZERO), want.as_vec3(), "{name}");
    }
    let turned = read(&file, Some("unitary"), ENOUGH).expect("a turn").place().expect("a place");
    let corner = turned.transform_point3(glam::Vec3::ZERO);
    assert!((corner.abs() - glam::vec3(4.0, 3.0, 5.0)).abs().max_element() < 1e-5, "{corner}");
}

#[test]
fn what_is_no_fog_is_refused() {
    let file = unzip(MAPS.1);
    let cases = [
        ("frustum", "transform of the kind NonlinearFrustumMap"),
        ("background", "background 0.25"),
        ("negative", "voxel [-3, 5, 7] has the density -2"),
        ("empty", "is empty"),
    ];
    for (name, part) in cases {
        let said = message(&file, Some(name));
        assert!(said.contains(part), "{name}: {said}");
    }
    let far = message(&file, Some("far"));
    assert!(far.contains("GiB of memory") && far.contains("may take 1.00 GiB"), "{far}");
    assert!(message(b"", None).contains("no OpenVDB file"));
    assert!(message(b" BDV\0\0\0\0\xdb\0\0\0", None).contains("version 219"));
    let error = read(&unzip(PACKINGS[0].1), None, 10_000).expect_err("too little").what;
    assert!(error.contains("needs about 0.00 GiB"), "{error}");
}

/// Cuts a file off at every so many bytes, and changes a few of them here and there: that is an error or another grid,
/// soon, and never a panic.
fn damage(name: &str, file: &[u8], grid: &str, step: usize, changes: u32) {
    let mut state = 7u64;
    let mut random = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % n
    };
    let most = 1 << 24;
    let (begin, mut readings) = (Instant::now(), changes);
    for end in (0..file.len()).step_by(step) {
        let cut = read(&file[..end], Some(grid), most);
        // What comes after the grid that is read may well be missing.
        assert!(cut.is_err() || name == "many" || name == "maps", "{name} cut at {end}");
        readings += 1;
    }
    for _ in 0..changes {
        let mut bad = file.to_vec();
        // Mostly in the beginning, where counts and sizes are.
        let reach = if random(2) == 0 { bad.len() } else { bad.len().min(2000) };
        for _ in 0..=random(4) {
            let at = random(reach);
            bad[at] = match random(4) {
                0 => 0xff,
                1 => 0,
                2 => bad[at] ^ 1 << random(8),
                _ => bad[at].wrapping_add(1),
            };
        }
        drop(read(&bad, Some(grid), most));
    }
    let each = begin.elapsed() / readings;
    assert!(each < Duration::from_millis(200), "{name}: {each:?}");
}

#[test]
fn damaged_files_are_refused() {
    for (name, packed) in PACKINGS.into_iter().chain([MANY]) {
        let file = unzip(packed);
        damage(name, &file, "density", 97 * (1 + file.len() / 100_000), 150);
    }
    for grid in ["affine", "frustum"] {
        damage("maps", &unzip(MAPS.1), grid, 97, 150);
    }
}

fn volumes() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let named = std::env::var_os("BAKE_SHARED").map(PathBuf::from);
    let dir = named.into_iter().chain([beside]).map(|d| d.join("scenes/volumes")).find(|d| d.is_dir());
    if dir.is_none() {
        say("skipped: the folder of shared scenes is not here");
    }
    dir
}

#[expect(clippy::print_stderr, reason = "a test that did not run must say so, and figures are shown")]
fn say(text: &str) {
    eprintln!("{text}");
}

/// Against what OpenVDB itself makes of the files.
#[test]
fn real_files_are_read_exactly() {
    let Some(dir) = volumes() else { return };
    for name in ["openvdb-smoke", "vpt-dragon"] {
        let file = fs::read(dir.join(name).with_extension("vdb")).expect("a file");
        let begin = Instant::now();
        let grid = read(&file, None, ENOUGH).unwrap_or_else(|e| panic!("{name}: {e}"));
        let took = begin.elapsed();
        let facts = fs::read(dir.join(name).with_extension("json")).expect("facts");
        let facts: Value = serde_json::from_slice(&facts).expect("JSON");
        let numbers = |key: &str| [0, 1, 2].map(|i| facts[key][i].as_f64().expect("a number"));
        let size = DVec3::from(numbers("dims_xyz")).as_uvec3();
        assert_eq!(grid.size(), size);
        let values = unzip(&fs::read(dir.join(name).with_extension("f32.gz")).expect("values"));
        let values: Vec<f32> = values.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        let got: Vec<f32> = (0..size.element_product())
            .map(|i| grid.at(uvec3(i % size.x, i / size.x % size.y, i / size.x / size.y).as_vec3a() + 0.5))
            .collect();
        assert!(values == got, "{name}: densities differ");
        let place = grid.place().expect("a place");
        let corner = |v: glam::Vec3, key: &str| {
            let (got, want) = (place.transform_point3(v), DVec3::from(numbers(key)).as_vec3());
            assert!(
                (got - want).abs().max_element() < 1e-6 * want.abs().max_element(),
                "{name}: {got} {want}"
            );
        };
        corner(glam::Vec3::ZERO, "world_min");
        corner(size.as_vec3(), "world_max");
        say(&format!(
            "{name}: {} voxels, {} bytes of {} if dense, read in {took:?}",
            size.element_product(),
            grid.memory(),
            values.len() * 4
        ));
        assert_eq!(Voxels::dense(size, &values, ENOUGH).map(|v| v.most()), Ok(grid.most()));
    }
    let file = fs::read(dir.join("vpt-dragon_with_xform.vdb")).expect("a file");
    let grid = read(&file, None, ENOUGH).expect("a dragon that is turned");
    assert_eq!(grid.size(), uvec3(141, 99, 63), "from -70, 1, -31 to 70, 99, 31");
    let x = grid.place().expect("a place").matrix3.x_axis;
    assert!((x.length() - 0.125).abs() < 0.1 && x.min_element() != 0.0, "{x}");
    let sphere = fs::read(dir.join("openvdb-sphere.vdb")).expect("a file");
    let error = read(&sphere, None, ENOUGH).expect_err("a level set");
    assert!(
        error.what.contains("`ls_sphere` is a level set") && error.fix.contains("fog volume"),
        "{error:?}"
    );
    let dragon = fs::read(dir.join("vpt-dragon.vdb")).expect("a file");
    damage("vpt-dragon", &dragon, "density", 97, 300);
    let smoke = fs::read(dir.join("openvdb-smoke.vdb")).expect("a file");
    damage("openvdb-smoke", &smoke, "density", 97 * 501, 20);
}
