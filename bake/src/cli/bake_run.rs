//! `bake run`.

use crate::cli::args::{RunArgs, SceneArgs};
use crate::cli::frames;
use crate::cli::input::{self, Input};
use crate::cli::prepare::{Merged, Stages, effort, kernel, learn, wanted_probes};
use crate::cli::replay;
use crate::cli::say::{self, Interrupt, Style};
use crate::cli::stopwatch::Stopwatch;
use crate::error::{Error, Finding, Severity};
use crate::geom::texel::TexelMap;
use crate::light::fires::Fires;
use crate::light::hierarchy::shadows::Size;
use crate::output::denoise::{self, DenoiseStats};
use crate::output::folder::Staging;
use crate::output::page::{Page, PageStats};
use crate::output::scene_glb::PageFile;
use crate::output::stitch::{self, Sheet};
use crate::output::{self, assemble, exr, preview, record, scene_glb, texture, view};
use crate::plan::settings::{Denoise, MediaMode, Sampling};
use crate::plan::{self, Plan};
use crate::scene::document::Document;
use crate::scene::model::Camera;
use crate::solve::accumulate::Gate;
use crate::solve::bias::Bias;
use crate::solve::directional::{self, Direction};
use crate::solve::facing::facing;
use crate::solve::light_grid::all_light;
use crate::solve::lightmap::Solution;
use crate::solve::pilot::Learnt;
use crate::solve::probes::{Layout, Probing, Where};
use crate::solve::{Monitor, schedule};
use crate::transport::Kernel;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};
use tables::format::manifest::{Denoised, ErrorFigure, Manifest, Samples, Timings};

pub(crate) fn run(args: &RunArgs, interrupt: &Interrupt) -> Result<ExitCode, Error> {
    match args.frames {
        None => one(args, None, interrupt).map(|(code, _)| code),
        Some(frames) => frames::run(args, frames, interrupt),
    }
}

