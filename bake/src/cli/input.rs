//! Reads scene and configuration and resolves settings.

use crate::cli::args::{
    BlendArg, BuildArg, DenoiseArg, DirectArg, FireArg, GridArgs, LightUnitsArg, MediaArg, OnOff, ProbeArgs,
    ProbesArg, QualityArg, SceneArgs, SettingsArgs, TextureArg, TuningArgs, UnwrapArg,
};
use crate::cli::say;
use crate::error::{Error, Finding};
use crate::geom::atlas::{Engine, Unwrap};
use crate::light::Direct;
use crate::light::fires::FireOptions;
use crate::light::hierarchy::{Blend, Build};
use crate::plan::settings::{Denoise, Fineness, FireBy, Probes, Sampling, TextureFormat};
use crate::plan::{Effect, Force, MediaMode, Quality, Settings, Tracing, Tuning};
use crate::scene::config::{Config, RunConfig};
use crate::scene::document::Document;
use crate::scene::gltf::{self, LightUnits, LoadOptions};
use crate::scene::model::{LightKind, Medium, Scene};
use crate::scene::sky::parse_sky_with_input;
use crate::transport::light_grid::LightGrid;
use clap::ValueEnum;
use std::fmt::Write as _;
use std::path::Path;
use tables::probes::Basis;

/// The scene that is baked where none is named.
pub(crate) const HALL: &[u8] = include_bytes!("../../../data/hall.glb");

/// Everything read from files, with findings.
pub(crate) struct Input {
    pub(crate) document: Document,
    pub(crate) scene: Scene,
    pub(crate) findings: Vec<Finding>,
    pub(crate) run: RunConfig,
    pub(crate) light_units: LightUnits,
}

/// Reads the scene; findings may hold errors.
///
/// # Errors
///
/// If a file cannot be read at all.
pub(crate) fn load(args: &SceneArgs) -> Result<Input, Error> {
    let (config, mut findings) = match &args.config {
        Some(path) => Config::open(path, args.frame)?,
        None => (Config::default(), Vec::new()),
    };
    let document = match &args.scene {
        Some(path) => Document::open(path)?,
        None => Document::from_bytes("hall", HALL, None)?,
    };
    // Paths on the command line belong to the working directory, those in a file to its folder.
    let sky = match (&args.sky, &config.run.sky) {
        (Some(text), _) => Some(parse_sky_with_input(text, Path::new(""))?),
        (None, Some(text)) => {
            let dir = args.config.as_deref().and_then(Path::parent).unwrap_or(Path::new(""));
            Some(parse_sky_with_input(text, dir)?)
        }
        (None, None) => None,
    };
    let sky = sky.map(|(sky, file)| {
        file.into_iter().for_each(|f| document.add_input(f));
        sky
    });
    let light_units = match (args.light_units, &config.run.light_units) {
        (Some(units), _) => units,
        (None, Some(text)) => word(text, "run.light_units")?,
        (None, None) => LightUnitsArg::Gltf,
    };
    let light_units = match light_units {
        LightUnitsArg::Gltf => LightUnits::Gltf,
        LightUnitsArg::BlenderRaw => LightUnits::BlenderRaw,
        LightUnitsArg::BlenderUnitless => LightUnits::BlenderUnitless,
    };
    let (scene, more) = gltf::load(&document, &config, &LoadOptions { light_units, sky, frame: args.frame });
    findings.extend(more);
    findings.extend(crate::media::findings(&scene));
    findings.sort_by_key(|f| std::cmp::Reverse(f.severity));
    Ok(Input { document, scene, findings, run: config.run, light_units })
}

/// A word of the configuration file that is also one of the command line.
pub(crate) fn word<T: ValueEnum>(text: &str, path: &str) -> Result<T, Error> {
    T::from_str(text, false).map_err(|_| {
        let known: Vec<String> = T::value_variants()
            .iter()
            .filter_map(|v| v.to_possible_value().map(|p| p.get_name().to_owned()))
            .collect();
        Finding::error(path, format!("unknown value `{text}`"), format!("write one of {}", known.join(", ")))
            .into()
    })
}

