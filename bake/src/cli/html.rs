//! `bake html`.

use crate::cli::args::HtmlArgs;
use crate::cli::say;
use crate::error::Error;
use crate::output::html;
use std::path::PathBuf;
use std::process::ExitCode;

pub(crate) fn run(args: &HtmlArgs) -> Result<ExitCode, Error> {
    let page = html::build(&args.bake)?;
    let path = match &args.output {
        Some(path) => path.clone(),
        None => PathBuf::from(format!("{}.html", html::name(&args.bake))),
    };
    std::fs::write(&path, &page).map_err(Error::io(&path, "cannot write"))?;
    say::line(&format!("{} ({})", path.display(), say::bytes(page.len() as u64)));
    Ok(ExitCode::SUCCESS)
}
