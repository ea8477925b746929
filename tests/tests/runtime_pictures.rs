//! Pictures of the runtime sample against reference bakes, and what it says of folders and arguments that are wrong.
//!
//! `UPDATE_EXPECT=1 cargo test -p suite --test runtime_pictures` bakes the references anew. Without a graphics adapter tests are skipped;
//! `REQUIRE_GRAPHICS=1` makes that a failure.

#![expect(clippy::print_stdout, reason = "figures that are reported")]
#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::{
    collections::BTreeMap,
    env, fs,
    path::{Path, PathBuf},
};

use bake::sample::sequence::mix64;
use suite::{
    graphics::{self, show},
    pictures::{Picture, Reference},
    scenes::open,
    tool::{self, Finished},
};

/// Seeds of the bakes that references are made of.
const SEEDS: std::ops::RangeInclusive<u32> = 1..=8;

/// Seeds of bakes that are compared with them: any others.
const FRESH: [u32; 2] = [101, 102];

/// File names and what draws them: with fog, and without.
const VIEWS: [(&str, &[&str]); 2] = [("runtime-hall.exr", &[]), ("runtime-hall-no-fog.exr", &["--no-fog"])];

/// Bakes the hall that is part of the tool into `dir`.
fn bake_hall(dir: &Path, seed: u32) {
    let seed = seed.to_string();
    let args = ["run", "-o", "out", "--quality", "draft", "--texture", "none", "--progress", "none"];
    // Noise of a grid with few paths makes all of the fog brighter or darker, by up to 4 %, which would hide faults.
    let light = ["--samples", "8", "--grid-paths", "1024", "--seed", &seed];
    let _ = tool::bake(&[&args[..], &light].concat(), dir).expect(0);
}

/// Draws the hall in `dir`, with its spheres where they are after a second.
fn view_hall(dir: &Path, args: &[&str]) -> Picture {
    let fixed = ["out", "--screenshot", "view.exr", "--size", "320x180", "--antialias", "16", "--time", "1"];
    let _ = show(&[&fixed[..], args].concat(), dir).expect(0);
    Picture::read(&dir.join("view.exr")).unwrap()
}

fn update() -> bool {
    env::var_os("UPDATE_EXPECT").is_some_and(|v| v == "1")
}

fn write_references() {
    let mut pictures = [const { Vec::new() }; VIEWS.len()];
    for seed in SEEDS {
        let dir = tempfile::tempdir().unwrap();
        bake_hall(dir.path(), seed);
        for (list, (_, args)) in pictures.iter_mut().zip(VIEWS) {
            list.push(view_hall(dir.path(), args));
        }
    }
    for (list, (name, _)) in pictures.iter().zip(VIEWS) {
        // How bakes lie to the others says what is to be expected of one more.
        for (i, picture) in list.iter().enumerate() {
            let others = list.iter().enumerate().filter(|(k, _)| *k != i).map(|(_, p)| p.clone());
            let what = format!("{name}, seed {} among the others", SEEDS.clone().nth(i).unwrap());
            let _ = judged(&Reference::of(&others.collect::<Vec<_>>()), picture, &what);
        }
        Reference::of(list).write(&suite::root().join("data").join(name)).unwrap();
    }
}

/// Says how a picture lies to a reference, and whether it is accepted.
fn judged(reference: &Reference, picture: &Picture, what: &str) -> Result<(), String> {
    let v = reference.judge(picture).unwrap();
    println!(
        "{what}: mean of z {:+.3}, of its square {:.3}, {:.3} % beyond {:.2}, exposure {:+.3} %",
        v.mean,
        v.square,
        100.0 * v.beyond,
        reference.bound(),
        100.0 * v.exposure
    );
    v.accepted()
}

/// Leaves a picture, its reference and z where they can be looked at.
fn leave(reference: &Reference, picture: &Picture, what: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("runtime-pictures").join(what.replace(' ', "-"));
    fs::create_dir_all(&folder).unwrap();
    let z = reference.judge(picture).unwrap().z;
    for (name, image) in
        [("picture", picture.image()), ("reference", reference.mean.image()), ("z", z.signed_image())]
    {
        image.save(folder.join(name).with_extension("png")).unwrap();
    }
    folder
}

