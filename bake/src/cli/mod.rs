//! The command line: arguments in, messages and exit codes out.
//!
//! Exit codes are a contract: 0 done, 1 a comparison found a difference or a target was missed,
//! 2 bad usage or input or a failure, 130 interrupted.

mod allocator;
mod args;
mod bake_run;
mod check;
mod compare;
mod frames;
mod html;
mod input;
mod points;
mod prepare;
mod replay;
mod say;
mod show_plan;
mod stopwatch;
mod study;

use crate::error::Error;
use args::{Args, Command};
use clap::{CommandFactory, Parser};
use std::process::ExitCode;

/// Parses the arguments, runs the command and turns its end into an exit code.
#[must_use]
pub fn main() -> ExitCode {
    allocator::give_back_large_blocks();
    if std::env::args_os().any(|a| a == "--version") {
        // Prints it and ends.
        let _ = Args::command().long_version(args::versions()).get_matches();
    }
    let args = Args::parse();
    let result = say::Interrupt::install().and_then(|interrupt| match args.command {
        Command::Run(a) => bake_run::run(&a, &interrupt),
        Command::Plan(a) => show_plan::run(&a, &interrupt),
        Command::Check(a) => check::run(&a),
        Command::Points(a) => points::run(&a, &interrupt),
        Command::Compare(a) => compare::run(&a),
        Command::Study(a) => study::run(&a, &interrupt),
        Command::Html(a) => html::run(&a),
        Command::Merge(_) => Err(Error::Usage(
            "`bake merge` is reserved: this version bakes on one machine without shards".to_owned(),
        )),
    });
    match result {
        Ok(code) => code,
        Err(e @ Error::Interrupted) => {
            say::line(&e.to_string());
            ExitCode::from(130)
        }
        Err(e) => {
            say::error(&e);
            ExitCode::from(2)
        }
    }
}
