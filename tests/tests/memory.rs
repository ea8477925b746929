//! The memory that a plan states is what the bake then takes.

use std::{fs, path::Path};

use serde_json::Value;
use suite::{
    scenes::closed::{Room, room},
    tool,
};

/// Part by which stated and measured peak may differ.
const TOLERANCE: f64 = 0.2;

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|e| panic!("{e}\n{text}"))
}

/// Bakes with `args` in `dir` and compares; gives the measured peak in bytes.
#[track_caller]
fn stated_is_measured(args: &[&str], dir: &Path) -> u64 {
    // A preset would denoise, and the bake with one path that stands for it would not.
    let denoise: &[&str] = if args.contains(&"--denoise") { &[] } else { &["--denoise", "off"] };
    let all = |first: &[&'static str], last: &[&'static str]| -> Vec<String> {
        first.iter().chain(args).chain(denoise).chain(last).map(|a| (*a).to_owned()).collect()
    };
    let bake = |args: Vec<String>| {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        tool::bake(&args, dir).expect(0)
    };
    let plan = json(&bake(all(&["plan"], &["--json", "--threads", "2"])).stdout);
    let _ = bake(all(&["run"], &["-o", "out", "--samples", "1", "--progress", "none", "--threads", "2"]));
    let timings = fs::read_to_string(dir.join("out/timings.json")).expect("a bake writes its timings");
    let bytes = |v: &Value| v["peak_memory_bytes"].as_u64().expect("a number of bytes");
    let (stated, measured) = (bytes(&plan), bytes(&json(&timings)));
    let ratio = stated as f64 / measured as f64;
    assert!(
        (ratio - 1.0).abs() <= TOLERANCE,
        "stated {stated}, measured {measured}, ratio {ratio:.3}\n{:#}",
        plan["memory"]
    );
    measured
}

#[test]
fn of_the_hall() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    stated_is_measured(&[], dir.path());
}

#[test]
fn of_one_large_page_and_of_many() {
    let dir = tool::folder_with(&room(Room::default()));
    let coarse = stated_is_measured(&["scene.glb", "--texels-per-metre", "20"], dir.path());
    let fine = stated_is_measured(&["scene.glb", "--texels-per-metre", "120"], dir.path());
    // Texels outweigh the program, or this would test a constant.
    assert!(3 * coarse < fine, "{coarse} and {fine}");
    // A quarter of the texels, because denoising takes its time.
    let _ = stated_is_measured(&["scene.glb", "--texels-per-metre", "60", "--denoise", "final"], dir.path());
    let args = ["scene.glb", "--texels-per-metre", "120", "--max-size", "512"];
    let pages = stated_is_measured(&args, dir.path());
    assert!(pages < fine, "small pages need less at a time: {pages} and {fine}");
}
