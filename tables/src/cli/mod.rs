//! The command line: build, inspect, draw, ask and verify tables.
//!
//! Exit codes: 0 done, 1 `verify` found an error beyond its bound, 2 bad usage or input or a failure.

mod args;
mod build;
mod inspect;
mod plot;
mod query;
mod verify;

use crate::table::Tables;
use crate::table::file::FileError;
use args::{Args, Command};
use clap::Parser;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Why a command fails.
#[derive(Debug, thiserror::Error)]
enum Error {
    /// A file cannot be read or written.
    #[error("{path}: {source}; {remedy}")]
    File { path: PathBuf, source: std::io::Error, remedy: &'static str },
    /// A file is not what it should be.
    #[error("{path}: {source}")]
    Format { path: String, source: FileError },
    /// A question without an answer.
    #[error(transparent)]
    Query(#[from] crate::table::query::QueryError),
    /// An argument.
    #[error("{0}")]
    Usage(String),
    /// A picture cannot be drawn.
    #[error("cannot draw: {0}")]
    Draw(String),
}

/// Parses the arguments, runs the command and turns its end into an exit code.
#[must_use]
#[expect(clippy::print_stderr, reason = "errors go to the user")]
pub fn main() -> ExitCode {
    let args = Args::parse();
    let result = match args.command {
        Command::Build(a) => build::run(&a),
        Command::Inspect(a) => inspect::run(&a),
        Command::Plot(a) => plot::run(&a),
        Command::Query(a) => query::run(&a),
        Command::Verify(a) => verify::run(&a),
    };
    match result {
        Ok(code) => code,
        Err(e) => {
            eprintln!("error: {e}");
            ExitCode::from(2)
        }
    }
}

/// Prints a result. Whoever stops reading it is no failure.
fn print(text: &str) -> Result<(), Error> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(Error::Usage(format!("cannot print: {e}")))
        }
        _ => Ok(()),
    }
}

/// The named file, or the embedded one.
fn open(file: Option<&Path>) -> Result<Tables, Error> {
    let Some(path) = file else {
        return Tables::embedded()
            .map_err(|source| Error::Format { path: "embedded file".to_owned(), source });
    };
    let bytes = std::fs::read(path).map_err(|source| Error::File {
        path: path.to_owned(),
        source,
        remedy: "name a file that `tables build` has written, or none for the embedded one",
    })?;
    Tables::from_bytes(bytes).map_err(|source| Error::Format { path: path.display().to_string(), source })
}

/// Writes a file as a whole: under another name first, so that nothing half-written is left.
fn write(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".part");
    let part = path.with_file_name(name);
    let failed =
        |source| Error::File { path: path.to_owned(), source, remedy: "choose another place with -o" };
    std::fs::write(&part, bytes).and_then(|()| std::fs::rename(&part, path)).map_err(|e| {
        let _ = std::fs::remove_file(&part);
        failed(e)
    })
}