/// What becomes of media: by the command line, else the configuration file, else they are simulated between walls.
///
/// # Errors
///
/// If the file's word is not known, or there are media and the program has no feature `media`.
pub(crate) fn media(
    arg: Option<MediaArg>,
    run: &RunConfig,
    force: &Force,
    scene: &Scene,
) -> Result<MediaMode, Error> {
    if force.word(Effect::Media) == Some("none") {
        return Ok(MediaMode::Off);
    }
    let arg = match (arg, &run.media) {
        (None, Some(text)) => Some(word(text, "run.media")?),
        (given, _) => given,
    };
    let beyond = |m: &&Medium| crate::media::MOST_G < m.g.abs();
    if let (Some(MediaArg::Table), Some(medium)) = (arg, scene.media.iter().find(beyond)) {
        say::line(&format!(
            "warning: {}: g is {}, and tables end at {}; --media table takes it as that",
            medium.path,
            medium.g,
            crate::media::MOST_G
        ));
    }
    let arg = arg.unwrap_or(MediaArg::Bounded);
    if cfg!(not(feature = "media"))
        && arg != MediaArg::Off
        && let Some(medium) = scene.media.first()
    {
        return Err(Finding::error(
            &medium.path,
            "a medium, and this program was built without the feature `media`",
            "take --media off, or build it with its default features",
        )
        .into());
    }
    Ok(match arg {
        MediaArg::Off => MediaMode::Off,
        MediaArg::Attenuate => MediaMode::Attenuate,
        MediaArg::Table => MediaMode::Table,
        MediaArg::Bounded => MediaMode::Bounded,
        MediaArg::Reference => MediaMode::Reference,
    })
}

/// Kernels that are asked for by name: on the command line, which stands above the configuration file.
///
/// # Errors
///
/// If a word is not known.
pub(crate) fn force(args: &[String], run: &RunConfig) -> Result<Force, Error> {
    Force::parse(run.force.iter().chain(args).map(String::as_str))
}

/// How direct light is sampled: by the command line, else the configuration file.
///
/// # Errors
///
/// If the file's word is not known.
pub(crate) fn direct(arg: Option<DirectArg>, run: &RunConfig) -> Result<Direct, Error> {
    let arg = match (arg, &run.direct) {
        (None, Some(text)) => word(text, "run.direct")?,
        (given, _) => given.unwrap_or(DirectArg::Auto),
    };
    Ok(match arg {
        DirectArg::Auto => Direct::Auto,
        DirectArg::All => Direct::All,
        DirectArg::Lightcuts => Direct::Lightcuts,
        DirectArg::Grid => Direct::Grid,
        DirectArg::Published => Direct::Published,
        #[cfg(feature = "comparison")]
        DirectArg::Intensity => Direct::Intensity,
        #[cfg(feature = "comparison")]
        DirectArg::Splitting => Direct::Splitting,
    })
}

/// How lights and tables are looked up: by the command line, else as usual. A file of tables is noted among the inputs.
///
/// # Errors
///
/// If the file cannot be read, and for options of tables that nobody looks into.
pub(crate) fn tuning(
    args: &TuningArgs,
    (media, direct): (MediaMode, Direct),
    document: &Document,
) -> Result<Tuning, Error> {
    let usual = Tuning::default();
    if direct == Direct::Grid && media == MediaMode::Table {
        let what = "--direct grid is for --media bounded, attenuate, reference and off: tables have to know each lamp; take --direct auto";
        return Err(Error::Usage(what.to_owned()));
    }
    if args.direct_alpha.is_some() && direct != Direct::Grid {
        return Err(Error::Usage("--direct-alpha is for --direct grid".to_owned()));
    }
    if (args.tables.is_some() || args.zh_order.is_some()) && media != MediaMode::Table {
        let what = "--tables and --zh-order are for --media table, which alone looks into response tables";
        return Err(Error::Usage(what.to_owned()));
    }
    if let Some(path) = &args.tables {
        let bytes = std::fs::read(path).map_err(Error::io(path, "cannot read"))?;
        document.note_input(&path.to_string_lossy(), &bytes);
    }
    let many = matches!(media, MediaMode::Attenuate | MediaMode::Bounded);
    if args.fire == Some(FireArg::Grid) && !many {
        let what = "--fire grid is for --media bounded and attenuate";
        return Err(Error::Usage(what.to_owned()));
    }
    let of_fires = args.fire_alpha.is_some() || args.fire_depths.is_some();
    if args.fire != Some(FireArg::Grid)
        && (of_fires || args.fire_build.is_some() || args.fire_blend.is_some())
    {
        let what = "--fire-alpha, --fire-depths, --fire-build and --fire-blend are for --fire grid";
        return Err(Error::Usage(what.to_owned()));
    }
    let fires = FireOptions::default();
    let fires = FireOptions {
        alpha: args.fire_alpha.unwrap_or(fires.alpha),
        depths: args.fire_depths.map_or(fires.depths, |n| n as usize),
        build: match args.fire_build {
            Some(BuildArg::Below) => Build::FromBelow,
            Some(BuildArg::Lights) | None => Build::FromLights,
        },
        blend: match args.fire_blend {
            Some(BlendArg::Published) => Blend::Published,
            Some(BlendArg::Conserving) | None => Blend::Conserving,
        },
    };
    Ok(Tuning {
        fire: match args.fire {
            Some(FireArg::Grid) => FireBy::Grid(fires),
            Some(FireArg::March) => FireBy::March,
            Some(FireArg::Paths) | None => FireBy::Paths,
        },
        light_samples: args.light_samples.unwrap_or(usual.light_samples),
        light_threshold: args.light_threshold.unwrap_or(usual.light_threshold),
        direct_alpha: args.direct_alpha.unwrap_or(usual.direct_alpha),
        tables: args.tables.clone(),
        zh_order: args.zh_order.map_or(usual.zh_order, |n| n as usize),
    })
}

