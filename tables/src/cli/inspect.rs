//! `tables inspect`.

use super::args::InspectArgs;
use super::{Error, open, print};
use crate::table::file::{Axis, Form};
use std::process::ExitCode;

pub(super) fn run(args: &InspectArgs) -> Result<ExitCode, Error> {
    let tables = open(args.file.file.as_deref())?;
    let header = tables.header();
    if args.json {
        print(&format!("{}\n", serde_json::to_string_pretty(header).unwrap_or_default()))?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut text = format!(
        "preset {}, version {}, {} bands, {} bytes, BLAKE3 {}\n{:12} {:12} {:>8} {:>10}  over\n",
        header.preset,
        header.version,
        header.bands,
        tables.bytes(),
        tables.checksum(),
        "emitter",
        "orders",
        "entries",
        "bytes"
    );
    for b in &header.blocks {
        let axes: Vec<String> = b.axes.iter().map(axis).collect();
        let form = match b.form {
            Form::Zonal => "",
            Form::Lobe => "; lobes with shifted axes",
            Form::Full => "; full harmonics and shifts",
        };
        text += &format!(
            "{:12} {:12} {:8} {:10}  {}{form}\n",
            b.emitter.to_string(),
            b.part.to_string(),
            b.entries(),
            b.bytes(),
            axes.join(" x ")
        );
    }
    print(&text)?;
    Ok(ExitCode::SUCCESS)
}

fn axis(axis: &Axis) -> String {
    let n = axis.len();
    match *axis {
        Axis::Distance { first, last, .. } => format!("{n} distances {first:e} to {last}"),
        Axis::G { to, .. } | Axis::Columns { to, .. } => format!("{n} g {} to {to}", -to),
        Axis::RootOfAbsorption { from, .. } => format!("{n} albedos 0 to {:.3}", 1.0 - from * from),
        Axis::Angle { .. } | Axis::Bins { .. } => format!("{n} angles"),
    }
}
