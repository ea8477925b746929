//! How much is gathered: a number of paths, an error, or a time.

use std::fs;

use serde_json::Value;
use suite::{
    scenes::closed::{Room, room},
    tool,
};

const DENSITY: [&str; 2] = ["--texels-per-metre", "6"];

#[test]
fn samples_mean_exactly_that_many_everywhere() {
    let baked = tool::baked(&room(Room::default()), &[&["--samples", "12"], &DENSITY[..]].concat());
    let s = baked.manifest.samples;
    assert_eq!((s.min, s.max), (12, 12));
}

#[test]
fn a_preset_is_a_mean_and_goes_where_the_variance_is() {
    let baked = tool::baked(&room(Room::default()), &[&["--quality", "draft"], &DENSITY[..]].concat());
    // What shadow rays of the lamp save is spent on paths.
    let s = baked.manifest.samples;
    assert!(15.5 < s.mean && s.mean < 20.0 && s.min < 16 && 16 < s.max, "{s:?}");
}

#[test]
fn an_error_that_is_asked_for_is_reached_and_not_far_exceeded() {
    for wanted in [0.1, 0.03] {
        let text = wanted.to_string();
        let baked = tool::baked(&room(Room::default()), &[&["--target-error", &text], &DENSITY[..]].concat());
        let reached = baked.manifest.error.relative.unwrap_or(f64::NAN);
        assert!(0.5 * wanted <= reached && reached <= wanted, "{wanted}: {reached}");
    }
}

/// Several pages share one error, and no page is as good as all of them.
#[test]
fn an_error_is_reached_over_several_pages() {
    let args = ["--target-error", "0.08", "--texels-per-metre", "12", "--max-size", "96"];
    let baked = tool::baked(&room(Room::default()), &args);
    assert!(1 < baked.pages.len(), "{} pages", baked.pages.len());
    let reached = baked.manifest.error.relative.unwrap_or(f64::NAN);
    assert!((0.03..=0.08).contains(&reached), "{reached} on {} pages", baked.pages.len());
}

/// A bake by the clock says which rounds it did, and those give the same bytes.
#[test]
fn a_time_budget_can_be_replayed() {
    let dir = tool::folder_with(&room(Room::default()));
    let bake = |args: &[&str]| {
        let all =
            [&["run", "scene.glb", "--progress", "none", "--quality", "draft"], &DENSITY[..], args].concat();
        let _ = tool::bake(&all, dir.path()).expect(0);
    };
    bake(&["--time-budget", "4s", "-o", "timed"]);
    let read = |folder: &str, file: &str| {
        fs::read(dir.path().join(folder).join(file)).unwrap_or_else(|e| panic!("{folder}/{file}: {e}"))
    };
    let manifest: Value =
        serde_json::from_slice(&read("timed", "manifest.json")).unwrap_or_else(|e| panic!("{e}"));
    let pages = manifest["settings"]["rounds"].as_array().expect("the rounds of each page");
    let join = |list: &Value| {
        let list: Vec<String> = list.as_array().expect("numbers").iter().map(Value::to_string).collect();
        list.join(",")
    };
    let rounds = pages.iter().map(join).collect::<Vec<_>>().join("/");
    bake(&["--rounds", &rounds, "-o", "again"]);
    for file in ["lightmap-0.exr", "scene.glb", "manifest.json"] {
        assert!(read("timed", file) == read("again", file), "{file} differs for --rounds {rounds}");
    }
}

#[test]
fn contradictions_and_nonsense_are_refused() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    for args in [
        &["--samples", "4", "--target-error", "0.1"][..],
        &["--time-budget", "soon"],
        &["--time-budget", "0s"],
        &["--target-error", "0"],
        &["--target-error", "-0.5"],
        &["--rounds", "8,4"],
        &["--rounds", "8,x"],
        &["--rounds", ""],
    ] {
        let done = tool::bake(&[&["run"], args].concat(), dir.path()).expect(2);
        assert!(!done.stderr.is_empty(), "{args:?}");
    }
}