/// How fine the light grid is: by the command line, else by the preset, or finer where a target asks for it.
pub(crate) fn light_grid(args: GridArgs, quality: Quality, target: Option<f32>) -> Fineness {
    let preset = quality.light_grid();
    let preset = target.map_or(preset, |error| preset.for_target(error));
    Fineness {
        nodes: args.grid_nodes.unwrap_or(preset.nodes),
        paths: args.grid_paths.unwrap_or(preset.paths),
        orders: args.grid_orders,
    }
}

/// Paths per texel for the direction of light, if it is asked for.
///
/// # Errors
///
/// With tables, whose light of media comes from no direction, and with a time budget, of which nothing is kept for it.
fn directional(
    args: &SettingsArgs,
    run: &RunConfig,
    force: &Force,
    media: MediaMode,
    (sampling, samples): (&Sampling, u32),
) -> Result<Option<u32>, Error> {
    let asked = args.directional || run.directional == Some(true);
    if !force.word(Effect::Lightmaps).map_or(asked, |word| word == "directional") {
        return Ok(None);
    }
    if media == MediaMode::Table {
        let what = "--directional: media as `table` sees them scatter light from no single direction; take --media bounded";
        return Err(Error::Usage(what.to_owned()));
    }
    if matches!(sampling, Sampling::Budget(_) | Sampling::Rounds(_)) {
        let what = "--directional has a fixed number of paths and no share of a time budget; take --quality, --samples or --target-error";
        return Err(Error::Usage(what.to_owned()));
    }
    Ok(Some((samples / 2).max(8)))
}

/// Light probes: by the command line, else the configuration file, else by the preset.
///
/// # Errors
///
/// If the file's word is not known.
fn probes(
    args: ProbeArgs,
    run: &RunConfig,
    force: &Force,
    quality: Quality,
    sampling: &Sampling,
) -> Result<Option<Probes>, Error> {
    let basis = match (args.probes, &run.probes) {
        (None, Some(text)) => word(text, "run.probes")?,
        (given, _) => given.unwrap_or(ProbesArg::L2),
    };
    let basis = match basis {
        _ if force.word(Effect::Probes) == Some("off") => return Ok(None),
        ProbesArg::Off if force.word(Effect::Probes) != Some("on") => return Ok(None),
        ProbesArg::L1 => Basis::L1,
        ProbesArg::Off | ProbesArg::L2 => Basis::L2,
        ProbesArg::L3 => Basis::L3,
        ProbesArg::Zh3 => Basis::Zh3,
    };
    // A time budget is for the lightmap.
    let preset =
        if matches!(sampling, Sampling::Budget(_) | Sampling::Rounds(_)) { Quality::Draft } else { quality };
    let (about, samples) = preset.probes();
    // A number on the command line stands above a distance in the file, and the other way round.
    let spacing = args.probe_spacing.or(run.probe_spacing.filter(|_| args.probe_count.is_none()));
    Ok(Some(Probes {
        basis,
        about: args.probe_count.or(run.probe_count).unwrap_or(about),
        spacing,
        // As many in each of the blocks that state the error.
        samples: args.probe_samples.or(run.probe_samples).unwrap_or(samples).next_multiple_of(16),
    }))
}

/// Says where the light grid could not be solved as it should.
pub(crate) fn say_light_grid(grid: &LightGrid) {
    if grid.forward < 1.0 {
        say::line(&format!(
            "warning: light that media scatter forwards again and again grew without bound in the light grid; their g counts as {} times as \
             much there; more --grid-paths help",
            grid.forward
        ));
    }
}

