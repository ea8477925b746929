//! `bake check`.

use crate::cli::args::CheckArgs;
use crate::cli::input;
use crate::cli::say;
use crate::error::{Error, Finding, Severity};
use crate::scene::model::LightmapMode;
use std::process::ExitCode;

pub(crate) fn run(args: &CheckArgs) -> Result<ExitCode, Error> {
    let input = match input::load(&args.scene) {
        Ok(input) => input,
        Err(Error::Input(findings)) => return Ok(report(&findings)),
        Err(e) => return Err(e),
    };
    let mut findings = input.findings;
    if findings.iter().all(|f| f.severity != Severity::Error) {
        let s = &input.scene;
        let triangles: usize = s.surfaces.iter().map(|x| s.meshes[x.mesh].triangles.len()).sum();
        let texels = s.surfaces.iter().filter(|x| x.lightmap == LightmapMode::On).count();
        findings.push(Finding::info(
            "scene",
            format!(
                "{} surfaces ({texels} with texels), {triangles} triangles, {} materials, {} images, {} lights",
                s.surfaces.len(),
                s.materials.len(),
                s.images.len(),
                s.lights.len(),
            ),
            "nothing to do",
        ));
    }
    Ok(report(&findings))
}

/// Prints all findings and counts them; 2 if one is an error.
fn report(findings: &[Finding]) -> ExitCode {
    say::findings(findings, true);
    let count = |s| findings.iter().filter(|f| f.severity == s).count();
    let errors = count(Severity::Error);
    say::line(&format!(
        "{errors} error(s), {} warning(s), {} note(s)",
        count(Severity::Warning),
        count(Severity::Info)
    ));
    ExitCode::from(if errors == 0 { 0 } else { 2 })
}