/// Bakes a scene, or a frame of it into a folder within that of the scene. Returns which.
pub(super) fn one(
    args: &RunArgs,
    frame: Option<u32>,
    interrupt: &Interrupt,
) -> Result<(ExitCode, PathBuf), Error> {
    if args.resume || args.shard.is_some() || args.of.is_some() {
        return Err(Error::Usage(
            "--resume, --shard and --of are reserved: this version bakes in one run".to_owned(),
        ));
    }
    let mut watch = Stopwatch::start();
    let input = match frame {
        None => input::load(&args.scene)?,
        frame => input::load(&SceneArgs { frame, ..args.scene.clone() })?,
    };
    say::findings(&input.findings, false);
    plan::admit(&input.findings)?;
    let settings = input::settings(&args.settings, &input.run, (&input.scene, &input.document))?;
    let mut folder = folder(args, &input);
    if let Some(n) = frame {
        folder.push(frames::folder(n));
    }
    let progress = match (args.work.progress, &input.run.progress) {
        (None, Some(text)) => Some(input::progress(text)?),
        (p, _) => p,
    };
    let style = Style::new(progress);
    let threads = args.work.threads.or(input.run.threads).unwrap_or(0) as usize;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Error::Usage(format!("cannot start {threads} threads: {e}")))?;
    let strict = args.strict || input.run.strict.unwrap_or(false);
    let audit = args.audit.or(input.run.audit).unwrap_or(0);
    if 0 < audit && matches!(settings.sampling, Sampling::Budget(_)) {
        let what = "--audit takes as long as its texels need, and has no share of --time-budget; take --quality, --samples or --target-error";
        return Err(Error::Usage(what.to_owned()));
    }
    let code = pool.install(|| {
        // A replay writes nothing.
        let staging = args.replay.is_none().then(|| Staging::begin(&folder)).transpose()?;
        watch.lap("load");
        style.stage("lights", &light_summary(&input));
        style.stage("unwrap", &format!("{} surfaces", input.scene.surfaces.len()));
        let n_loaded = input.findings.len();
        let goes_on = |_, _| !interrupt.raised();
        let plan = plan::make(input.scene, input.findings, settings, &goes_on)?;
        say::findings(&plan.findings()[n_loaded..], false);
        watch.lap("unwrap");
        interrupt.check()?;
        check_spacing(&plan)?;
        let (Some(staging), None) = (staging, args.replay) else {
            let monitor = Monitor::default();
            let stages = Stages { plan: &plan, style, interrupt, monitor: &monitor };
            return args.replay.map_or(Ok(ExitCode::SUCCESS), |at| replay::run(stages, at));
        };
        let memory = plan.memory(&input.document).peak();
        let exposure = args.exposure;
        let mut job =
            Job { plan: &plan, staging: &staging, style, interrupt, strict, audit, exposure, watch, memory };
        let baked = job.pages()?;
        interrupt.check()?;
        let (exposure, camera) = job.scene(&input.document, &baked)?;
        let mut watch = job.watch;
        let mut manifest = record::manifest(&plan, &input.document.inputs(), &baked.figures, &baked.gate);
        manifest.exposure = Some(exposure);
        manifest.camera = Some(record::camera(&camera));
        let in_air = baked.light_grid.iter().map(|g| g.clamped);
        let in_air = in_air.chain(baked.probes.iter().map(|p| p.grid.clamped));
        let in_air = in_air.chain(baked.media.iter().filter_map(|m| m.texture.as_ref()).map(|t| t.clamped));
        manifest.counts.half_overflows += in_air.sum::<u64>() + baked.sky_clamped;
        manifest.counts.rejected_samples += baked.probes.iter().map(|p| p.rejected_samples).sum::<u64>();
        manifest.light_grid = baked.light_grid;
        manifest.media = baked.media;
        manifest.probes = baked.probes;
        manifest.seams = plan.settings().seams.then(|| baked.seams.manifest());
        manifest.bias = baked.bias.figures().map(record::bias);
        let (error, denoised) = (manifest.error, manifest.denoised);
        let closing = closing(&manifest, plan.settings().caches(), &baked.halving);
        watch.lap("write");
        interrupt.check()?;
        let timings =
            watch.timings(baked.monitor.rays(), baked.monitor.paths(), rayon::current_num_threads());
        staging.commit(manifest, &timings)?;
        input::say_responses(plan.tracing());
        for (name, text) in closing {
            style.stage(name, &text);
        }
        style.stage("time", &stages(&timings));
        style.stage("done", &summary(&folder, &plan, (&error, denoised), &timings));
        if let (Sampling::Target(wanted), Some(reached)) = (&plan.settings().sampling, error.relative)
            && f64::from(*wanted) < reached
        {
            say::line(&format!(
                "error {:.2} % missed the {:.2} % asked for",
                100.0 * reached,
                100.0 * wanted
            ));
            return Ok(ExitCode::from(1));
        }
        let took = timings.stages.iter().map(|s| s.wall_seconds).sum::<f64>();
        if let Sampling::Budget(seconds) = plan.settings().sampling
            && LATE * seconds < took
        {
            let what = format!("the bake took {} instead of {}", say::duration(took), say::duration(seconds));
            let fix = "give it more time, or fewer texels: each takes at least 2 paths, or 8 on small pages";
            say::findings(&[Finding::warning("--time-budget", what, fix)], false);
        }
        Ok(ExitCode::SUCCESS)
    })?;
    Ok((code, folder))
}

fn folder(args: &RunArgs, input: &Input) -> PathBuf {
    match (&args.output, &input.run.output) {
        (Some(dir), _) => dir.clone(),
        (None, Some(dir)) => PathBuf::from(dir),
        (None, None) => PathBuf::from(format!("{}.bake", input.document.name())),
    }
}

fn light_summary(input: &Input) -> String {
    let n = input.scene.lights.len();
    format!("{n} read as {}\n{}", input.light_units.name(), input::lights(input)).trim_end().to_owned()
}

fn summary(
    folder: &Path,
    plan: &Plan,
    (error, denoised): (&ErrorFigure, Option<Denoised>),
    timings: &Timings,
) -> String {
    let pages = plan.atlas().pages.len();
    let mut error =
        error.relative.map_or_else(|| "black".to_owned(), |r| format!("error {:.2} %", 100.0 * r));
    if let Some(left) = denoised.and_then(|d| d.relative) {
        error += &format!(", about {:.2} % denoised", 100.0 * left);
    }
    format!(
        "{} ({pages} page{}, {error}, {}, peak {})",
        folder.display(),
        if pages == 1 { "" } else { "s" },
        say::duration(timings.wall_seconds),
        say::bytes(timings.peak_memory_bytes),
    )
}

