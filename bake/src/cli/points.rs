//! `bake points`.

#![expect(clippy::print_stdout, reason = "the result is one JSON object on standard output")]

use crate::cli::args::{PointsArgs, SceneArgs};
use crate::cli::input;
use crate::cli::replay;
use crate::cli::say::{self, Interrupt, Style};
use crate::error::{Error, Finding, Severity};
use crate::plan::{self, MediaMode, Quality, Tracing};
use crate::scene::config::RunConfig;
use crate::solve::Monitor;
use crate::solve::accumulate::{Gate, Kind};
use crate::solve::light_grid::Gathering;
use crate::solve::pilot::Learnt;
use crate::solve::points::{self, Until};
use crate::transport::Kernel;
use glam::Vec3;
use serde_json::{Value, json};
use std::path::Path;
use std::process::ExitCode;

/// Paths per point at most where an error is asked for: some minutes, and then the answer says that
/// the error was not reached.
const MOST: u32 = 1 << 25;

pub(crate) fn run(args: &PointsArgs, interrupt: &Interrupt) -> Result<ExitCode, Error> {
    let scene_args = SceneArgs {
        scene: Some(args.scene.clone()),
        config: args.config.clone(),
        sky: args.sky.clone(),
        light_units: args.light_units,
        frame: None,
    };
    let mut file = read(&args.points)?;
    let points = parse(&file, &args.points)?;
    let mut input = input::load(&scene_args)?;
    say::findings(&input.findings, false);
    plan::admit(&input.findings)?;
    let quality = match (args.quality, &input.run.quality) {
        (None, Some(text)) => Some(input::word(text, "run.quality")?),
        (given, _) => given,
    };
    let quality = quality.map_or(Quality::Medium, input::quality);
    let until = until(args, quality)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.work.threads.or(input.run.threads).unwrap_or(0) as usize)
        .build()
        .map_err(|e| Error::Usage(format!("cannot start the threads: {e}")))?;
    let monitor = Monitor::default();
    let force = input::force(&args.force, &input.run)?;
    // A file may speak of stages, because it is shared with bakes.
    if let Some(stage) = input::force(&args.force, &RunConfig::default())?.effects().find(|e| e.is_stage()) {
        return Err(Error::Usage(format!("--force {}=...: bake points has no such stage", stage.word())));
    }
    let media = input::media(args.media, &input.run, &force, &input.scene)?;
    say::findings(&force.leave_out(&mut input.scene), false);
    let direct = input::direct(args.direct, &input.run)?;
    let tuning = input::tuning(&args.tuning, (media, direct), &input.document)?;
    let tracing = Tracing::tuned(&input.scene, media, direct, &tuning, &force)?;
    let kernel = Kernel::new(&input.scene, &tracing, args.bounces.or(input.run.bounces), media);
    let seed = args.seed.or(input.run.seed).unwrap_or(0);
    let receivers: Vec<_> = points.iter().map(|&(p, n)| points::place(&kernel, p, n)).collect();
    let learnt = pool.install(|| Learnt::new(&kernel, &receivers, seed));
    let kernel = learnt.guide(kernel);
    let style = Style::new(args.work.progress);
    let air = (media == MediaMode::Bounded).then(|| input::light_grid(args.grid, quality, None));
    let air = air.and_then(|f| pool.install(|| Gathering::new(&kernel, f, seed)));
    let grid = match air {
        None => None,
        Some(air) => {
            let (paths, monitor) = (air.paths(), Monitor::default());
            if let Some(at) = args.replay.filter(|at| at.kind == Kind::Node) {
                return match pool.install(|| air.replay(&kernel, at.texel, at.sample)) {
                    Some(found) => Ok(replay::print(at, Some(&found), None)),
                    None => Err(Error::Usage(format!("--replay {at}: the light grid has no such path"))),
                };
            }
            let (grid, gate) = say::watch(style, "light in media", paths, &monitor, interrupt, || {
                pool.install(|| air.fill(&kernel, &monitor))
            })?;
            input::say_light_grid(&grid);
            say_rejected(&gate);
            Some(grid)
        }
    };
    let kernel = Kernel { grid: grid.as_ref(), ..kernel };
    if let Some(at) = args.replay {
        let chosen = points.get(at.texel as usize).filter(|_| (at.page, at.kind) == (0, Kind::Point));
        let Some(point) = chosen else {
            let what = format!("--replay {at}: there is no such sample among {} points", points.len());
            return Err(Error::Usage(what));
        };
        let again = || points::replay(&kernel, *point, at.texel as usize, until, seed, at.sample);
        return Ok(replay::print(at, Some(&pool.install(again)), None));
    }
    let total = match until {
        Until::Samples(n) => u64::from(n) * points.len() as u64,
        Until::Error { .. } => 0,
    };
    // With an error as the target the number of paths is not known, so there is nothing to show.
    let style = if total == 0 { Style::Silent } else { style };
    let (results, gate) = say::watch(style, "points", total, &monitor, interrupt, || {
        pool.install(|| points::gather(&kernel, &points, until, seed, &monitor))
    })?;
    say_rejected(&gate);
    input::say_responses(&tracing);
    let mut missed = 0;
    if let Some(list) = file["points"].as_array_mut() {
        for (entry, r) in list.iter_mut().zip(&results) {
            entry["irradiance"] = json!(r.irradiance.to_array());
            entry["std_err"] = json!(r.std_err.to_array());
            missed += usize::from(!r.reached);
        }
    }
    println!("{file}");
    if 0 < missed {
        say::line(&format!("{missed} point(s) did not reach the error asked for within {MOST} paths"));
        return Ok(ExitCode::from(1));
    }
    Ok(ExitCode::SUCCESS)
}

