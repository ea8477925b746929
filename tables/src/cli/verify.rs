//! `tables verify`.

#![expect(clippy::print_stderr, reason = "progress")]

use super::args::VerifyArgs;
use super::{Error, open, print};
use crate::table::verify::{DEPTHS, MOST_G, Row, verify};
use std::process::ExitCode;
use std::time::Instant;

pub(super) fn run(args: &VerifyArgs) -> Result<ExitCode, Error> {
    let tables = open(args.file.file.as_deref())?;
    let start = Instant::now();
    let report = verify(&tables, args.queries, args.seed, &|what| {
        eprintln!("{:6.1} s  {what}", start.elapsed().as_secs_f64());
    });
    let holds = report.holds();
    if args.json {
        print(&format!("{}\n", serde_json::to_string_pretty(&report).unwrap_or_default()))?;
        return Ok(ExitCode::from(u8::from(!holds)));
    }
    let queries: usize = report.lookups.iter().map(|r| r.queries).sum();
    let mut text = format!(
        "Entries, computed again at a higher resolution. Error: largest difference of a coefficient / first one\n{}\n\
         Look-ups: {queries} at random, depth {:e} to {}, g to {MOST_G} either way, all angles and albedos\n{}\n\
         Lobes for patches: error of irradiance over all receiver normals / greatest irradiance\n\
         {:26} {:>6} {:>9} {:>9}\n",
        rows(&report.entries),
        DEPTHS.0,
        DEPTHS.1,
        rows(&report.lookups),
        "",
        "n",
        "mean",
        "worst"
    );
    for f in &report.fits {
        text += &format!("{:26} {:6} {:9.1e} {:9.1e}  at {}\n", f.what, f.queries, f.mean, f.worst, f.place);
    }
    text += if holds { "\nall within bounds\n" } else { "\nNOT all within bounds\n" };
    print(&text)?;
    Ok(ExitCode::from(u8::from(!holds)))
}

fn rows(rows: &[Row]) -> String {
    let mut text =
        format!("{:26} {:>6} {:>9} {:>9} {:>9} {:>9}\n", "", "n", "mean", "99 %", "worst", "bound");
    for r in rows {
        text += &format!(
            "{:26} {:6} {:9.1e} {:9.1e} {:9.1e} {:9.1e}{} at {}\n",
            r.what,
            r.queries,
            r.mean,
            r.most,
            r.worst,
            r.bound,
            if r.bound < r.worst { "!" } else { " " },
            r.place
        );
    }
    text
}