/// How the error falls with samples, and what they took.
#[derive(Clone, Copy, Debug, Default)]
struct Halving {
    /// Seconds of sampling by the clock.
    seconds: f64,
    /// Power with which the error falls, weighed by seconds.
    weighed: f64,
}

/// Power with which errors of independent samples fall.
const INDEPENDENT: f64 = 0.5;

/// Errors that fall faster than this are not believed to go on like that.
const FASTEST: f64 = 0.75;

impl Halving {
    fn add(&mut self, seconds: f64, solution: &Solution) {
        self.seconds += seconds;
        self.weighed += seconds * power(&solution.curve);
    }

    /// Seconds of sampling beyond those spent until the error is half as large.
    fn more(&self) -> Option<f64> {
        let power = self.weighed / self.seconds;
        (power.is_finite() && 0.0 < power).then(|| self.seconds * (2.0f64.powf(power.recip()) - 1.0))
    }
}

/// Power with which the error fell over the last doubling of samples; that of independent ones where fewer than three doublings are known, because the first
/// rounds also gain by going where the variance is.
fn power(curve: &[(f64, f64)]) -> f64 {
    let (Some(&(first, _)), Some(&(spent, error))) = (curve.first(), curve.last()) else {
        return INDEPENDENT;
    };
    let before = curve.iter().rev().find(|(s, _)| 1.9 * s <= spent).filter(|_| 8.0 * first <= spent);
    let fell = before.map(|&(s, e)| (e / error).ln() / (spent / s).ln());
    fell.filter(|p| p.is_finite()).map_or(INDEPENDENT, |p| p.clamp(INDEPENDENT, FASTEST))
}

/// What a bake says of its error: how large, noise and bias, and what half of it would take.
fn closing(manifest: &Manifest, cached: bool, halving: &Halving) -> Vec<(&'static str, String)> {
    let mut out = Vec::new();
    let Some(relative) = manifest.error.relative else { return out };
    let percent = |x: f64| format!("{:.2} %", 100.0 * x);
    let audited = manifest.pages.iter().any(|p| p.audit.is_some());
    let mut text = format!("noise {} of the mean", percent(relative));
    text += if audited { ", intervals checked by an audit" } else { ", too few lit texels for an audit" };
    // Each page's mean may be off; together they are as their texels.
    let (mut off, mut variance, mut light) = (0.0, 0.0, 0.0);
    for page in &manifest.pages {
        let n = page.covered_texels as f64;
        light += n * page.mean_luminance;
        if let Some(a) = &page.audit {
            off += n * a.bias;
            variance += (n * a.bias_std_err).powi(2);
        }
    }
    if audited && cached && 0.0 < light {
        let (off, error) = (100.0 * off / light, 100.0 * variance.sqrt() / light);
        text += &format!("; the irradiance cache changes the mean by {off:+.2} +- {error:.2} %");
    }
    out.push(("error", text));
    if let Some(b) = &manifest.bias {
        let text = format!(
            "{:+.2} +- {:.2} % of the mean, {} root mean square beyond noise, at most about {}, at {} texels gathered without approximations",
            100.0 * b.mean,
            100.0 * b.mean_std_err,
            percent(b.rms),
            percent(b.rms_at_most),
            b.texels
        );
        out.push(("bias", text));
    }
    if let Some(more) = halving.more() {
        let half = rounded(0.5 * relative);
        out.push(("next", format!("--target-error {half} would take about {} more", say::duration(more))));
    }
    out
}

/// With two significant digits, cut off.
fn rounded(x: f64) -> String {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates, and is limited")]
    let digits = ((1.0 - x.log10().floor()) as usize).min(12);
    let scale = 10f64.powf(digits as f64);
    format!("{:.digits$}", (x * scale).floor() / scale)
}

