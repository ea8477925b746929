//! `bake plan`.

#![expect(clippy::print_stdout, reason = "the plan is the command's result")]

use crate::cli::args::PlanArgs;
use crate::cli::bake_run::{check_spacing, denoise_seconds, seam_seconds};
use crate::cli::input;
use crate::cli::prepare::{cells, effort, kernel, learn, wanted_probes};
use crate::cli::say::{self, Interrupt, Style};
use crate::error::Error;
use crate::geom::texel::TexelMap;
use crate::plan::settings::Fineness;
use crate::plan::{self, Decision, Effect, Memory, Plan};
use crate::solve::facing::Facing;
use crate::solve::light_grid::Gathering;
use crate::solve::probes::{Probing, Wanted};
use crate::solve::{Monitor, lightmap};
use crate::transport::Kernel;
use crate::transport::cache::IrradianceCache;
use crate::transport::light_grid::LightGrid;
use serde_json::{Value, json};
use std::process::ExitCode;
use std::time::Instant;

pub(crate) fn run(args: &PlanArgs, interrupt: &Interrupt) -> Result<ExitCode, Error> {
    let input = input::load(&args.scene)?;
    say::findings(&input.findings, args.explain);
    plan::admit(&input.findings)?;
    let settings = input::settings(&args.settings, &input.run, (&input.scene, &input.document))?;
    let lights = input::lights(&input);
    let units = input.light_units.name();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(args.work.threads.or(input.run.threads).unwrap_or(0) as usize)
        .build()
        .map_err(|e| Error::Usage(format!("cannot start the threads: {e}")))?;
    let n_loaded = input.findings.len();
    Style::new(args.work.progress).stage("unwrap", &format!("{} surfaces", input.scene.surfaces.len()));
    let plan =
        pool.install(|| plan::make(input.scene, input.findings, settings, &|_, _| !interrupt.raised()))?;
    say::findings(&plan.findings()[n_loaded..], args.explain);
    pool.install(|| check_spacing(&plan))?;
    let cost = pool.install(|| Cost::measure(&plan))?;
    let memory = pool.install(|| plan.memory(&input.document));
    if args.json {
        println!("{:#}", to_json(&plan, &cost, &memory));
        return Ok(ExitCode::SUCCESS);
    }
    print(&plan, &cost, &memory, args.explain, units, &lights);
    Ok(ExitCode::SUCCESS)
}

/// What the bake will take.
struct Cost {
    covered: u64,
    /// `None` where it turns out only while baking.
    paths: Option<u64>,
    seconds: Option<f64>,
    /// Seconds of stages of their own, by the effect that asks for them.
    stages: Vec<(Effect, f64)>,
}

/// Paths in each texel that is timed: enough that what every texel does once weighs little, as in a bake.
const PROBED: u32 = 16;

/// Paths from each node of a light grid that stand for all of them.
const FEW_FROM_NODES: u32 = 4;