/// Bakes of other seeds look like the references, with fog and without. What is wrong with a picture is found: exposure, fog, place, spheres.
#[test]
fn hall_looks_like_its_references() {
    if !graphics::available("pictures of the hall") {
        return;
    }
    if update() {
        write_references();
    }
    let dirs = FRESH.map(|seed| {
        let dir = tempfile::tempdir().unwrap();
        bake_hall(dir.path(), seed);
        dir
    });
    let drawn = VIEWS.map(|(_, args)| dirs.each_ref().map(|d| view_hall(d.path(), args)));
    let bakes = u32::try_from(SEEDS.count()).unwrap();
    let mut faults = Vec::new();
    for (i, (name, args)) in VIEWS.into_iter().enumerate() {
        let path = suite::root().join("data").join(name);
        assert!(fs::metadata(&path).unwrap().len() < 1 << 20, "{name} is large");
        let reference = Reference::read(&path, bakes).unwrap();
        for (seed, picture) in FRESH.iter().zip(&drawn[i]) {
            let what = format!("{} seed {seed}", path.file_stem().unwrap().display());
            if let Err(e) = judged(&reference, picture, &what) {
                let folder = leave(&reference, picture, &what);
                faults.push(format!("{what}: {e}; see {}", folder.display()));
            }
        }
        let good = &drawn[i][0];
        let wrong = [
            ("3 % brighter", good.exposed(1.03)),
            ("3 % darker", good.exposed(0.97)),
            ("2 pixels to the left", good.moved(2)),
            ("fog left out, or put in", drawn[1 - i][0].clone()),
            ("spheres left out", view_hall(dirs[0].path(), &[args, &["--no-balls"]].concat())),
        ];
        for (what, picture) in wrong {
            if judged(&reference, &picture, &format!("{name}, {what}")).is_ok() {
                faults.push(format!("{name}: {what} is not noticed"));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// A plane, lamps and media of every kind under an image of the sky, baked into `out` with every file that a bake can have.
fn small() -> tempfile::TempDir {
    let dir = tool::folder_with(&open::all_media());
    let sky = |x: usize, y: usize| (1.0 + x as f32, 1.0, 4.0 - y as f32);
    exr::prelude::write_rgb_file(dir.path().join("sky.exr"), 8, 4, sky).unwrap();
    let args =
        ["run", "scene.glb", "-o", "out", "--sky", "sky.exr", "--samples", "16", "--texels-per-metre", "4"];
    let few = ["--directional", "--probe-count", "64", "--grid-nodes", "64", "--progress", "none"];
    let _ = tool::bake(&[&args[..], &few].concat(), dir.path()).expect(0);
    dir
}

/// Arguments of the smallest picture.
const TINY: [&str; 6] = ["--screenshot", "view.png", "--size", "16x16", "--antialias", "1"];

fn draw(args: &[&str], dir: &Path) -> Finished {
    show(&[args, &TINY].concat(), dir)
}

/// Exit code 2 and one line that has all words.
#[track_caller]
fn says(done: Finished, words: &[&str]) {
    let done = done.expect(2);
    // Mesa complains of its surroundings in the same manner.
    let said = |l: &&str| l.starts_with("error: ") && !l.contains("XDG_RUNTIME_DIR");
    let lines: Vec<&str> = done.stderr.lines().filter(said).collect();
    assert_eq!(lines.len(), 1, "one line says what is wrong\n{done}");
    for word in words {
        assert!(lines[0].contains(word), "`{word}` is not said\n{done}");
    }
}

#[test]
#[cfg(target_os = "linux")]
fn without_an_adapter_it_says_what_to_install() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("manifest.json"), "{}").unwrap();
    let none = [("VK_DRIVER_FILES", "/absent.json"), ("VK_ICD_FILENAMES", "/absent.json")];
    let args = [&["."], &TINY[..]].concat();
    says(graphics::show_with(&args, dir.path(), &none), &[graphics::NO_ADAPTER, "mesa-vulkan-drivers"]);
}

#[test]
fn what_is_wrong_with_a_folder_is_one_line() {
    if !graphics::available("folders that are wrong") {
        return;
    }
    let dir = small();
    let (dir, out) = (dir.path(), dir.path().join("out"));
    let _ = draw(&["out"], dir).expect(0);
    says(draw(&["absent"], dir), &["absent: ", "bake run"]);
    says(draw(&["scene.glb"], dir), &["scene.glb: ", "bake run"]);
    fs::create_dir(dir.join("empty")).unwrap();
    says(draw(&["empty"], dir), &["empty: ", "manifest.json", "bake run"]);

    let manifest = out.join("manifest.json");
    let text = fs::read_to_string(&manifest).unwrap();
    let with = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        fs::write(&manifest, text.replacen(from, to, 1)).unwrap();
        draw(&["out"], dir)
    };
    says(with("\"version\": 1", "\"version\": 99"), &["manifest.json: ", "version 99", "update the tool"]);
    says(with("\"color_space\":", "\"colours\":"), &["manifest.json: ", "color_space", "bake again"]);
    says(with("radiance_white_lambert_nits", "lumens"), &["manifest.json: ", "lumens"]);
    says(with("bake-lightmaps", "else"), &["manifest.json: ", "bake-lightmaps"]);
    says(with("{", "what? {"), &["manifest.json: ", "bake again", "line 1"]);
    fs::write(&manifest, [0xff; 9]).unwrap();
    says(draw(&["out"], dir), &["manifest.json: "]);
    fs::write(&manifest, &text).unwrap();

    for name in needed(&out) {
        let path = out.join(&name);
        let bytes = fs::read(&path).unwrap();
        let again = [&format!("{name}: "), "bake again"];
        fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        says(draw(&["out"], dir), &again);
        fs::write(&path, vec![0; bytes.len()]).unwrap();
        // The light of lamps is not in `light-grid.indirect.ktx2`, which is read in place of this one.
        if name != "light-grid.ktx2" {
            says(draw(&["out"], dir), &again);
        }
        fs::remove_file(&path).unwrap();
        says(draw(&["out"], dir), &again);
        fs::write(&path, bytes).unwrap();
    }
    let _ = draw(&["out"], dir).expect(0);
}

/// Files of a bake that the sample reads beside the manifest.
fn needed(out: &Path) -> Vec<String> {
    let names = fs::read_dir(out).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
    let unread = |n: &String| {
        n.ends_with(".png") || n.ends_with(".json") || n.starts_with("probes.") && n != "probes.bin"
    };
    let mut names: Vec<String> = names.filter(|n| !unread(n)).collect();
    names.sort();
    println!("{names:?}");
    for start in [
        "lightmap-0.exr",
        "lightmap-0.ktx2",
        "lightmap-0.sh1.ktx2",
        "light-grid.ktx2",
        "probes.bin",
        "scene.glb",
    ] {
        assert!(names.iter().any(|n| n == start), "there is no {start}");
    }
    names
}

/// Bits that are flipped end in a picture or in a line, whatever they were part of.
#[test]
fn flipped_bits_end_in_a_picture_or_a_line() {
    if !graphics::available("flipped bits") {
        return;
    }
    let dir = small();
    let out = dir.path().join("out");
    let mut names = needed(&out);
    names.push("manifest.json".to_owned());
    let mut state = 0u64;
    let mut below = |n: usize| {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        usize::try_from(mix64(state) % n as u64).unwrap()
    };
    let mut ended = BTreeMap::<(&str, i32), u32>::new();
    for i in 0..64 {
        let name = &names[i % names.len()];
        let path = out.join(name);
        let good = fs::read(&path).unwrap();
        let mut bad = good.clone();
        // Headers are short and matter most: every second flip is near the start.
        let reach = if (i / names.len()).is_multiple_of(2) { good.len() } else { good.len().min(400) };
        let at: Vec<usize> = (0..1 + below(4)).map(|_| below(reach)).collect();
        at.iter().for_each(|at| bad[*at] ^= 1 << below(8));
        fs::write(&path, bad).unwrap();
        let done = draw(&["out"], dir.path());
        fs::write(&path, good).unwrap();
        let code = done.code.unwrap_or(-1);
        *ended.entry((name, code)).or_default() += 1;
        assert!(code == 0 || code == 2, "{name}, flips at {at:?}\n{done}");
        if code == 2 {
            // A flip in the manifest may lead to any file.
            says(done, &[if name == "manifest.json" { "out" } else { name }]);
        }
    }
    println!("{ended:?}");
}

#[test]
fn what_is_wrong_with_arguments_is_one_line() {
    if !graphics::available("arguments that are wrong") {
        return;
    }
    let dir = small();
    let dir = dir.path();
    says(draw(&["out", "--camera", "nave"], dir), &["no camera `nave`"]);
    says(draw(&["out", "--camera", "7"], dir), &["camera 7 of 0"]);
    says(draw(&["out", "--bake", "night"], dir), &["no bake `night` in out, only out"]);
    says(draw(&["out", "--against", "night"], dir), &["no bake `night` in out, only out", "side by side"]);
    says(draw(&["out", "--against", "out"], dir), &["`out` is on both sides", "two bakes"]);
    says(draw(&["out", "--ball", "1,2,3"], dir), &["1,2,3", "X,Y,Z,RADIUS"]);
    says(draw(&["out", "--ball", "1,2,3,-1"], dir), &["X,Y,Z,RADIUS"]);
    says(draw(&["out", "--exposure", "0"], dir), &["above 0"]);
    says(draw(&["out", "--show", "beauty"], dir), &["beauty", "--show"]);
    for size in ["8x8", "100", "9000x20", "axb"] {
        says(
            show(&["out", "--screenshot", "view.png", "--size", size], dir),
            &[size, "from 16x16 to 8192x8192"],
        );
    }
    let file = |name: &str| show(&["out", "--screenshot", name, "--size", "16x16", "--antialias", "1"], dir);
    for name in ["view.jpg", "view"] {
        says(file(name), &[name, ".png", ".exr"]);
    }
    fs::create_dir(dir.join("taken.png")).unwrap();
    for name in ["absent/view.png", "absent/view.exr", "taken.png"] {
        says(file(name), &[name, "cannot write"]);
    }
    let folder = |name: &str| show(&["out", "--turntable", name, "--frames", "1", "--size", "16x16"], dir);
    says(folder("scene.glb"), &["scene.glb", "cannot make this folder"]);
}

/// A turntable goes once around, what is drawn twice is the same, and timings have a line for each stage.
#[test]
fn pictures_are_the_same_again() {
    if !graphics::available("turntables") {
        return;
    }
    let dir = small();
    let dir = dir.path();
    let size = ["--size", "64x36", "--antialias", "2", "--time", "0.5"];
    let turn = |folder: &str| {
        let _ = show(&[&["out", "--turntable", folder, "--frames", "4"], &size[..]].concat(), dir).expect(0);
        let mut names: Vec<_> = fs::read_dir(dir.join(folder)).unwrap().map(|e| e.unwrap().path()).collect();
        names.sort();
        let ends = names.iter().map(|n| n.file_name().unwrap().to_str().unwrap()).collect::<Vec<_>>();
        assert_eq!(ends, ["000.png", "001.png", "002.png", "003.png"]);
        names.iter().map(|n| fs::read(n).unwrap()).collect::<Vec<_>>()
    };
    let frames = turn("first");
    for (i, a) in frames.iter().enumerate() {
        assert!(frames[..i].iter().all(|b| a != b), "picture {i} is like one before");
    }
    assert!(frames == turn("second"), "another run draws the same");
    for name in ["a.png", "b.png", "a.exr", "b.exr"] {
        let _ = show(&[&["out", "--screenshot", name], &size[..]].concat(), dir).expect(0);
    }
    let bytes = |name: &str| fs::read(dir.join(name)).unwrap();
    assert!(bytes("a.png") == bytes("b.png") && bytes("a.exr") == bytes("b.exr"));
    assert!(bytes("a.png") == frames[0], "a turntable starts where a screenshot is taken");

    let done = show(&["out", "--timings", "3", "--size", "64x36"], dir).expect(0);
    assert!(done.stdout.contains("64 x 36 pixels") && done.stdout.contains("median of 3 frames"), "{done}");
    let table: Vec<&str> = done.stdout.lines().filter(|l| l.contains(" ms")).collect();
    assert!(4 < table.len(), "{done}");
    assert!(table.last().unwrap().trim_start().starts_with("frame "), "{done}");
    assert!(table.iter().all(|l| l.split_whitespace().any(|w| w.parse::<f64>().is_ok_and(|v| 0.0 <= v))));
}