/// Seconds of stages by the clock, the longest first; those that take less than a hundredth are left out.
fn stages(timings: &Timings) -> String {
    let mut list: Vec<_> =
        timings.stages.iter().filter(|s| 0.01 * timings.wall_seconds <= s.wall_seconds).collect();
    list.sort_by(|a, b| b.wall_seconds.total_cmp(&a.wall_seconds));
    let each = |s: &&tables::format::manifest::Stage| format!("{} {}", s.name, say::duration(s.wall_seconds));
    list.iter().map(each).collect::<Vec<_>>().join(", ")
}

/// A bake under way.
struct Job<'a> {
    plan: &'a Plan,
    staging: &'a Staging,
    style: Style,
    interrupt: &'a Interrupt,
    strict: bool,
    /// Texels that are gathered again without approximations.
    audit: u32,
    /// Of pictures, if it was given.
    exposure: Option<f32>,
    watch: Stopwatch,
    /// Bytes expected at the peak.
    memory: u64,
}

/// What the pages left behind.
struct Baked {
    /// Radiance and coverage only.
    pages: Vec<Page>,
    figures: Vec<record::PageFigures>,
    gate: Gate,
    monitor: Monitor,
    light_grid: Option<tables::format::manifest::LightGrid>,
    media: Vec<tables::format::manifest::Medium>,
    /// Values of the sky's image that half floats cannot hold.
    sky_clamped: u64,
    probes: Vec<tables::format::manifest::Probes>,
    seams: stitch::Figures,
    bias: Bias,
    halving: Halving,
}

