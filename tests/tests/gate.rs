//! Samples that are not finite: counted, named, and shown again by the command that the message prints.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use glam::Vec3;
use std::path::Path;
use suite::baked::Baked;
use suite::scenes::{closed, open};
use suite::tool::{self, Finished};

/// A lamp so bright and so near that light on the floor below it is beyond any number.
fn hot() -> Vec<u8> {
    open::under_point(1e-3, [1e38; 3])
}

const ARGS: [&str; 12] = [
    "run",
    "hot scene.glb",
    "-o",
    "out it goes",
    "--samples",
    "4",
    "--texels-per-metre",
    "8",
    "--texture",
    "none",
    "--progress",
    "none",
];

fn folder() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("hot scene.glb"), hot()).unwrap();
    dir
}

/// The words of the command that a message prints for a sample of some kind.
fn printed(done: &Finished, kind: &str) -> Vec<String> {
    let mut lines = done.stderr.lines().filter(|l| l.contains("--replay"));
    let line = lines.find(|l| l.contains(&format!(":{kind}:"))).unwrap_or_else(|| panic!("{kind}: {done}"));
    shlex::split(line).unwrap_or_else(|| panic!("cannot be read by a shell: {line}"))
}

/// Runs such a command.
fn again(words: &[String], dir: &Path) -> Finished {
    assert_eq!(Path::new(&words[0]), tool::bake_path());
    let args: Vec<&str> = words[1..].iter().map(String::as_str).collect();
    tool::bake(&args, dir)
}

/// Three numbers behind a word of a replay.
fn numbers(done: &Finished, word: &str) -> Vec3 {
    let line = done.stdout.lines().find(|l| l.starts_with(word)).unwrap_or_else(|| panic!("{word}: {done}"));
    let inside = line.split(['[', ']']).nth(1).unwrap();
    let values: Vec<f32> = inside.split(", ").map(|v| v.parse().unwrap()).collect();
    Vec3::from_slice(&values)
}

#[test]
fn rejected_samples_are_named_and_seen_again() {
    let dir = folder();
    let done = tool::bake(&ARGS, dir.path()).expect(0);
    let baked = Baked::read(&dir.path().join("out it goes")).unwrap();
    let rejected = baked.manifest.counts.rejected_samples;
    assert!(0 < rejected && done.stderr.contains("was not finite"), "{done}");
    assert!(baked.pages[0].channels.values().flatten().all(|v| v.is_finite()));
    // All arguments as they were given, and the name of the sample.
    let words = printed(&done, "small");
    assert_eq!(words[1..=ARGS.len()], ARGS.map(str::to_owned));
    let name = words.last().unwrap().clone();
    std::fs::remove_dir_all(dir.path().join("out it goes")).unwrap();
    let shown = again(&words, dir.path()).expect(2);
    assert!(shown.stdout.contains(&format!("sample: {name}")), "{shown}");
    for word in ["node: floor", "rays: ", "finite: no"] {
        assert!(shown.stdout.contains(word), "{shown}");
    }
    assert!(!numbers(&shown, "direct: ").is_finite() || 1e35 < numbers(&shown, "direct: ").max_element());
    assert!(numbers(&shown, "position: ").length() < 1.0, "below the lamp: {shown}");
    assert_eq!(shown.stderr.lines().filter(|l| l.starts_with("error: ")).count(), 1, "{shown}");
    // Probes see the lamp as well.
    let probe = again(&printed(&done, "probe"), dir.path()).expect(2);
    assert!(probe.stdout.contains("finite: no"), "{probe}");
    assert!(!dir.path().join("out it goes").exists(), "a replay writes nothing");
}

#[test]
fn strict_stops_at_the_first_and_leaves_nothing() {
    let dir = folder();
    let done = tool::bake(&[&ARGS[..], &["--strict"]].concat(), dir.path()).expect(2);
    assert!(done.stderr.contains("--strict was asked for"), "{done}");
    assert!(!dir.path().join("out it goes").exists());
    let shown = again(&printed(&done, "probe"), dir.path()).expect(2);
    assert!(shown.stdout.contains("finite: no"), "{shown}");
    let done = tool::bake(&[&ARGS[..], &["--strict", "--probes", "off"]].concat(), dir.path()).expect(2);
    let shown = again(&printed(&done, "small"), dir.path()).expect(2);
    assert!(shown.stdout.contains("finite: no"), "{shown}");
}

/// A page of many samples is given up at the first: sampling all of it would take hours.
#[test]
fn strict_does_not_finish_the_page() {
    let dir = folder();
    std::fs::write(dir.path().join("all hot.glb"), open::under_point(1.0, [1e38; 3])).unwrap();
    let args = ["run", "all hot.glb", "--samples", "65536", "--texels-per-metre", "64", "--probes", "off"];
    let child = tool::start(tool::bake_path(), &[&args[..], &["--strict"]].concat(), dir.path());
    let done = child.wait(std::time::Duration::from_secs(120)).expect(2);
    assert!(done.stderr.contains("was not finite"), "{done}");
}

