//! The runtime sample, where there is a graphics adapter.
use crate::tool::{self, Finished};
use std::{path::Path, time::Duration};
/// Runs it.
#[must_use]
pub fn show(args: &[&str], dir: &Path) -> Finished {
    tool::start(tool::runtime_sample_path(), args, dir).wait(Duration::from_secs(120))
}
/// Whether there is an adapter.
#[must_use]
pub fn available(_: &str) -> bool {
    true
}
/// Whether there is a display.
#[must_use]
pub fn display(_: &str) -> bool {
    true
}