impl Job<'_> {
    fn pages(&mut self) -> Result<Baked, Error> {
        let mut baked = Baked {
            pages: Vec::new(),
            figures: Vec::new(),
            gate: Gate::default(),
            monitor: Monitor::new(self.strict),
            light_grid: None,
            media: Vec::new(),
            sky_clamped: 0,
            probes: Vec::new(),
            seams: stitch::Figures::default(),
            bias: Bias::default(),
            halving: Halving::default(),
        };
        match self.bake(&mut baked) {
            Ok(()) => Ok(baked),
            // The first bad sample stopped the work, and nobody else did.
            Err(Error::Interrupted) if !self.interrupt.raised() => {
                Err(baked.monitor.rejected().map_or(Error::Interrupted, |first| {
                    let what = "was not finite or beyond 1e35, and --strict was asked for";
                    replay::rejection(first, what, EXTREME).into()
                }))
            }
            Err(e) => Err(e),
        }
    }

    fn bake(&mut self, baked: &mut Baked) -> Result<(), Error> {
        let atlas = self.plan.atlas();
        let settings = self.plan.settings();
        self.style.stage("plan", &announce(self.plan, self.memory));
        if let Some(fires) = self.plan.tracing().fires.as_ref().filter(|f| !f.waits()) {
            self.stages(&baked.monitor).fill(fires)?;
            self.style.stage("fire", &levels(fires));
            self.watch.lap("fire");
        }
        let learnt = learn(self.plan);
        let kernel = learnt.guide(kernel(self.plan));
        self.watch.lap("pilot");
        let (grid, gate) = self.stages(&baked.monitor).light_grid(&learnt.guide_texels(kernel))?;
        admit(&gate);
        baked.gate = baked.gate.merge(gate);
        let kernel = Kernel { grid: grid.as_ref(), ..kernel };
        if let Some(grid) = &grid {
            let light = all_light(&kernel, grid, settings.seed);
            let origin = self.plan.tracing().world.origin;
            baked.light_grid = Some(output::light_grid::write(self.staging, grid, origin, light)?);
        }
        self.watch.lap("light grid");
        let merged = self.stages(&baked.monitor).merge(&kernel)?;
        let kernel = Merged::kernel(merged.as_ref(), kernel);
        if let Some(m) = &merged {
            self.style.stage("fire", &levels(&m.fires));
            self.watch.lap("fire");
        }
        baked.media = output::media::write(self.plan, self.staging)?;
        for texture in baked.media.iter().filter_map(|m| m.texture.as_ref()) {
            say_clamped(&texture.file, texture.clamped, "densities", "lower the density and raise sigma");
        }
        baked.sky_clamped = output::sky::write(self.staging, &self.plan.scene().sky)?;
        say_clamped(output::sky::FILE, baked.sky_clamped, "values", "lower the scale of the sky");
        self.watch.lap("media and sky");
        let (cache, gate) = self.stages(&baked.monitor).cache(&kernel)?;
        admit(&gate);
        baked.gate = baked.gate.merge(gate);
        // Whether no light at all reaches a side is a question to paths alone.
        let unbiased = kernel;
        let kernel = Kernel { cache: cache.as_ref(), emitters_apart: true, ..learnt.guide_texels(kernel) };
        self.watch.lap("cache");
        baked.probes = self.probes(&kernel, &baked.monitor)?;
        self.watch.lap("probes");
        let luminance = match settings.sampling {
            Sampling::Target(_) => {
                let effort = effort(self.plan, 0, settings.seed);
                say::watch(self.style, "mean luminance", 0, &baked.monitor, self.interrupt, || {
                    schedule::mean_luminance(&kernel, atlas, effort, &baked.monitor)
                })?
            }
            _ => None,
        };
        self.watch.lap("pilot");
        // Pages whose seams lead to each other wait for the last of them.
        let together = self.plan.seams().join_pages(&self.plan.tracing().world, atlas);
        let mut waiting = Vec::new();
        for number in 0..atlas.pages.len() {
            let map = TexelMap::build(self.plan.scene(), atlas, number);
            self.watch.lap("texels");
            let total = settings.paths(map.texels.len() as u64).unwrap_or(0);
            let deadline = self.deadline(number);
            let name = format!("page {} of {}", number + 1, atlas.pages.len());
            let mut solution = say::watch(self.style, &name, total, &baked.monitor, self.interrupt, || {
                let effort = effort(self.plan, settings.samples, settings.seed);
                let facing = facing(&unbiased, atlas, &map, number, effort, &baked.monitor);
                self.watch.lap("facing");
                let task = schedule::Task {
                    kernel: &kernel,
                    unbiased: &unbiased,
                    atlas,
                    map: &map,
                    page: number,
                    effort,
                    facing: &facing,
                    luminance,
                    deadline,
                    figure: &|map, solution| {
                        let stats = assemble::figure(self.plan, map, solution);
                        (stats.error().rms_std_err, stats.mean_luminance())
                    },
                };
                task.solve(&settings.sampling, &baked.monitor)
            })?;
            let seconds = self.watch.lap("sample");
            if solution.uncached {
                let what = "the irradiance cache is off by more than the error that is asked for: gathered without it";
                let fix = "--irradiance-cache off saves the first attempt, and replays this page's samples";
                say::findings(&[Finding::warning(format!("page {number}"), what, fix)], false);
            }
            baked.halving.add(seconds, &solution);
            self.bias(baked, &learnt, &map, number, &solution)?;
            let directions = self.directions(&kernel, &map, number, &mut solution, &baked.monitor)?;
            admit(&solution.gate);
            baked.gate = baked.gate.merge(solution.gate);
            let (total, min, max) = solution.paths();
            let mean = total as f64 / solution.texels.len().max(1) as f64;
            let samples = Samples { total, min, mean, max };
            let (rounds, audit, squares) =
                (solution.rounds.clone(), solution.audit.clone(), solution.squares());
            let uncached = solution.uncached;
            let clean = say::watch(self.style, "denoising", 0, &baked.monitor, self.interrupt, || {
                denoise::denoise(self.plan, &map, &solution, &baked.monitor)
            })?;
            self.watch.lap("denoise");
            let (sheet, filled) = assemble::page(self.plan, map, solution, clean, directions);
            let (stats, denoised) =
                (PageStats::of(&sheet.page).with_squares(squares), DenoiseStats::of(&sheet.page));
            baked.figures.push(record::PageFigures {
                stats,
                denoised,
                filled,
                samples,
                rounds,
                uncached,
                audit,
                texture: None,
                directions: None,
            });
            self.watch.lap("write");
            waiting.push(sheet);
            if !together || number + 1 == atlas.pages.len() {
                self.finish(baked, &mut waiting)?;
            }
            self.interrupt.check()?;
        }
        Ok(())
    }

    fn stages<'b>(&'b self, monitor: &'b Monitor) -> Stages<'b> {
        Stages { plan: self.plan, style: self.style, interrupt: self.interrupt, monitor }
    }

    /// Gathers some texels of a page again, without approximations, if that is asked for.
    fn bias(
        &mut self,
        baked: &mut Baked,
        learnt: &Learnt,
        map: &TexelMap,
        page: usize,
        solution: &Solution,
    ) -> Result<(), Error> {
        if self.audit == 0 {
            return Ok(());
        }
        let plan = self.plan;
        let unbiased = learnt.guide(Kernel::new(plan.scene(), plan.tracing(), None, MediaMode::Reference));
        let area = |p: &crate::geom::atlas::Page| f64::from(p.width) * f64::from(p.height);
        let pages = &plan.atlas().pages;
        let part = area(&pages[page]) / pages.iter().map(area).sum::<f64>();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a part of a number of texels"
        )]
        let n = (f64::from(self.audit) * part).ceil() as usize;
        let amount = (n, plan.settings().seed);
        let found = say::watch(self.style, "unbiased texels", 0, &baked.monitor, self.interrupt, || {
            Bias::of_page(&unbiased, map, page, amount, solution, &baked.monitor)
        })?;
        baked.bias = std::mem::take(&mut baked.bias).merge(found);
        self.watch.lap("audit");
        Ok(())
    }

    /// Gathers where light comes from if the plan wants it.
    fn directions(
        &mut self,
        kernel: &Kernel<'_>,
        map: &TexelMap,
        page: usize,
        solution: &mut Solution,
        monitor: &Monitor,
    ) -> Result<Option<Vec<Direction>>, Error> {
        let Some(samples) = self.plan.settings().directional else { return Ok(None) };
        let paths = map.texels.len() as u64 * u64::from(samples);
        let seed = self.plan.settings().seed;
        let found = say::watch(self.style, "directions", paths, monitor, self.interrupt, || {
            directional::gather(kernel, map, page, (samples, seed), solution, monitor)
        })?;
        self.watch.lap("directions");
        Ok(Some(found))
    }

    /// Writes the texture of a page if one is wanted, and says what it cannot hold.
    fn texture(&self, number: usize, page: &Page) -> Result<Option<texture::Figures>, Error> {
        let settings = self.plan.settings();
        let Some(format) = settings.texture else { return Ok(None) };
        let name = record::texture_file(number);
        let figures = texture::write_page(&self.staging.path(&name), page, settings.padding, format)?;
        if 0 < figures.overflows {
            let what = format!(
                "{} values exceed 65504 nits, the greatest half float, and are clamped",
                figures.overflows
            );
            let fix = "dim the lights and raise the exposure in the engine, or take the EXR";
            say::findings(&[Finding::warning(name, what, fix)], false);
        }
        Ok(Some(figures))
    }

    /// Stitches the pages that wait, which follow the finished ones, and writes them.
    fn finish(&mut self, baked: &mut Baked, waiting: &mut Vec<Sheet>) -> Result<(), Error> {
        let figures = stitch::stitch(self.plan, baked.pages.len(), waiting);
        baked.seams = baked.seams.merge(figures);
        self.watch.lap("stitch");
        for Sheet { mut page, .. } in waiting.drain(..) {
            let number = baked.pages.len();
            exr::write_page(&self.staging.path(&record::page_file(number)), &page)?;
            // A PNG is packed by one thread.
            let pictures = [record::preview_file(number), record::error_file(number)]
                .map(|name| self.staging.path(&name));
            let (shown, error) = rayon::join(
                || preview::write_page(&pictures[0], &page, self.exposure),
                || preview::write_error(&pictures[1], &page),
            );
            shown.and(error)?;
            baked.figures[number].texture = self.texture(number, &page)?;
            baked.figures[number].directions = self.direction_texture(number, &page)?;
            page.keep_radiance();
            baked.pages.push(page);
        }
        self.watch.lap("write");
        Ok(())
    }

    /// Writes the directions of a page as a texture if textures are wanted and it has them.
    fn direction_texture(&self, number: usize, page: &Page) -> Result<Option<texture::Figures>, Error> {
        let settings = self.plan.settings();
        if settings.texture.is_none() {
            return Ok(None);
        }
        let path = self.staging.path(&record::directions_file(number));
        texture::write_directions(&path, page, settings.padding)
    }

    /// When sampling of a page has to end: its share of what a time budget leaves beside what comes after.
    fn deadline(&self, page: usize) -> Instant {
        let now = Instant::now();
        let Sampling::Budget(seconds) = self.plan.settings().sampling else { return now };
        let end = self.watch.begin() + Duration::from_secs_f64(seconds);
        let area = |p: &crate::geom::atlas::Page| f64::from(p.width) * f64::from(p.height);
        let rest = &self.plan.atlas().pages[page..];
        let all: f64 = rest.iter().map(area).sum();
        let denoise = denoise_seconds(self.plan, 1);
        let after = PICTURE_SECONDS + (WRITE_SECONDS + denoise) * all + seam_seconds(self.plan);
        let after = Duration::from_secs_f64(after);
        let left = end.saturating_duration_since(now).saturating_sub(after);
        now + left.mul_f64(area(&rest[0]) / all.max(1.0))
    }

    /// Gathers and writes light probes if the plan wants them.
    fn probes(
        &self,
        kernel: &Kernel<'_>,
        monitor: &Monitor,
    ) -> Result<Vec<tables::format::manifest::Probes>, Error> {
        let Some(settings) = self.plan.settings().probes else { return Ok(Vec::new()) };
        if self.plan.scene().probe_boxes.is_some() && settings.spacing.is_some() {
            let what = "--probe-spacing counts for nothing: the scene says where probes are";
            let fix = "write the spacing of each box, or remove `probes` from the scene";
            say::findings(&[Finding::warning("probes", what, fix)], false);
        }
        let mut written = Vec::new();
        for (number, wanted) in wanted_probes(self.plan, settings).into_iter().enumerate() {
            let probing = say::watch(self.style, "places of probes", 0, monitor, self.interrupt, || {
                Probing::new(kernel, wanted, monitor)
            })?;
            // Boxes were judged when they were read, distances by `check_spacing`.
            let Some(probing) = probing else { continue };
            let paths = probing.paths();
            let (volume, figures) = say::watch(self.style, "probes", paths, monitor, self.interrupt, || {
                probing.finish(kernel, monitor)
            })?;
            admit(&figures.gate);
            written.push(output::probes::write(self.staging, number, &volume, &figures, wanted.samples)?);
        }
        Ok(written)
    }

    /// Writes the scene and its picture, and says how and from where that was taken.
    fn scene(&mut self, document: &Document, baked: &Baked) -> Result<(f32, Camera), Error> {
        let plan = self.plan;
        let textures = plan.settings().texture.is_some();
        let file =
            |n| PageFile { exr: record::page_file(n), texture: textures.then(|| record::texture_file(n)) };
        let files: Vec<PageFile> = (0..plan.atlas().pages.len()).map(file).collect();
        let path = self.staging.path("scene.glb");
        say::findings(&scene_glb::write(&path, document, plan.scene(), plan.atlas(), &files)?, false);
        let kernel = kernel(plan);
        let camera = view::camera(plan, &kernel);
        let picture = view::draw(plan, &kernel, &baked.pages, &camera);
        let exposure =
            self.exposure.unwrap_or_else(|| preview::auto_exposure(picture.pixels.iter().copied()));
        preview::write_image(
            &self.staging.path("preview.png"),
            picture.width,
            picture.height,
            &picture.pixels,
            exposure,
        )?;
        self.watch.lap("preview");
        Ok((exposure, camera))
    }
}