fn say_rejected(gate: &Gate) {
    if let Some(first) = gate.first {
        let what = format!(
            "was not finite or beyond 1e35, as {} samples in all; they count as black",
            gate.rejected
        );
        let finding = replay::rejection(first, &what, "look for lights or transforms with extreme values");
        say::findings(&[Finding { severity: Severity::Warning, ..finding }], false);
    }
}

fn until(args: &PointsArgs, quality: Quality) -> Result<Until, Error> {
    if let Some(n) = args.samples {
        return Ok(Until::Samples(n));
    }
    let preset = match quality {
        Quality::Draft => 0.01,
        Quality::Medium => 0.003,
        Quality::High => 0.001,
    };
    let relative = args.target_error.unwrap_or(preset);
    if !(0.0 < relative && relative.is_finite()) {
        return Err(Error::Usage(format!(
            "--target-error {relative}: write a positive number such as 0.003"
        )));
    }
    Ok(Until::Error { relative, most: MOST })
}

fn read(path: &Path) -> Result<Value, Error> {
    let text = std::fs::read_to_string(path).map_err(Error::io(path, "cannot read"))?;
    serde_json::from_str(&text).map_err(|e| {
        Finding::error(path.display().to_string(), format!("not JSON: {e}"), "correct the syntax").into()
    })
}

/// Positions and unit normals.
fn parse(file: &Value, path: &Path) -> Result<Vec<(Vec3, Vec3)>, Error> {
    let at = |i: usize, key: &str| format!("{}: points[{i}].{key}", path.display());
    let Some(list) = file.get("points").and_then(Value::as_array) else {
        let shape = r#"write {"points": [{"position": [x, y, z], "normal": [x, y, z]}]}"#;
        return Err(Finding::error(path.display().to_string(), "has no list `points`", shape).into());
    };
    let mut points = Vec::with_capacity(list.len());
    let mut findings = Vec::new();
    for (i, entry) in list.iter().enumerate() {
        let position = vector(&entry["position"]);
        let normal = vector(&entry["normal"]).and_then(Vec3::try_normalize);
        if position.is_none() {
            findings.push(Finding::error(
                at(i, "position"),
                "is not three finite numbers",
                "write [x, y, z] in metres",
            ));
        }
        if normal.is_none() {
            findings.push(Finding::error(
                at(i, "normal"),
                "is not a direction",
                "write [x, y, z] with a length above 0",
            ));
        }
        points.extend(position.zip(normal));
    }
    if findings.is_empty() { Ok(points) } else { Err(Error::Input(findings)) }
}

fn vector(value: &Value) -> Option<Vec3> {
    let list = value.as_array().filter(|l| l.len() == 3)?;
    #[expect(clippy::cast_possible_truncation, reason = "coordinates are f32 here; infinity is refused")]
    let number = |i: usize| list[i].as_f64().map(|x| x as f32);
    Some(Vec3::new(number(0)?, number(1)?, number(2)?)).filter(|v| v.is_finite())
}