impl Cost {
    /// Counts the texels and times a few paths in texels spread over all pages.
    fn measure(plan: &Plan) -> Result<Self, Error> {
        let learnt = learn(plan);
        let kernel = learnt.guide(kernel(plan));
        let (grid, grid_seconds) = Self::light_grid(plan, &learnt.guide_texels(kernel))?;
        let kernel = Kernel { grid: grid.as_ref(), ..kernel };
        let (cache, cache_seconds) = Self::cache(plan, &kernel)?;
        let kernel = Kernel { cache: cache.as_ref(), emitters_apart: true, ..learnt.guide_texels(kernel) };
        let probe_seconds = Self::probes(plan, &kernel)?;
        let (mut covered, mut seconds, mut paths) = (0u64, 0.0, 0u64);
        for page in 0..plan.atlas().pages.len() {
            let map = TexelMap::build(plan.scene(), plan.atlas(), page);
            covered += map.texels.len() as u64;
            let probe = map.thinned(2048);
            // Once to warm the caches, once to measure.
            for measured in [false, true] {
                let monitor = Monitor::default();
                let start = Instant::now();
                lightmap::bake_page(
                    &kernel,
                    plan.atlas(),
                    &probe,
                    page,
                    effort(plan, PROBED, 1),
                    &Facing::default(),
                    &monitor,
                )?;
                if measured {
                    seconds += start.elapsed().as_secs_f64();
                    paths += monitor.paths();
                }
            }
        }
        let paths_per_second = paths.max(1) as f64 / seconds.max(1e-9);
        let all = plan.settings().paths(covered);
        let directional = plan.settings().directional.map_or(0, |n| covered * u64::from(n));
        let stages = vec![
            (Effect::Media, grid_seconds),
            (Effect::Cache, cache_seconds),
            (Effect::Probes, probe_seconds),
            (Effect::Lightmaps, directional as f64 / paths_per_second),
            (Effect::Denoise, denoise_seconds(plan, covered)),
            (Effect::Seams, seam_seconds(plan)),
        ];
        Ok(Self {
            covered,
            paths: all,
            seconds: all.map(|n| grid_seconds + cache_seconds + probe_seconds + n as f64 / paths_per_second),
            stages,
        })
    }

    /// What an effect takes: seconds where it is a stage, else that it is part of sampling, or nothing.
    fn of(&self, decision: &Decision) -> (String, Option<f64>) {
        let stage = self.stages.iter().find(|s| Some(s.0.word()) == decision.effect).map(|s| s.1);
        match stage {
            Some(seconds) if decision.runs && 0.0 < seconds => (say::duration(seconds), Some(seconds)),
            _ if decision.runs => ("in sampling".to_owned(), None),
            _ => ("nothing".to_owned(), Some(0.0)),
        }
    }

    /// A light grid of few paths, and about how long the whole one will take, seconds.
    fn light_grid(plan: &Plan, kernel: &Kernel<'_>) -> Result<(Option<LightGrid>, f64), Error> {
        let settings = plan.settings();
        let Some(all) = settings.light_grid().filter(|_| kernel.media().is_some()) else {
            return Ok((None, 0.0));
        };
        let few = Fineness { paths: all.paths.min(FEW_FROM_NODES), ..all };
        let Some(gathering) = Gathering::new(kernel, few, settings.seed) else { return Ok((None, 0.0)) };
        let start = Instant::now();
        let (grid, _) = gathering.fill(kernel, &Monitor::default())?;
        let seconds = start.elapsed().as_secs_f64();
        Ok((Some(grid), seconds * f64::from(all.paths) / f64::from(few.paths)))
    }

    /// About how long light probes will take, seconds, by few paths from each.
    fn probes(plan: &Plan, kernel: &Kernel<'_>) -> Result<f64, Error> {
        let Some(settings) = plan.settings().probes else { return Ok(0.0) };
        let monitor = Monitor::default();
        let mut seconds = 0.0;
        for wanted in wanted_probes(plan, settings) {
            let start = Instant::now();
            let few = Wanted { samples: FEW_FROM_PROBES.min(wanted.samples), ..wanted };
            let Some(probing) = Probing::new(kernel, few, &monitor)? else { continue };
            seconds += start.elapsed().as_secs_f64();
            let start = Instant::now();
            probing.finish(kernel, &monitor)?;
            let ratio = f64::from(wanted.samples) / f64::from(few.samples);
            seconds += start.elapsed().as_secs_f64() * ratio;
        }
        Ok(seconds)
    }

    /// An irradiance cache of few paths, and about how long the whole one will take, seconds.
    fn cache(plan: &Plan, kernel: &Kernel<'_>) -> Result<(Option<IrradianceCache>, f64), Error> {
        if !plan.settings().caches() {
            return Ok((None, 0.0));
        }
        let cells = cells(plan, kernel);
        let all = cells.paths() as f64;
        let few = cells.with_samples(1);
        let start = Instant::now();
        let (cache, _) = few.fill(kernel, &Monitor::default())?;
        let seconds = start.elapsed().as_secs_f64();
        Ok((Some(cache), seconds * all / few.paths().max(1) as f64))
    }
}

