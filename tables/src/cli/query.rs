//! `tables query`.

#![expect(clippy::print_stderr, reason = "what was clamped")]

use super::args::{EmitterArg, QueryArgs};
use super::{Error, open, print};
use crate::table::Query;
use serde_json::json;
use std::process::ExitCode;

pub(super) fn run(args: &QueryArgs) -> Result<ExitCode, Error> {
    let tables = open(args.file.file.as_deref())?;
    let answer = tables.query(&Query {
        emitter: args.emitter.into(),
        depth: args.depth,
        theta: args.theta.to_radians(),
        g: args.g,
        albedo: args.albedo,
        orders: args.orders,
    })?;
    for what in &answer.clamped {
        eprintln!("warning: {what} is outside the tables; the answer is that of their end");
    }
    let area = args.emitter == EmitterArg::Area;
    if args.json {
        let mut out = json!({ "zh": answer.zh });
        if area {
            out["axis"] = json!(answer.axis);
        }
        if !answer.clamped.is_empty() {
            out["clamped"] = json!(answer.clamped);
        }
        print(&format!("{out}\n"))?;
    } else {
        let mut text: String =
            answer.zh.iter().enumerate().map(|(l, v)| format!("{l:2} {v:.6e}\n")).collect();
        if area {
            let [x, y, z] = answer.axis;
            text += &format!("axis {x:.6} {y:.6} {z:.6}\n");
        }
        print(&text)?;
    }
    Ok(ExitCode::SUCCESS)
}
