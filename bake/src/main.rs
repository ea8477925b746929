//! The command-line tool; see [`bake::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    bake::cli::main()
}
