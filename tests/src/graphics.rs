//! Runs `runtime-sample`, which draws a bake's folder on a graphics adapter.

use std::{env, fs, path::Path, sync::OnceLock, time::Duration};

use crate::{
    browser,
    tool::{self, Finished},
};

/// How long a picture may take, on a busy machine whose processor draws.
const PATIENCE: Duration = Duration::from_secs(120);

/// What `runtime-sample` says where nothing can draw.
pub const NO_ADAPTER: &str = "no graphics adapter";

/// Runs `runtime-sample` in `dir`.
///
/// # Panics
/// If it has not ended after two minutes.
#[must_use]
pub fn show(args: &[&str], dir: &Path) -> Finished {
    show_with(args, dir, &[])
}

/// [`show`] with environment variables, names and values.
///
/// # Panics
/// If it has not ended after two minutes.
#[must_use]
pub fn show_with(args: &[&str], dir: &Path, variables: &[(&str, &str)]) -> Finished {
    tool::start_with(tool::runtime_sample_path(), args, dir, variables).wait(PATIENCE)
}

/// Whether pictures can be drawn. Without an adapter (Vulkan, Metal or Direct3D 12; a software driver will do) it prints that `test` is
/// skipped.
///
/// # Panics
/// Where the environment says that pictures are to be tested (`REQUIRE_GRAPHICS=1`), or if `runtime-sample` fails in another way.
#[must_use]
pub fn available(test: &str) -> bool {
    static FOUND: OnceLock<bool> = OnceLock::new();
    let found = *FOUND.get_or_init(|| {
        // A folder that cannot be drawn: the adapter is opened before its manifest is read.
        let dir = tempfile::tempdir().expect("a temporary folder");
        fs::write(dir.path().join("manifest.json"), "{}").expect("a writable temporary folder");
        let done = show(&[".", "--screenshot", "view.png"], dir.path()).expect(2);
        let none = done.stderr.contains(NO_ADAPTER);
        assert!(none || done.stderr.contains("manifest.json"), "{done}");
        !none
    });
    if !found {
        skip(test, NO_ADAPTER);
    }
    found
}

/// Whether windows can be opened and given keys by programs: [`available`], and Xvfb and xdotool, which `test` starts, are installed. Else it
/// prints that `test` is skipped.
///
/// # Panics
/// As [`available`].
#[must_use]
pub fn display(test: &str) -> bool {
    let absent = ["Xvfb", "xdotool"].into_iter().find(|name| browser::program(&[name]).is_none());
    if let Some(name) = absent {
        skip(test, &format!("{name} is not installed"));
    }
    absent.is_none() && available(test)
}

/// Says that `test` is skipped.
///
/// # Panics
/// Where the environment says that pictures are to be tested (`REQUIRE_GRAPHICS=1`).
#[expect(clippy::print_stdout, reason = "a skipped test says so")]
pub fn skip(test: &str, why: &str) {
    assert!(env::var_os("REQUIRE_GRAPHICS").is_none_or(|v| v != "1"), "{test}: {why}");
    println!("skipped: {test}: {why}");
}
