//! Shows a bake as a game would: everything comes from the files of one folder.
//!
//! The code is meant to be read as the specification of that folder: [`files`] opens it, [`gpu`] draws it. [`view`] is what is looked at,
//! [`picture`] draws without a window and [`window`] with one.

mod args;
mod files;
mod gpu;
mod picture;
mod view;
mod window;

use std::{fs, path::PathBuf, process::ExitCode};

use anyhow::{Context, Result, ensure};
use clap::Parser;

use args::Args;
use files::bake::{self, Bake, Reading};
use gpu::device::{self, Gpu};
use picture::{Kind, Shown, Studio};
use view::{
    balls::{self, Ball},
    camera::Pose,
    look::Look,
};

fn main() -> ExitCode {
    match run(&Args::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            #[expect(clippy::print_stderr, reason = "this is the command line")]
            {
                eprintln!("error: {}", told(&e));
            }
            ExitCode::from(2)
        }
    }
}

/// An error and its causes in one line. Some causes repeat what was said of them, or have lines of their own.
fn told(error: &anyhow::Error) -> String {
    let mut all = String::new();
    for cause in error.chain() {
        let words = cause.to_string();
        let words = words.split_whitespace().collect::<Vec<_>>().join(" ");
        if !all.contains(&words) {
            all += if all.is_empty() { "" } else { ": " };
            all += &words;
        }
    }
    all
}

fn run(args: &Args) -> Result<()> {
    // Before what takes long.
    let radiance = match &args.screenshot {
        Some(path) => picture::kind(path)? == Kind::Exr,
        None => false,
    };
    let folders = bake::folders(&args.dir)?;
    if args.screenshot.is_none() && args.turntable.is_none() && args.timings.is_none() {
        return window::run(args, &folders);
    }
    let (gpu, _) = Gpu::open(&device::instance(None), None, args.software)?;
    let bakes = opened(args, &wanted(args, &folders), &gpu)?;
    bakes.iter().for_each(report);
    let mut studio = Studio::new(gpu, args.size, args.antialias, radiance)?;
    let chosen = chosen(args, &bakes)?;
    let on_card = chosen.iter().map(|b| studio.renderer().upload(b)).collect::<Result<Vec<_>>>()?;
    let first = chosen.first().context("there is no bake")?;
    let mut pose = Pose::new(&first.camera_named(args.camera.as_deref())?, first);
    let look = look(args, first);
    let balls = balls_of(args, first, &pose);
    let mut shown = Shown {
        bakes: chosen.iter().copied().zip(&on_card).collect(),
        wipe: args.wipe,
        look: &look,
        balls: &balls,
        seconds: args.time,
    };
    if let Some(path) = &args.screenshot {
        studio.picture(&shown, &pose, radiance)?.save(path)?;
    }
    if let Some(folder) = &args.turntable {
        fs::create_dir_all(folder)
            .with_context(|| format!("{}: cannot make this folder", folder.display()))?;
        for frame in 0..args.frames {
            shown.seconds = args.time + frame as f32 / 12.0;
            studio.picture(&shown, &pose, false)?.save(&folder.join(format!("{frame:03}.png")))?;
            pose.orbit(std::f32::consts::TAU / args.frames as f32);
        }
    }
    if let Some(frames) = args.timings {
        say(&studio.timings(&shown, &pose, frames)?);
    }
    Ok(())
}

/// The folders of the bakes that a picture shows; all where a label is wrong, so that they can be named.
fn wanted(args: &Args, folders: &[PathBuf]) -> Vec<PathBuf> {
    let labels = [args.bake.as_ref(), args.against.as_ref()];
    let is = |f: &PathBuf, label: &String| f.file_name().is_some_and(|n| n.to_string_lossy() == *label);
    let named: Vec<PathBuf> =
        labels.into_iter().flatten().filter_map(|l| folders.iter().find(|f| is(f, l))).cloned().collect();
    let all = labels.iter().flatten().count();
    match (args.bake.is_some(), named.len() == all) {
        (true, true) => named,
        (false, true) => folders.first().cloned().into_iter().chain(named).collect(),
        (_, false) => folders.to_vec(),
    }
}

/// Reads bakes, which should be of one scene.
fn opened(args: &Args, folders: &[PathBuf], gpu: &Gpu) -> Result<Vec<Bake>> {
    let reading =
        Reading { pages: args.pages, blocks: gpu.blocks, lamps: gpu::MOST_LAMPS, volume: gpu.most_slices };
    let bakes: Vec<Bake> = folders.iter().map(|f| Bake::open(f, reading)).collect::<Result<_>>()?;
    let scene = |b: &Bake| b.manifest.inputs.iter().find(|i| i.role == "scene").map(|i| i.blake3.clone());
    if let Some(other) = bakes.iter().find(|b| scene(b) != scene(&bakes[0])) {
        say(&format!("{} and {} are bakes of different scenes", bakes[0].label, other.label));
    }
    Ok(bakes)
}

/// The bakes that are asked for: one, or both sides of the wiper.
fn chosen<'a>(args: &Args, bakes: &'a [Bake]) -> Result<Vec<&'a Bake>> {
    let named = |label: &str| {
        let found = bakes.iter().find(|b| b.label == label);
        let labels: Vec<_> = bakes.iter().map(|b| b.label.as_str()).collect();
        found.with_context(|| {
            let dir = args.dir.display();
            format!(
                "there is no bake `{label}` in {dir}, only {}; several are folders side by side",
                labels.join(", ")
            )
        })
    };
    let first = match &args.bake {
        Some(label) => named(label)?,
        None => bakes.first().context("there is no bake")?,
    };
    let mut chosen = vec![first];
    if let Some(label) = &args.against {
        let second = named(label)?;
        ensure!(!std::ptr::eq(first, second), "`{label}` is on both sides of the wiper: name two bakes");
        chosen.push(second);
    }
    Ok(chosen)
}

/// The spheres that are asked for, or moving ones.
fn balls_of(args: &Args, bake: &Bake, pose: &Pose) -> Vec<Ball> {
    match &args.ball[..] {
        [] => balls::placed(&bake.scene, pose),
        still => still.iter().map(|s| s.ball(bake)).collect(),
    }
}

fn look(args: &Args, bake: &Bake) -> Look {
    Look {
        mode: args.show,
        fog: !args.no_fog,
        normals: !args.no_normals,
        balls: !args.no_balls,
        probes: args.probes,
        exposure: args.exposure.unwrap_or(bake.exposure),
        stops: 0.0,
    }
}

/// What a bake holds.
fn report(bake: &Bake) {
    let m = &bake.manifest;
    say(&format!("{}: {} {}, unit {}, {}", bake.label, m.tool.name, m.tool.version, m.unit, m.color_space));
    for (n, (entry, page)) in m.pages.iter().zip(&bake.pages).enumerate() {
        let surfaces = m.surfaces.iter().filter(|s| s.page == n).count();
        say(&format!(
            "page {n}: {}, {} x {} texels, {surfaces} surfaces, mean luminance {:.6} nits ({:.6} said)",
            entry.file, page.width, page.height, page.mean_luminance, entry.mean_luminance
        ));
    }
    let probes = bake.probes.as_ref().map_or(0, |p| p.probes.len());
    say(&format!(
        "{} triangles, {} surfaces with texels, {} lamps, {} media, {probes} probes",
        bake.scene.indices.len() / 3,
        m.surfaces.len(),
        bake.lamps.len(),
        bake.media.all.len()
    ));
}

#[expect(clippy::print_stdout, reason = "this is the command line")]
fn say(text: &str) {
    println!("{text}");
}