/// Says what became of responses of media that could not be taken as they are.
pub(crate) fn say_responses(tracing: &Tracing) {
    let Some(responses) = &tracing.responses else { return };
    if 0 < responses.clamped() {
        let n = responses.clamped();
        say::line(&format!(
            "note: {n} responses of media were below 0, as truncated harmonics are where little light is; taken as 0"
        ));
    }
    if 0 < responses.grown() {
        let n = responses.grown();
        say::line(&format!(
            "warning: {n} paths were ended because media as `table` sees them add light at every reflection; between walls it has no limit, \
             and --media reference is right"
        ));
    }
}

/// Settings from the command line, else the configuration file, else the scene, else the preset.
///
/// # Errors
///
/// If a value is out of range.
pub(crate) fn settings(
    args: &SettingsArgs,
    run: &RunConfig,
    (scene, document): (&Scene, &Document),
) -> Result<Settings, Error> {
    let quality = match (args.quality, &run.quality) {
        (Some(q), _) => q,
        (None, Some(text)) => word(text, "run.quality")?,
        (None, None) => QualityArg::Medium,
    };
    let unwrap = match (args.unwrap, &run.unwrap) {
        (Some(u), _) => u,
        (None, Some(text)) => word(text, "run.unwrap")?,
        (None, None) => UnwrapArg::Auto,
    };
    let texture = match (args.texture, &run.texture) {
        (Some(t), _) => t,
        (None, Some(text)) => word(text, "run.texture")?,
        (None, None) => TextureArg::Bc6h,
    };
    let seams = match (args.seams, &run.seams) {
        (Some(s), _) => s,
        (None, Some(text)) => word(text, "run.seams")?,
        (None, None) => OnOff::On,
    };
    let force = force(&args.force, run)?;
    let media = media(args.media, run, &force, scene)?;
    let quality = self::quality(quality);
    let texels_per_metre = args.texels_per_metre.or(run.texels_per_metre).or(scene.texels_per_metre);
    if let Some(d) = texels_per_metre
        && !(d.is_finite() && 0.0 < d)
    {
        return Err(Error::Usage(format!("--texels-per-metre {d}: write a positive number")));
    }
    let sampling = sampling(args, run, quality)?;
    let target = if let Sampling::Target(x) = sampling { Some(x) } else { None };
    let samples = match sampling {
        Sampling::Exact(n) => n,
        _ => quality.samples(),
    };
    let directional = directional(args, run, &force, media, (&sampling, samples))?;
    let probes = probes(args.probes, run, &force, quality, &sampling)?;
    let irradiance_cache =
        force.word(Effect::Cache).map_or(args.irradiance_cache == OnOff::On, |word| word == "on");
    let bounces = args.bounces.or(run.bounces);
    if force.word(Effect::Cache) == Some("on") && (bounces.is_some() || media == MediaMode::Reference) {
        let what = "--force cache=on: a limit of reflections or --media reference rules the cache out";
        return Err(Error::Usage(what.to_owned()));
    }
    let direct = direct(args.direct, run)?;
    Ok(Settings {
        quality,
        samples,
        sampling,
        bounces,
        texels_per_metre,
        max_size: args.max_size.or(run.max_size).unwrap_or(4096),
        padding: 2,
        unwrap: match unwrap {
            UnwrapArg::Keep => Unwrap::Keep,
            UnwrapArg::Auto => Unwrap::Auto,
            UnwrapArg::Always => Unwrap::Always,
        },
        engine: engine(args),
        media,
        light_grid: light_grid(args.grid, quality, target),
        direct,
        tuning: tuning(&args.tuning, (media, direct), document)?,
        directional,
        probes,
        seed: args.seed.or(run.seed).unwrap_or(0),
        irradiance_cache,
        split_direct: args.split_direct,
        texture: match texture {
            TextureArg::Bc6h => Some(TextureFormat::Bc6h),
            TextureArg::Rgba16f => Some(TextureFormat::Rgba16f),
            TextureArg::None => None,
        },
        denoise: denoise(args, run, &force, quality)?,
        seams: force.word(Effect::Seams).map_or(seams == OnOff::On, |word| word == "on"),
        force,
    })
}

/// Whether lightmaps are denoised: by the command line, else the configuration file. Else they are as the preset has it, unless somebody asks
/// for a number of paths, an error or a time: such a bake is of light as it was gathered.
fn denoise(args: &SettingsArgs, run: &RunConfig, force: &Force, quality: Quality) -> Result<Denoise, Error> {
    let arg = match (force.word(Effect::Denoise), args.denoise, &run.denoise) {
        (Some(text), ..) => word(text, "force")?,
        (None, Some(given), _) => given,
        (None, None, Some(text)) => word(text, "run.denoise")?,
        (None, None, None) if effort_is_given(args, run) => DenoiseArg::Off,
        (None, None, None) => return Ok(quality.denoise()),
    };
    Ok(match arg {
        DenoiseArg::Off => Denoise::Off,
        DenoiseArg::Draft => Denoise::Draft,
        DenoiseArg::Final => Denoise::Final,
    })
}