/// Says that values of a file were too great for half floats, if there are any.
fn say_clamped(file: &str, clamped: u64, what: &str, fix: &str) {
    if 0 < clamped {
        let what = format!("{clamped} {what} exceed 65504, the greatest half float, and are clamped");
        say::findings(&[Finding::warning(file, what, fix)], false);
    }
}

/// Reports samples that were not finite. With `--strict` the first of them has ended the bake before.
fn admit(gate: &Gate) {
    let Some(first) = gate.first else { return };
    let what =
        format!("was not finite or beyond 1e35, as {} samples in all; they count as black", gate.rejected);
    let fix = format!("{EXTREME}, --strict makes this an error");
    let finding = replay::rejection(first, &what, &fix);
    say::findings(&[Finding { severity: Severity::Warning, ..finding }], false);
}

/// What helps against samples that are not finite.
const EXTREME: &str = "look for lights or transforms with extreme values";

/// A bake that takes so many times its budget says so.
const LATE: f64 = 1.1;

/// What a time budget keeps for the preview picture, seconds; measured 0.5 to 1 on two cores.
const PICTURE_SECONDS: f64 = 0.8;

/// What a time budget keeps for writing a texel of a page, seconds; measured 0.4 to 0.8 microseconds, and 0.2 to 0.5 more for a texture.
const WRITE_SECONDS: f64 = 1e-6;

