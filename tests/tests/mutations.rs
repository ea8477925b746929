//! The stability suite notices when a guard is taken out of the product.
//!
//! Each mutation replaces one piece of text in a copy of the workspace; then the case that is named has to fail. Building the copies takes minutes, so that
//! happens with `RUN_SLOW_TESTS=1` only; `MUTATION=part` takes those out whose guard contains the part.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs, io};

/// A guard, and what notices its absence.
struct Mutation {
    guard: &'static str,
    file: &'static str,
    text: &'static str,
    without: &'static str,
    /// Group and name of the case.
    case: &'static str,
}

const MUTATIONS: [Mutation; 9] = [
    Mutation {
        guard: "the difference from 1 of an exponential that is nearly 1",
        file: "bake/src/media/mod.rs",
        text: "-(-turns).exp_m1() / turns",
        without: "(1.0 - (-turns).exp()) / turns",
        case: "segments: fog that falls with height, along a slope of 1e-8",
    },
    Mutation {
        guard: "rays that are parallel to faces",
        file: "bake/src/media/mod.rs",
        text: "if !inverse.is_finite() {",
        without: "if inverse.is_nan() {",
        case: "segments: boxes that touch count once within an ulp of their common face",
    },
    Mutation {
        guard: "backward scattering turned around",
        file: "bake/src/media/mod.rs",
        text: "let (g, x) = if g < 0.0 { (-g, -x) } else { (g, x) };",
        without: "",
        case: "responses: phase function of g -0.99999994 at both ends",
    },
    Mutation {
        guard: "the gate",
        file: "bake/src/solve/accumulate.rs",
        text: "if is_admissible(colour) {",
        without: "if is_admissible(colour) || colour == colour.abs() {",
        case: "numbers: a lamp of 1e38 cd a millimetre over a floor",
    },
    Mutation {
        guard: "offsets in proportion to the scene",
        file: "bake/src/geom/ray.rs",
        text: "magnitude * (16.0 * f32::EPSILON)\n",
        without: "(magnitude * (16.0 * f32::EPSILON)).max(1e-5)\n",
        case: "exact: lengths times 2^-10, off",
    },
    Mutation {
        guard: "roulette that does not depend on the strength of lights",
        file: "bake/src/transport/path.rs",
        text: "let survival = (strongest / below).min(limit);",
        without: "let survival = (strongest * (0.5 + out.direct.max_element()) / below).min(limit);",
        case: "exact: light times 2^-20, off",
    },
    Mutation {
        guard: "the count of values beyond half floats",
        file: "bake/src/output/texture.rs",
        text: "u64::from(!below && greatest < v.abs())",
        without: "u64::from(!below && f32::MAX < v.abs())",
        case: "numbers: 6.6e4 nits as rgba16f",
    },
    Mutation {
        guard: "the window against ringing",
        file: "tables/src/probes/window.rs",
        text: "if rings(light) <= 0.0 {",
        without: "if rings(light) < f64::INFINITY {",
        case: "numbers: a beam in l2: how far irradiance is below 0",
    },
    Mutation {
        guard: "truncated expansions are not negative",
        file: "tables/src/harmonics/zonal.rs",
        text: "double_product(zh, &CLAMPED_COSINE_F32, x).max(0.0)",
        without: "double_product(zh, &CLAMPED_COSINE_F32, x)",
        case: "responses: irradiance of a receiver that turns away is never negative",
    },
];

fn patched(root: &Path, m: &Mutation) -> String {
    let text = fs::read_to_string(root.join(m.file)).expect("a source file");
    let n = text.matches(m.text).count();
    assert_eq!(n, 1, "{}: `{}` is there {n} times", m.file, m.text);
    text.replace(m.text, m.without)
}

/// What is replaced is there, once, so that a guard that moves takes its mutation with it.
#[test]
fn guards_are_where_they_were() {
    for m in &MUTATIONS {
        assert_ne!(patched(&suite::root(), m), "", "{}", m.guard);
    }
}

/// Everything but build products and what begins with a dot.
fn copy(from: &Path, to: &Path) -> io::Result<()> {
    fs::create_dir_all(to)?;
    for entry in fs::read_dir(from)? {
        let entry = entry?;
        let name = entry.file_name();
        let hidden = name.to_string_lossy().starts_with('.');
        if hidden || name == "target" {
            continue;
        }
        let (path, copied) = (entry.path(), to.join(&name));
        if path.is_dir() {
            copy(&path, &copied)?;
        } else {
            fs::copy(path, copied)?;
        }
    }
    Ok(())
}

/// Where the copies are built: always the same folder, so that dependencies are compiled once.
fn target() -> PathBuf {
    let exe = env::current_exe().expect("a test knows where it is");
    let target = exe.ancestors().nth(3).expect("a test lies in target/profile/deps");
    target.join("mutations")
}

/// Runs one case of the copy's suite: whether it passes, and what was printed.
fn suite_passes(root: &Path, case: &str) -> (bool, String) {
    let cargo = env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let done = Command::new(cargo)
        .args(["test", "--package", "suite", "--test", "stability", "hard_cases", "--", "--nocapture"])
        .current_dir(root)
        .env("CARGO_TARGET_DIR", target())
        // Most of the time goes into building, not into the case.
        .env("CARGO_PROFILE_DEV_OPT_LEVEL", "0")
        .env("STABILITY", case)
        .output()
        .expect("cargo can be started");
    let text = [done.stdout, done.stderr].map(|b| String::from_utf8_lossy(&b).into_owned());
    (done.status.success(), text.concat())
}

#[test]
#[expect(clippy::print_stdout, reason = "what became of each mutation is reported")]
fn mutations_are_noticed() {
    if !suite::slow() {
        println!("skipped: mutations are built with RUN_SLOW_TESTS=1");
        return;
    }
    let dir = tempfile::tempdir().expect("a folder");
    let root = dir.path().join("workspace");
    copy(&suite::root(), &root).expect("room for a copy");
    let (passes, text) = suite_passes(&root, MUTATIONS[0].case);
    assert!(passes, "the copy fails without any mutation:\n{text}");
    let mut missed = Vec::new();
    let part = env::var("MUTATION").unwrap_or_default();
    for m in MUTATIONS.iter().filter(|m| m.guard.contains(&part)) {
        let path = root.join(m.file);
        let before = fs::read_to_string(&path).expect("a source file");
        fs::write(&path, patched(&root, m)).expect("a writable copy");
        let (passes, text) = suite_passes(&root, m.case);
        fs::write(&path, before).expect("a writable copy");
        // A copy that does not build says nothing of the case.
        let named = text.lines().find(|l| l.starts_with(m.case) && l.ends_with("allowed"));
        // The product may refuse what it has made before the case can judge it.
        let refused = (!passes && text.contains("hard_cases_are_stable ... FAILED"))
            .then_some("the case ends in an error");
        let noticed = named.or(refused);
        println!("without {}: {}", m.guard, noticed.unwrap_or("not noticed"));
        if passes || noticed.is_none() {
            missed.push(format!("{}:\n{text}", m.guard));
        }
    }
    assert!(missed.is_empty(), "{} mutations were not noticed:\n{}", missed.len(), missed.join("\n"));
}
