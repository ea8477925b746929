//! `bake run --frames`: the frames of an animated volume, one after the other.

use crate::cli::args::{Frames, RunArgs};
use crate::cli::bake_run::one;
use crate::cli::say::{self, Interrupt};
use crate::compare;
use crate::error::Error;
use crate::output::folder::replace;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Frames that were baked, and how much lightmaps change between them: what a player would see as flicker, beside the noise of both.
#[derive(Serialize)]
struct Sequence {
    format: &'static str,
    version: u32,
    frames: Vec<Frame>,
}

#[derive(Serialize)]
struct Frame {
    frame: u32,
    folder: String,
    /// From the frame before; absent for the first.
    change: Option<Change>,
}

/// Both over the mean luminance of the frame before; absent where that is black.
#[derive(Clone, Copy, Serialize)]
struct Change {
    /// Root mean square over texels and channels.
    rms: Option<f64>,
    /// Of the channel of the texel that changes most.
    greatest: Option<f64>,
}

/// Name of a frame's folder.
pub(super) fn folder(frame: u32) -> String {
    format!("frame-{frame:04}")
}

pub(super) fn run(args: &RunArgs, frames: Frames, interrupt: &Interrupt) -> Result<ExitCode, Error> {
    let mut sequence = Sequence { format: "bake-frames", version: 1, frames: Vec::new() };
    let (mut worst, mut before) = (ExitCode::SUCCESS, None::<PathBuf>);
    for frame in frames.first..=frames.last {
        say::line(&format!("frame {frame} of {} to {}", frames.first, frames.last));
        let (code, path) = one(args, Some(frame), interrupt)?;
        if code != ExitCode::SUCCESS {
            worst = code;
        }
        let change = match before.as_deref().map(|before| change(&path, before)).transpose() {
            Ok(change) => change,
            // Both are there and whole.
            Err(e) => {
                say::line(&format!("warning: frame {frame} cannot be compared with the one before: {e}"));
                None
            }
        };
        if let Some(Change { rms: Some(rms), greatest: Some(greatest) }) = change {
            let (rms, greatest) = (100.0 * rms, 100.0 * greatest);
            say::line(&format!("change {rms:.2} % root mean square, {greatest:.2} % at most, of the mean"));
        }
        sequence.frames.push(Frame { frame, folder: folder(frame), change });
        if let Some(parent) = path.parent() {
            let text = serde_json::to_string_pretty(&sequence).expect("numbers and names");
            // After each: what was baked before an interruption counts.
            replace(&parent.join("frames.json"), text.as_bytes())?;
        }
        before = Some(path);
    }
    Ok(worst)
}

fn change(after: &Path, before: &Path) -> Result<Change, Error> {
    let total = compare::compare(after, before, None)?.total;
    let greatest = (0.0 < total.mean_b).then(|| total.max_difference / total.mean_b);
    Ok(Change { rms: total.relative_rmse, greatest })
}
