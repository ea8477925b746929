//! What accuracy costs in time: studies, audits, and what a bake says at its end.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::BTreeMap;
use std::fs;
use suite::scenes::closed::{Room, furnace, room};
use suite::tool;

/// Rows of a study by knob, base and setting; fields by the names of their columns.
fn rows(text: &str) -> Vec<BTreeMap<String, String>> {
    let fields = |line: &str| {
        let (mut out, mut quoted) = (vec![String::new()], false);
        for c in line.chars() {
            match c {
                '"' => quoted = !quoted,
                ',' if !quoted => out.push(String::new()),
                c => out.last_mut().unwrap().push(c),
            }
        }
        out
    };
    let mut lines = text.lines();
    let header = fields(lines.next().unwrap());
    lines.map(|l| header.iter().cloned().zip(fields(l)).collect()).collect()
}

fn number(row: &BTreeMap<String, String>, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|e| panic!("{column}: {e} in {row:?}"))
}

#[test]
fn a_study_measures_what_knobs_do() {
    let dir = tool::folder_with(&room(Room::default()));
    // At points everything takes paths of its own.
    let slow = if suite::slow() { ",texel density,probe order" } else { "" };
    let args = ["study", "scene.glb", "--texels", "400", "--reference-samples", "256", "--progress", "none"];
    let knobs = ["--knobs", &format!("adaptive sampling,bounces,media rung,grid hierarchy alpha{slow}")];
    let done = tool::bake(&[&args[..], &knobs].concat(), dir.path());
    // 1 says that a preset is off the front, which so small a study may find.
    assert!(done.code == Some(0) || done.code == Some(1), "{done}");
    let folder = dir.path().join("scene.study");
    let html = fs::read_to_string(folder.join("study.html")).unwrap();
    for part in [
        "Presets and the front",
        "Nothing to turn here: no medium of the scene scatters.",
        "processor seconds",
        "<svg",
    ] {
        assert!(html.contains(part), "{part}");
    }
    for file in ["pareto.svg", "bounces.svg", "adaptive-sampling.svg"] {
        assert!(fs::read_to_string(folder.join(file)).unwrap().starts_with("<svg"), "{file}");
    }
    let all = rows(&fs::read_to_string(folder.join("study.csv")).unwrap());
    let of = |knob: &str| all.iter().filter(|r| r["knob"] == knob).cloned().collect::<Vec<_>>();
    assert_eq!(of("preset").len(), 3);
    assert_eq!(of("media rung").len(), 0);
    // Thirty-two times the paths have at most half of the error, and take longer.
    let presets = of("preset");
    let at = |n: &str| presets.iter().find(|r| r["setting"] == n).unwrap();
    assert!(number(at("high"), "noise") < 0.5 * number(at("draft"), "noise"), "{presets:?}");
    assert!(number(at("draft"), "sampling_seconds") < number(at("high"), "sampling_seconds"));
    // Without reflections light is missing, and no number of paths brings it back.
    let bounces = of("bounces");
    let biased: Vec<f64> = bounces.iter().take(4).map(|r| number(r, "bias")).collect();
    assert!(0.2 < biased[0] && biased[1] < biased[0] && biased[2] < biased[1], "{biased:?}");
    let front = all.iter().filter(|r| r["front"] == "true").count();
    assert!(0 < front && front < all.len());
    if !suite::slow() {
        return;
    }
    assert_eq!(of("probe order").len(), 4);
    // Twice the density or more: nearer to the points between texels.
    let density = of("texel density");
    assert!(number(&density[3], "error") < number(&density[0], "error"), "{density:?}");
}

