//! Cuts one mesh into charts with xatlas: a process of its own, so that `bake` can end it.
use std::{io, process::ExitCode};

fn main() -> ExitCode {
    match bake::geom::atlas::xatlas::child(&mut io::stdin().lock(), &mut io::stdout().lock()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(_) => ExitCode::from(2),
    }
}
