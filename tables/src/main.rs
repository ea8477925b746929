//! The command-line tool; see [`tables::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    tables::cli::main()
}