#[test]
fn studies_refuse_what_they_cannot_do() {
    let dir = tool::folder_with(&room(Room::default()));
    let done = tool::bake(&["study", "scene.glb", "--knobs", "colour"], dir.path()).expect(2);
    assert!(done.stderr.contains("--knobs colour: there are samples,"), "{done}");
    assert!(!dir.path().join("scene.study").exists(), "nothing came of it");
    fs::create_dir(dir.path().join("mine")).unwrap();
    fs::write(dir.path().join("mine/thesis.txt"), "x").unwrap();
    let done = tool::bake(&["study", "scene.glb", "-o", "mine"], dir.path()).expect(2);
    assert!(done.stderr.contains("is no study"), "{done}");
    assert_eq!(fs::read_dir(dir.path().join("mine")).unwrap().count(), 1);
    fs::write(dir.path().join("bake.toml"), "[run]\nbounces = 2\n").unwrap();
    let done = tool::bake(&["study", "scene.glb", "--config", "bake.toml"], dir.path()).expect(2);
    assert!(done.stderr.contains("which a study turns by itself"), "{done}");
    let done = tool::bake(&["run", "scene.glb", "--zh-order", "3"], dir.path()).expect(2);
    assert!(done.stderr.contains("for --media table"), "{done}");
    let done = tool::bake(&["run", "scene.glb", "--audit", "3", "--time-budget", "9s"], dir.path()).expect(2);
    assert!(done.stderr.contains("no share of --time-budget"), "{done}");
}

/// In a furnace of albedo 1/2 unbiased texels hold 2. With one reflection the map holds 1.5 of it.
#[test]
fn an_audit_says_by_how_much_a_limit_of_reflections_is_wrong() {
    let args = ["--samples", "16", "--texels-per-metre", "4", "--audit", "40"];
    let right = tool::baked(&furnace(0.5, 1.0), &args).manifest.bias.unwrap();
    assert!(right.mean.abs() < 4.0 * right.mean_std_err + 1e-3, "{right:?}");
    let wrong =
        tool::baked(&furnace(0.5, 1.0), &[&args[..], &["--bounces", "1"]].concat()).manifest.bias.unwrap();
    assert!((wrong.mean + 0.25).abs() < 4.0 * wrong.mean_std_err + 2e-3, "{wrong:?}");
    assert!(wrong.rms <= wrong.rms_at_most && (wrong.rms - 0.25).abs() < 0.02, "{wrong:?}");
    assert!(40 <= wrong.texels && wrong.texels <= 48, "{wrong:?}");
}

/// The same with a medium that scatters all it takes: `attenuate` loses it, `bounded` does not.
#[test]
fn an_audit_says_by_how_much_a_rung_is_wrong() {
    let fog = "{ sigma_s = 0.5 }";
    let bias = |mode: &str| {
        let args = ["--samples", "16", "--texels-per-metre", "4", "--audit", "40", "--media", mode];
        tool::baked_in(&furnace(0.5, 1.0), fog, &args).manifest.bias.unwrap()
    };
    let bounded = bias("bounded");
    assert!(bounded.mean.abs() < 4.0 * bounded.mean_std_err + 5e-3, "{bounded:?}");
    let attenuate = bias("attenuate");
    assert!(attenuate.mean < -0.2, "{attenuate:?}");
    let off = bias("off");
    // Without the medium the furnace is one all the same.
    assert!(off.mean.abs() < 4.0 * off.mean_std_err + 5e-3, "{off:?}");
}

#[test]
fn a_bake_says_what_its_error_is_and_what_half_of_it_would_take() {
    let dir = tool::folder_with(&room(Room::default()));
    let args =
        ["run", "scene.glb", "-o", "out", "--quality", "draft", "--texels-per-metre", "8", "--audit", "8"];
    let done = tool::bake(&[&args[..], &["--progress", "plain"]].concat(), dir.path()).expect(0);
    let line = |name: &str| {
        let start = format!("{name}: ");
        let found = done.stderr.lines().find(|l| l.starts_with(&start));
        found.unwrap_or_else(|| panic!("no line `{name}`:\n{done}")).to_owned()
    };
    assert!(line("error").contains("of the mean, ") && line("error").contains("irradiance cache"), "{done}");
    assert!(line("bias").contains("at 8 texels") || line("bias").contains("at 9 texels"), "{done}");
    assert!(line("next").contains("--target-error 0."), "{done}");
    assert!(line("time").contains("sample"), "{done}");
}