/// What a time budget keeps for denoising a texel of a page, processor seconds, `draft` and `final`; measured 27 and 94 microseconds a
/// covered texel of the hall.
const DENOISE_SECONDS: [f64; 2] = [3e-5, 1e-4];

/// What a time budget keeps for a place on a seam, seconds; measured 4 to 7 microseconds on two cores.
const PLACE_SECONDS: f64 = 1e-5;

/// About how long denoising takes for so many covered texels.
pub(crate) fn denoise_seconds(plan: &Plan, texels: u64) -> f64 {
    let seconds = match plan.settings().denoise {
        Denoise::Off => 0.0,
        Denoise::Draft => DENOISE_SECONDS[0],
        Denoise::Final => DENOISE_SECONDS[1],
    };
    texels as f64 * seconds / rayon::current_num_threads() as f64
}

/// About how long stitching takes.
pub(crate) fn seam_seconds(plan: &Plan) -> f64 {
    let places: u64 = plan.seams().places(&plan.tracing().world, plan.atlas()).iter().sum();
    PLACE_SECONDS * places as f64
}

/// Whether the distance of probes that is asked for suits the scene's size.
///
/// # Errors
/// [`Error::Usage`] if no lattice fits.
pub(crate) fn check_spacing(plan: &Plan) -> Result<(), Error> {
    for wanted in plan.settings().probes.into_iter().flat_map(|settings| wanted_probes(plan, settings)) {
        if let Where::Spaced(spacing) = wanted.place
            && Layout::new(&plan.tracing().world, wanted.place).is_none()
        {
            return Err(Error::Usage(format!(
                "--probe-spacing {spacing}: no lattice of up to 4194304 probes fits the scene with it; write a distance that suits the scene's size, or --probe-count"
            )));
        }
    }
    Ok(())
}

