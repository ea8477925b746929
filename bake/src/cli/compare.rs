//! `bake compare`.

#![expect(clippy::print_stdout, reason = "the report is the command's result")]

use crate::cli::args::CompareArgs;
use crate::compare::{Options, Verdict, compare_with};
use crate::error::Error;
use std::process::ExitCode;

pub(crate) fn run(args: &CompareArgs) -> Result<ExitCode, Error> {
    let options = Options {
        alpha: args.alpha.unwrap_or(Options::STANDARD.alpha),
        tolerance: args.tolerance.unwrap_or(Options::STANDARD.tolerance),
    };
    if !(0.0 < options.alpha && options.alpha < 1.0) {
        return Err(Error::Usage(format!("--alpha {}: write a number between 0 and 1", options.alpha)));
    }
    if !(0.0 <= options.tolerance && options.tolerance.is_finite()) {
        return Err(Error::Usage(format!("--tolerance {}: write 0 or more", options.tolerance)));
    }
    let report = compare_with(&args.a, &args.b, args.output.as_deref(), &options)?;
    if args.json {
        let text = serde_json::to_string_pretty(&report)
            .map_err(|e| Error::Usage(format!("the report cannot be written as JSON: {e}")))?;
        println!("{text}");
    } else {
        println!("{report}");
    }
    Ok(ExitCode::from(u8::from(report.verdict == Verdict::Different)))
}