/// What the light grid of media and the irradiance cache leave out is counted and shown again too.
#[test]
fn nodes_and_cells_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let hot = closed::Room { candela: 1e38, ..closed::Room::default() };
    std::fs::write(dir.path().join("scene.glb"), closed::room(hot)).unwrap();
    std::fs::write(dir.path().join("bake.toml"), "media = [{ sigma_s = 0.2 }]\n").unwrap();
    let args = ["run", "scene.glb", "-o", "out", "--config", "bake.toml", "--samples", "8"];
    let args = [&args[..], &["--texels-per-metre", "4", "--probes", "off", "--texture", "none"]].concat();
    let done = tool::bake(&args, dir.path()).expect(0);
    for kind in ["node", "cell"] {
        let shown = again(&printed(&done, kind), dir.path()).expect(2);
        assert!(
            shown.stdout.contains(&format!(":{kind}:")) && shown.stdout.contains("finite: no"),
            "{shown}"
        );
    }
    // The first of the light grid ends it.
    let done = tool::bake(&[&args[..], &["--strict"]].concat(), dir.path()).expect(2);
    assert!(
        done.stderr.contains("light grid node") && done.stderr.contains("--strict was asked for"),
        "{done}"
    );
    for (name, what) in [("0:4000000000:node:0", "light grid"), ("3:0:cell:0", "irradiance cache")] {
        let none = tool::bake(&[&args[..], &["--replay", name]].concat(), dir.path()).expect(2);
        assert!(none.stderr.contains(&format!("the {what} has no such path")), "{none}");
    }
    std::fs::write(dir.path().join("points.json"), r#"{"points": []}"#).unwrap();
    let args = ["points", "scene.glb", "points.json", "--config", "bake.toml", "--samples", "16"];
    let done = tool::bake(&args, dir.path()).expect(0);
    let shown = again(&printed(&done, "node"), dir.path()).expect(2);
    assert!(shown.stdout.contains("finite: no"), "{shown}");
}

/// Probes are replayed as texels are.
#[test]
fn probes_are_replayed() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("scene.glb"), closed::room(closed::Room::default())).unwrap();
    let args =
        ["run", "scene.glb", "-o", "out", "--samples", "1", "--texels-per-metre", "1", "--probe-count", "64"];
    let shown = tool::bake(&[&args[..], &["--replay", "0:3:probe:5"]].concat(), dir.path()).expect(0);
    assert!(shown.stdout.contains("from [") && shown.stdout.contains("finite: yes"), "{shown}");
    let none = tool::bake(&[&args[..], &["--replay", "1:3:probe:5"]].concat(), dir.path()).expect(2);
    assert!(none.stderr.contains("there is no volume 1"), "{none}");
    assert!(!dir.path().join("out").exists());
}

#[test]
fn points_name_their_samples_too() {
    let dir = folder();
    let points = r#"{"points": [{"position": [0, 0, 0], "normal": [0, 1, 0]}]}"#;
    std::fs::write(dir.path().join("points.json"), points).unwrap();
    let args = ["points", "hot scene.glb", "points.json", "--samples", "16"];
    let done = tool::bake(&args, dir.path()).expect(0);
    assert!(done.stderr.contains("points[0]: sample 0 of paths was not finite"), "{done}");
    let shown = again(&printed(&done, "point"), dir.path()).expect(2);
    assert!(shown.stdout.contains("sample: 0:0:point:0") && shown.stdout.contains("finite: no"), "{shown}");
    let bad = tool::bake(&[&args[..], &["--replay", "0:1:point:0"]].concat(), dir.path()).expect(2);
    assert!(bad.stderr.contains("there is no such sample"), "{bad}");
}

/// A bake with one sample a texel holds what both replayed samples bring, to the bit: with pilot, cache, haze and its light grid.
#[test]
fn replays_are_what_the_bake_saw() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("scene.glb"), closed::room(closed::Room::default())).unwrap();
    for (media, config) in [("off", ""), ("bounded", "media = [{ sigma_s = 0.2, g = 0.3 }]\n")] {
        std::fs::write(dir.path().join("bake.toml"), config).unwrap();
        let args = [
            "run",
            "scene.glb",
            "-o",
            media,
            "--config",
            "bake.toml",
            "--media",
            media,
            "--samples",
            "1",
            "--texels-per-metre",
            "2",
            "--seed",
            "5",
            "--seams",
            "off",
            "--probes",
            "off",
            "--grid-nodes",
            "64",
        ];
        let _ = tool::bake(&args, dir.path()).expect(0);
        let baked = Baked::read(&dir.path().join(media)).unwrap();
        let page = &baked.pages[0];
        let covered: Vec<usize> = (0..page.channels["A"].len())
            .filter(|&i| 0.0 < page.channels["A"][i] && 0.0 < page.channels["R"][i])
            .collect();
        for &texel in covered.iter().step_by(covered.len() / 6) {
            let replay = |kind: &str| {
                let at = format!("0:{texel}:{kind}:0");
                let shown = tool::bake(&[&args[..], &["--replay", &at]].concat(), dir.path()).expect(0);
                if shown.stdout.contains("hidden") {
                    return None;
                }
                Some([numbers(&shown, "direct: "), numbers(&shown, "indirect: ")])
            };
            let (Some(small), Some(path)) = (replay("small"), replay("path")) else { continue };
            // As a texel adds them up from the sums that it keeps.
            let (all, through_air) = (small[0] + small[1], small[1]);
            let (paths, straight) = (path[0] + path[1], path[0]);
            let direct = (all - through_air).max(Vec3::ZERO) + straight;
            let indirect = (paths - straight).max(Vec3::ZERO) + through_air;
            let got = page.rgb("", texel % page.width, texel / page.width);
            assert_eq!((direct + indirect).to_array(), got.to_array(), "{media}: texel {texel}");
        }
    }
}

#[test]
fn what_cannot_be_replayed_says_so() {
    let dir = folder();
    for (name, what) in [
        ("0:1:walk:2", "KIND is one of small, path, direction, node, cell, probe, point"),
        ("7:1:path:2", "there are 1 pages"),
        ("0:4000000:path:2", "has no chart on texel"),
        ("0:1:direction:2", "--directional is not asked for"),
        ("0:1:point:2", "belong to `bake points`"),
    ] {
        let done = tool::bake(&[&ARGS[..], &["--replay", name]].concat(), dir.path()).expect(2);
        assert!(done.stderr.contains(what), "{done}");
    }
}
