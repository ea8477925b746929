//! Scene builders and helpers for whole-tool tests.

use std::{env, path::PathBuf};

pub mod baked;
pub mod browser;
pub mod divided;
pub mod gltf;
pub mod graphics;
pub mod pictures;
pub mod reference;
pub mod rooms;
pub mod scenes;
pub mod shape;
pub mod stats;
pub mod tool;

/// The repository's root.
#[must_use]
pub fn root() -> PathBuf {
    let tests = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    tests.parent().map_or_else(|| tests.clone(), PathBuf::from)
}

/// The folder of scenes and reference values that are too large to check in: `shared` beside the repository, or what
/// `BAKE_SHARED` names. `None` prints that `test` is skipped.
#[must_use]
#[expect(clippy::print_stdout, reason = "a skipped test says so")]
pub fn shared(test: &str) -> Option<PathBuf> {
    let beside = || root().join("../shared");
    let folder = env::var_os("BAKE_SHARED").map_or_else(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: {test}: there is no folder of shared scenes");
    None
}

/// Whether tests that take minutes are asked for (`RUN_SLOW_TESTS=1`).
#[must_use]
pub fn slow() -> bool {
    env::var_os("RUN_SLOW_TESTS").is_some_and(|v| v == "1")
}