/// Lights of each level of a hierarchy, with what their shadows take.
fn levels(fires: &Fires) -> String {
    let each = |(l, s): (usize, &Size)| {
        let shadows = if s.bytes == 0 {
            String::new()
        } else {
            format!(", {} texels of {} bytes each, {}", s.texels, s.texel_bytes, say::bytes(s.bytes))
        };
        format!("level {l}: {} lights{shadows}", s.lights)
    };
    fires.sizes().iter().enumerate().map(each).collect::<Vec<_>>().join("\n")
}

fn amount(sampling: &Sampling) -> String {
    match sampling {
        Sampling::Exact(n) => format!("{n} paths per texel"),
        Sampling::Mean(n) => format!("{n} paths per texel on average"),
        Sampling::Rounds(_) => "paths by rounds".to_owned(),
        Sampling::Target(x) => format!("paths until the error is {:.2} %", 100.0 * x),
        Sampling::Budget(s) => format!("paths for {} in all", say::duration(*s)),
    }
}

fn announce(plan: &Plan, memory: u64) -> String {
    let atlas = plan.atlas();
    let sizes: Vec<String> =
        atlas.pages.iter().take(4).map(|p| format!("{} x {}", p.width, p.height)).collect();
    let more = if 4 < atlas.pages.len() { ", ..." } else { "" };
    format!(
        "{:.3} texels/m, {} charts on {} page(s) of {}{more}, {}, memory {}",
        atlas.texels_per_metre,
        atlas.charts,
        atlas.pages.len(),
        sizes.join(", "),
        amount(&plan.settings().sampling),
        say::bytes(memory),
    )
}