/// See [`Cost::probes`].
const FEW_FROM_PROBES: u32 = 16;

/// A decision as data, with what it takes on this scene and what not running the general kernel saves.
fn decision(decision: &Decision, cost: &Cost) -> Value {
    let mut value = serde_json::to_value(decision).unwrap_or_default();
    value["cost_seconds"] = json!(cost.of(decision).1);
    value["saves_percent"] = json!(decision.saves.map(|s| s.percent()));
    value
}

fn to_json(plan: &Plan, cost: &Cost, memory: &Memory) -> Value {
    json!({
        "effects": plan.effects().iter().map(|d| decision(d, cost)).collect::<Vec<_>>(),
        "settings": plan.settings().to_map(),
        "pages": plan.atlas().pages.iter().map(|p| json!({"width": p.width, "height": p.height})).collect::<Vec<_>>(),
        "texels_per_metre": plan.atlas().texels_per_metre,
        "charts": plan.atlas().charts,
        "utilisation": plan.atlas().utilisation,
        "seams": plan.seams().list.len(),
        "covered_texels": cost.covered,
        "paths": cost.paths,
        "memory": memory,
        "peak_memory_bytes": memory.peak(),
        "sampling_seconds": cost.seconds,
    })
}

/// One line for each effect, and with `explain` one more for why.
fn print_effects(effects: &[Decision], cost: &Cost, explain: bool) {
    println!(
        "effects (saves: what the kernel saves of a bake against the general one, in a scene where sampling is all)"
    );
    println!("  {:<26} {:<18} {:<11} {:>7}  in this scene", "effect", "kernel", "cost", "saves");
    for e in effects {
        let forced = if e.forced { "!" } else { "" };
        let saves = e.saves.map_or_else(|| "-".to_owned(), |s| format!("{:.1} %", s.percent()));
        let kernel = format!("{}{forced}", e.kernel);
        println!("  {:<26} {kernel:<18} {:<11} {saves:>7}  {}", e.name, cost.of(e).0, e.why);
        if explain {
            println!("      {}", e.explanation);
        }
    }
    if effects.iter().any(|e| e.forced) {
        println!("  ! asked for by --force");
    }
}

fn print(plan: &Plan, cost: &Cost, memory: &Memory, explain: bool, units: &str, lights: &str) {
    print_effects(&plan.effects(), cost, explain);
    if !lights.is_empty() {
        print!("lights, read as {units}\n{lights}");
    }
    let atlas = plan.atlas();
    println!("texels");
    println!(
        "  {} covered, {:.3} per metre, {} charts, {} page(s), {:.0} % used",
        cost.covered,
        atlas.texels_per_metre,
        atlas.charts,
        atlas.pages.len(),
        100.0 * atlas.utilisation
    );
    if plan.settings().seams {
        println!("  {} seams between them to stitch", plan.seams().list.len());
    }
    if explain {
        println!("settings");
        for (name, value) in plan.settings().to_map() {
            println!("  {name:<28} {value}");
        }
        let m = memory;
        println!("memory");
        for (what, n) in [
            ("program", m.program),
            ("scene", m.scene),
            ("unwrapping", m.unwrap),
            ("atlas", m.atlas),
            ("rays", m.tracing),
            ("or building their tree", m.build),
            ("finding seams", m.seams),
            ("filling the light grid", m.grid),
            ("finding the irradiance cache", m.cache),
            ("or light probes", m.probes),
            ("or gathering a page", m.gather),
            ("or writing a page", m.write),
            ("or stitching seams", m.stitch),
            ("or writing the scene", m.export),
        ] {
            println!("  {what:<28} {}", say::bytes(n));
        }
    }
    println!("cost");
    println!("  memory {} at the peak", say::bytes(memory.peak()));
    match (cost.paths, cost.seconds) {
        (Some(n), Some(s)) => println!("  {n} paths, about {} of sampling here", say::duration(s)),
        _ => println!("  as many paths as the wanted error or time needs"),
    }
}