/// Whether anything but the preset says how much is gathered.
fn effort_is_given(args: &SettingsArgs, run: &RunConfig) -> bool {
    let given = args.samples.is_some() || args.rounds.is_some() || args.target_error.is_some();
    let in_file = run.samples.is_some() || run.target_error.is_some() || run.time_budget.is_some();
    given || args.time_budget.is_some() || in_file
}

/// How much is gathered: the command line stands above the configuration as a whole, so that one number
/// there is not joined with another here.
fn sampling(args: &SettingsArgs, run: &RunConfig, quality: Quality) -> Result<Sampling, Error> {
    let target = |x: f32| {
        if 0.0 < x && x.is_finite() {
            return Ok(Sampling::Target(x));
        }
        Err(Error::Usage(format!("target error {x}: write a positive number such as 0.02")))
    };
    let budget = |text: &str| match humantime::parse_duration(text) {
        Ok(d) if !d.is_zero() => Ok(Sampling::Budget(d.as_secs_f64())),
        _ => Err(Error::Usage(format!("time budget `{text}`: write a time such as 30s, 5m or 1h"))),
    };
    if let Some(n) = args.samples {
        return Ok(Sampling::Exact(n));
    }
    if let Some(x) = args.target_error {
        return target(x);
    }
    if let Some(text) = &args.time_budget {
        return budget(text);
    }
    if let Some(text) = &args.rounds {
        let page = |list: &str| {
            let list: Vec<f32> = list.split(',').map(|n| n.trim().parse().ok()).collect::<Option<_>>()?;
            let rising = list.iter().all(|n| n.is_finite() && 0.0 < *n) && list.is_sorted();
            rising.then_some(list)
        };
        let pages: Option<Vec<Vec<f32>>> = text.split('/').map(page).collect();
        return pages.map(Sampling::Rounds).ok_or_else(|| {
            let what = "write positive numbers, none less than the one before it, such as 8,20,64";
            Error::Usage(format!("--rounds {text}: {what}"))
        });
    }
    match (run.samples, run.target_error, &run.time_budget) {
        (Some(n), ..) => Ok(Sampling::Exact(n)),
        (None, Some(x), _) => target(x),
        (None, None, Some(text)) => budget(text),
        (None, None, None) => Ok(Sampling::Mean(quality.samples())),
    }
}

pub(crate) fn quality(arg: QualityArg) -> Quality {
    match arg {
        QualityArg::Draft => Quality::Draft,
        QualityArg::Medium => Quality::Medium,
        QualityArg::High => Quality::High,
    }
}

#[cfg(feature = "xatlas")]
fn engine(args: &SettingsArgs) -> Engine {
    match args.unwrap_engine {
        crate::cli::args::EngineArg::Uvunwrap => Engine::Uvunwrap,
        crate::cli::args::EngineArg::Xatlas => Engine::Xatlas { seconds: 60 },
    }
}

#[cfg(not(feature = "xatlas"))]
fn engine(_: &SettingsArgs) -> Engine {
    Engine::Uvunwrap
}

/// The interpretation of every light, one line each: what the numbers of the file were taken for.
pub(crate) fn lights(input: &Input) -> String {
    let mut text = String::new();
    let strongest = |c: glam::Vec3| c.max_element();
    for light in input.scene.lights.iter().take(8) {
        let what = match light.kind {
            LightKind::Point { intensity, .. } => format!("point, {:.4} cd", strongest(intensity)),
            LightKind::Spot { intensity, .. } => format!("spot, {:.4} cd", strongest(intensity)),
            LightKind::Directional { illuminance, .. } => {
                format!("directional, {:.4} lx", strongest(illuminance))
            }
        };
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  {}: {what} (brightest channel), {:?}", light.path, light.mode);
    }
    if 8 < input.scene.lights.len() {
        let _ = writeln!(text, "  and {} more", input.scene.lights.len() - 8);
    }
    text
}

/// The way of showing progress that the configuration names.
///
/// # Errors
///
/// If the word is unknown.
pub(crate) fn progress(text: &str) -> Result<crate::cli::args::ProgressArg, Error> {
    word(text, "run.progress")
}
