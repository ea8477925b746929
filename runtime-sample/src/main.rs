//! Shows a bake as a game would: everything comes from the files of one folder.
//!
//! The code is meant to be read as the specification of that folder: [`load`] opens it, [`draw`] uses it.

mod draw;
mod load;

use std::{path::PathBuf, process::ExitCode};

use anyhow::{Context, Result};
use clap::Parser;

/// Reads a bake, says what is in it, and draws it.
#[derive(Debug, Parser)]
#[command(version, about)]
struct Args {
    /// Folder that `bake run` wrote
    dir: PathBuf,
    /// Draw the scene with its lightmaps into this file
    #[arg(long, value_name = "PNG")]
    screenshot: Option<PathBuf>,
    /// Which camera of the scene, from 0 on
    #[arg(long, value_name = "INDEX", default_value_t = 0)]
    camera: usize,
    /// Multiplies radiance before tone mapping [default: fits the lightmaps' mean]
    #[arg(long, value_name = "X")]
    exposure: Option<f32>,
}

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            #[expect(clippy::print_stderr, reason = "this is the command line")]
            {
                eprintln!("error: {e:#}");
            }
            ExitCode::from(2)
        }
    }
}

fn run(args: &Args) -> Result<()> {
    let bake = load::Bake::open(&args.dir)?;
    report(&bake);
    let Some(path) = &args.screenshot else { return Ok(()) };
    let scene = load::Scene::open(&args.dir.join("scene.glb"), bake.pages.len())?;
    let camera = scene.camera(args.camera)?;
    let picture = draw::draw(&scene, &bake, camera, args.exposure.unwrap_or_else(|| bake.exposure()));
    picture.save(path).with_context(|| format!("{}: cannot write", path.display()))
}

#[expect(clippy::print_stdout, reason = "this is the command line")]
fn report(bake: &load::Bake) {
    let m = &bake.manifest;
    println!("{} {}, unit {}, {}", m.tool.name, m.tool.version, m.unit, m.color_space);
    for (n, (entry, page)) in m.pages.iter().zip(&bake.pages).enumerate() {
        let surfaces = m.surfaces.iter().filter(|s| s.page == n).count();
        println!(
            "page {n}: {}, {} x {} texels, {surfaces} surfaces, mean luminance {:.6} nits ({:.6} said)",
            entry.file,
            page.width,
            page.height,
            page.mean_luminance(),
            entry.mean_luminance
        );
    }
    println!("{} surfaces, {} lights", m.surfaces.len(), m.lights.len());
}
