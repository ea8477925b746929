//! `tables build`.

#![expect(clippy::print_stderr, reason = "progress is for the user")]

use super::args::{BuildArgs, PresetArg};
use super::{Error, write};
use crate::table::build::{COLUMNS, DEFAULT, HALVED, PAPER, QUARTERED, build};
use std::process::ExitCode;
use std::time::Instant;

pub(super) fn run(args: &BuildArgs) -> Result<ExitCode, Error> {
    let preset = match args.preset {
        PresetArg::Default => DEFAULT,
        PresetArg::Half => HALVED,
        PresetArg::Quarter => QUARTERED,
        PresetArg::Columns => COLUMNS,
        PresetArg::Paper => PAPER,
    };
    // Not after minutes of work.
    let folder = args.output.parent().filter(|p| !p.as_os_str().is_empty());
    if folder.is_some_and(|p| !p.is_dir()) {
        return Err(Error::Usage(format!("{}: there is no such folder", args.output.display())));
    }
    let start = Instant::now();
    let contents = build(&preset, &|what| eprintln!("{:6.1} s  {what}", start.elapsed().as_secs_f64()));
    let bytes = crate::table::file::write(preset.name, &contents);
    write(&args.output, &bytes)?;
    eprintln!(
        "{:6.1} s  wrote {}, {} bytes",
        start.elapsed().as_secs_f64(),
        args.output.display(),
        bytes.len()
    );
    Ok(ExitCode::SUCCESS)
}
