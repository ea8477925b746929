//! Every argument of every command.

use crate::solve::accumulate::Rejected;
use clap::{Args as ClapArgs, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Bakes a glTF scene into lightmaps: headless, deterministic, with an error figure on everything.
#[derive(Debug, Parser)]
#[command(name = "bake", version, about, propagate_version = true, max_term_width = 100)]
pub(crate) struct Args {
    #[command(subcommand)]
    pub(crate) command: Command,
}

/// What `--version` says: the program's own, and which response tables are inside. Reading them costs memory, so it is done only
/// when asked for.
pub(crate) fn versions() -> String {
    let tables = match tables::table::Tables::embedded() {
        Ok(t) => format!("{} preset, {} bytes, BLAKE3 {}", t.header().preset, t.bytes(), t.checksum()),
        Err(e) => e.to_string(),
    };
    format!("{}\nresponse tables: {tables}", env!("CARGO_PKG_VERSION"))
}

fn positive(text: &str) -> Result<f32, String> {
    let x: f32 = text.parse().map_err(|_| "a number above 0 is wanted".to_owned())?;
    if 0.0 < x && x.is_finite() { Ok(x) } else { Err("a number above 0 is wanted".to_owned()) }
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Bake a scene into a folder of lightmaps
    Run(RunArgs),
    /// Show what a scene contains, what will run and why, memory and time
    Plan(PlanArgs),
    /// Report all findings about the input at once
    Check(CheckArgs),
    /// Irradiance and its standard error at given points and normals
    Points(PointsArgs),
    /// Compare two bakes or two EXR files
    Compare(CompareArgs),
    /// Measure error against seconds for every knob
    Study(StudyArgs),
    /// Write a page that shows a bake in a browser
    Html(HtmlArgs),
    /// Join shards (reserved)
    Merge(MergeArgs),
}

/// What decides how the scene is read.
#[derive(Clone, Debug, ClapArgs)]
pub(crate) struct SceneArgs {
    /// Scene, .gltf or .glb; the embedded hall if absent
    pub(crate) scene: Option<PathBuf>,
    /// Configuration file with lamps, sky, node settings and run options
    #[arg(long, value_name = "bake.toml")]
    pub(crate) config: Option<PathBuf>,
    /// Sky: `0.5`, `1,0.9,0.8` (nits), `#rrggbb`, or an equirectangular image
    #[arg(long, value_name = "COLOUR|FILE.hdr|FILE.exr", allow_hyphen_values = true)]
    pub(crate) sky: Option<String>,
    /// How the file's light intensities are meant [default: gltf]
    #[arg(long, value_enum)]
    pub(crate) light_units: Option<LightUnitsArg>,
    /// Number that stands for `#` in the names of volume files: of `smoke.####.vdb` frame 12 is `smoke.0012.vdb`
    #[arg(long, value_name = "N")]
    pub(crate) frame: Option<u32>,
}

/// What decides how much is computed.
#[derive(Clone, Debug, ClapArgs)]
pub(crate) struct SettingsArgs {
    /// Preset [default: medium]
    ///
    /// draft: 16 paths per texel on average, one page of at most 1024^2;
    /// medium: 64 paths, 2048^2;
    /// high: 512 paths, 4096^2
    #[arg(long, value_enum)]
    pub(crate) quality: Option<QualityArg>,
    /// Exactly this many paths in every texel; otherwise the preset's number is a mean, and texels with more
    /// variance get more
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1 << 20))]
    pub(crate) samples: Option<u32>,
    /// Go on until the map's relative error is below this, such as 0.02
    #[arg(long, value_name = "REL", allow_negative_numbers = true, conflicts_with = "samples")]
    pub(crate) target_error: Option<f32>,
    /// Take about this much wall time for the whole command, such as 30s or 5m
    #[arg(long, value_name = "TIME", conflicts_with_all = ["samples", "target_error"])]
    pub(crate) time_budget: Option<String>,
    /// Mean paths per texel after each round, page by page; replays a time budget from its manifest
    #[arg(long, value_name = "N,N,.../N,N,...", conflicts_with_all = ["samples", "target_error", "time_budget"])]
    pub(crate) rounds: Option<String>,
    /// Most reflections; without it Russian roulette ends paths
    #[arg(long, value_name = "N")]
    pub(crate) bounces: Option<u32>,
    /// Density; without it the scene fills one page of the preset's size
    #[arg(long, value_name = "X", allow_negative_numbers = true)]
    pub(crate) texels_per_metre: Option<f32>,
    /// Greatest side of a page; pages are multiples of 4 [default: 4096]
    #[arg(long, value_name = "PX")]
    pub(crate) max_size: Option<u32>,
    /// What happens to second UV sets of the file [default: auto]
    #[arg(long, value_enum)]
    pub(crate) unwrap: Option<UnwrapArg>,
    /// What flattens charts
    #[cfg(feature = "xatlas")]
    #[arg(long, value_enum, default_value = "uvunwrap")]
    pub(crate) unwrap_engine: EngineArg,
    /// What becomes of fog and other media of the scene [default: bounded]
    #[arg(long, value_enum)]
    pub(crate) media: Option<MediaArg>,
    /// How lamps and emissive triangles are asked for their light [default: auto]
    #[arg(long, value_enum)]
    pub(crate) direct: Option<DirectArg>,
    #[command(flatten)]
    pub(crate) grid: GridArgs,
    #[command(flatten)]
    pub(crate) tuning: TuningArgs,
    #[command(flatten)]
    pub(crate) probes: ProbeArgs,
    /// End paths at irradiance gathered beforehand: much less noise, a small bias that README states; a
    /// limit of --bounces rules it out
    #[arg(long, value_enum, value_name = "WHETHER", default_value = "on")]
    pub(crate) irradiance_cache: OnOff,
    /// Also write direct and indirect light apart
    #[arg(long)]
    pub(crate) split_direct: bool,
    /// Also write the direction that light comes from, for normal maps: SH of band 1, with half as many paths as the preset or --samples has
    #[arg(long)]
    pub(crate) directional: bool,
    /// What GPU-ready textures beside the EXRs hold [default: bc6h]
    #[arg(long, value_enum)]
    pub(crate) texture: Option<TextureArg>,
    /// Take noise out of lightmaps; what they were before stays in them as `noisy`, and error figures stay those of before
    /// [default: draft, with --quality high final; with --samples, --target-error, --time-budget or --rounds off]
    #[arg(long, value_enum)]
    pub(crate) denoise: Option<DenoiseArg>,
    /// Make both sides of seams look the same: within meshes and where objects touch [default: on]
    #[arg(long, value_enum, value_name = "WHETHER")]
    pub(crate) seams: Option<OnOff>,
    /// Seed of all random numbers [default: 0]
    #[arg(long, value_name = "N")]
    pub(crate) seed: Option<u64>,
    /// Run this kernel for an effect and not the smallest that is right, such as lamps=tree or media=none; `bake plan --json` lists all of
    /// them. May be given several times
    #[arg(long, value_name = "EFFECT=KERNEL")]
    pub(crate) force: Vec<String>,
}

/// How fine the light grid of `--media bounded` is.
#[derive(Clone, Copy, Debug, ClapArgs)]
pub(crate) struct GridArgs {
    /// Nodes of the light grid that `--media bounded` fills, about [default: 1024 draft, 8192 medium, 16384 high and with a target
    /// below 5 %]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=1 << 24))]
    pub(crate) grid_nodes: Option<u32>,
    /// Paths from each of them [default: 32 draft, 24 medium, 64 high; more for targets below 3 %; up to three times as many where g is not 0]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1 << 16))]
    pub(crate) grid_paths: Option<u32>,
    /// Most times that light is scattered on its way from node to node; without it as often as counts
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=400))]
    pub(crate) grid_orders: Option<u32>,
}

/// Look-ups of lights and tables.
#[derive(Clone, Debug, ClapArgs)]
pub(crate) struct TuningArgs {
    /// How many of many lights a texel asks at once [default: 4]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=64))]
    pub(crate) light_samples: Option<u32>,
    /// Squared size over squared distance beyond which groups of many lights are looked into [default: 0.5]
    #[arg(long, value_name = "X", value_parser = positive, allow_negative_numbers = true)]
    pub(crate) light_threshold: Option<f32>,
    /// Radius of influence of the levels of --direct grid over their spacing: larger is slower and nearer to the truth [default: 4]
    #[arg(long, value_name = "X", value_parser = alpha, allow_negative_numbers = true)]
    pub(crate) direct_alpha: Option<f32>,
    /// Response tables for --media table, made by `tables build`; the embedded ones if absent
    #[arg(long, value_name = "FILE.zht")]
    pub(crate) tables: Option<PathBuf>,
    /// Bands of zonal harmonics that --media table looks up [default: 11]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=11))]
    pub(crate) zh_order: Option<u32>,
    /// How surfaces find the light of media that emit: by directions and by places chosen for it, or, for --media bounded and attenuate, as many lights in
    /// a lighting grid hierarchy, which is smooth but some per cent off in dense smoke [default: paths]
    #[arg(long, value_enum)]
    pub(crate) fire: Option<FireArg>,
    /// Radius of influence of the hierarchy's levels over their spacing: larger is slower and nearer to the truth [default: 2]
    #[arg(long, value_name = "X", value_parser = alpha, allow_negative_numbers = true)]
    pub(crate) fire_alpha: Option<f32>,
    /// Distances for which each texel of the hierarchy's shadows knows what is left of light [default: 4]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=64))]
    pub(crate) fire_depths: Option<u32>,
    /// What the levels of the hierarchy of --fire grid are built from [default: lights]
    #[arg(long, value_enum)]
    pub(crate) fire_build: Option<BuildArg>,
    /// How the levels of the hierarchy of --fire grid take over from each other [default: conserving]
    #[arg(long, value_enum)]
    pub(crate) fire_blend: Option<BlendArg>,
}

/// What levels of a lighting grid hierarchy are built from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum BuildArg {
    /// All of them from what emits
    Lights,
    /// Each from the level below: quicker, and smoother than published
    Below,
}

/// How levels of a lighting grid hierarchy take over from each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum BlendArg {
    /// Each light fades by its own distance: weights are off by some per cent
    Published,
    /// Each light fades by what lights above have taken over of it: nothing counts twice
    Conserving,
}

/// How light of media that emit is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum FireArg {
    /// A lighting grid hierarchy
    Grid,
    /// Directions, and places chosen for what is emitted there
    Paths,
    /// Directions alone, to compare with: more noise
    March,
}

/// The first and the last of some frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frames {
    pub(crate) first: u32,
    pub(crate) last: u32,
}

fn frames(text: &str) -> Result<Frames, String> {
    let both = text.split_once("..").and_then(|(a, b)| Some((a.parse().ok()?, b.parse().ok()?)));
    match both {
        Some((first, last)) if first <= last => Ok(Frames { first, last }),
        Some((first, last)) => Err(format!("{first} is after {last}")),
        None => Err("write the first and the last frame, such as 1..24".to_owned()),
    }
}

fn alpha(text: &str) -> Result<f32, String> {
    let x: f32 = text.parse().map_err(|e| format!("{e}"))?;
    if (1.0..=64.0).contains(&x) { Ok(x) } else { Err("write a number from 1 to 64".to_owned()) }
}

/// Light probes.
#[derive(Clone, Copy, Debug, ClapArgs)]
pub(crate) struct ProbeArgs {
    /// Light probes for moving objects and fog: what each keeps of the light, or none [default: l2]
    #[arg(long, value_enum)]
    pub(crate) probes: Option<ProbesArg>,
    /// At most so many probes, nearer to one another where surfaces are, and never fewer than a few hundred [default: 1024 draft and with a time budget, 4096 medium,
    /// 16384 high]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=1 << 22))]
    pub(crate) probe_count: Option<u32>,
    /// Distance of probes where surfaces are, metres, instead of their number
    #[arg(long, value_name = "X", value_parser = positive, allow_negative_numbers = true, conflicts_with = "probe_count")]
    pub(crate) probe_spacing: Option<f32>,
    /// Paths from each probe, rounded up to a multiple of 16 [default: 64 draft and with a time budget, 128 medium, 512 high]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(16..=1 << 20))]
    pub(crate) probe_samples: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProbesArg {
    /// No probes
    Off,
    /// Spherical harmonics of bands 0 and 1: 4 coefficients
    L1,
    /// Bands 0 to 2: 9 coefficients
    L2,
    /// Bands 0 to 3: 16 coefficients
    L3,
    /// Bands 0 and 1 and the zonal part of band 2: 5 coefficients
    Zh3,
}

/// How the command runs, without effect on its result.
#[derive(Clone, Debug, ClapArgs)]
pub(crate) struct WorkArgs {
    /// Worker threads [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub(crate) threads: Option<u32>,
    /// Progress on standard error [default: auto]
    #[arg(long, value_enum)]
    pub(crate) progress: Option<ProgressArg>,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct RunArgs {
    #[command(flatten)]
    pub(crate) scene: SceneArgs,
    /// Folder to write [default: the scene's name + .bake]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
    /// Bake each of these frames into a folder of its own, `frame-0001` and so on, and say how much the light changes from each to the next
    #[arg(long, value_name = "A..B", value_parser = frames, conflicts_with_all = ["frame", "replay"])]
    pub(crate) frames: Option<Frames>,
    #[command(flatten)]
    pub(crate) settings: SettingsArgs,
    /// Gather so many texels again by paths that approximate nothing, media and cache and bounces included, and say by how much the
    /// map is off beside its noise
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=1 << 24))]
    pub(crate) audit: Option<u32>,
    /// Stop with an error at the first sample that is not a number instead of counting it
    #[arg(long)]
    pub(crate) strict: bool,
    /// Take one sample of this bake alone and print it: what the message about samples that are not numbers asks for
    ///
    /// KIND is small (suns and lamps), path or direction; or probe, where PAGE is the volume and TEXEL the probe; node of the light grid of
    /// media, where PAGE is 0; or cell of the irradiance cache, where PAGE is the pass. Nothing is written. Ends with 0 if the sample is finite, with 2 if not
    #[arg(long, value_name = "PAGE:TEXEL:KIND:SAMPLE")]
    pub(crate) replay: Option<Rejected>,
    /// Factor that pictures multiply light by before tone mapping, so that bakes can be looked at side by side;
    /// found from each picture if absent, and the manifest has that of preview.png
    #[arg(long, value_name = "X", value_parser = positive, allow_negative_numbers = true)]
    pub(crate) exposure: Option<f32>,
    #[command(flatten)]
    pub(crate) work: WorkArgs,
    /// Go on with an interrupted bake (reserved)
    #[arg(long)]
    pub(crate) resume: bool,
    /// Bake a part of the work (reserved)
    #[arg(long, value_name = "RANGE", requires = "of")]
    pub(crate) shard: Option<String>,
    /// Number of parts (reserved)
    #[arg(long, value_name = "N")]
    pub(crate) of: Option<u32>,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct PlanArgs {
    #[command(flatten)]
    pub(crate) scene: SceneArgs,
    #[command(flatten)]
    pub(crate) settings: SettingsArgs,
    /// Say why for every decision
    #[arg(long)]
    pub(crate) explain: bool,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) work: WorkArgs,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    pub(crate) scene: SceneArgs,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct PointsArgs {
    /// Scene, .gltf or .glb
    pub(crate) scene: PathBuf,
    /// {"points": [{"position": [x, y, z], "normal": [x, y, z]}]}
    pub(crate) points: PathBuf,
    /// Configuration file
    #[arg(long, value_name = "bake.toml")]
    pub(crate) config: Option<PathBuf>,
    /// Preset: relative standard error 1 % (draft), 0.3 % (medium), 0.1 % (high) [default: medium]
    #[arg(long, value_enum)]
    pub(crate) quality: Option<QualityArg>,
    /// Exactly this many paths per point
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) samples: Option<u32>,
    /// Go on until the standard error is below this part of the value
    #[arg(long, value_name = "REL", allow_negative_numbers = true)]
    pub(crate) target_error: Option<f32>,
    /// Most reflections
    #[arg(long, value_name = "N")]
    pub(crate) bounces: Option<u32>,
    /// Sky
    #[arg(long, value_name = "COLOUR|FILE.hdr|FILE.exr", allow_hyphen_values = true)]
    pub(crate) sky: Option<String>,
    /// How the file's light intensities are meant
    #[arg(long, value_enum)]
    pub(crate) light_units: Option<LightUnitsArg>,
    /// What becomes of fog and other media of the scene [default: bounded]
    #[arg(long, value_enum)]
    pub(crate) media: Option<MediaArg>,
    /// How lamps and emissive triangles are asked for their light [default: auto]
    #[arg(long, value_enum)]
    pub(crate) direct: Option<DirectArg>,
    #[command(flatten)]
    pub(crate) grid: GridArgs,
    #[command(flatten)]
    pub(crate) tuning: TuningArgs,
    /// Seed of all random numbers
    #[arg(long, value_name = "N")]
    pub(crate) seed: Option<u64>,
    /// Take one sample of a point alone, or of a node of the light grid (0:NODE:node:SAMPLE), and print it: what the message about samples that are not
    /// numbers asks for
    #[arg(long, value_name = "0:POINT:point:SAMPLE")]
    pub(crate) replay: Option<Rejected>,
    /// Run this kernel for an effect and not the smallest that is right, such as lamps=tree or media=none
    #[arg(long, value_name = "EFFECT=KERNEL")]
    pub(crate) force: Vec<String>,
    #[command(flatten)]
    pub(crate) work: WorkArgs,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct CompareArgs {
    /// A bake's folder, or an EXR
    pub(crate) a: PathBuf,
    /// The reference: a bake's folder, or an EXR
    pub(crate) b: PathBuf,
    /// Folder for difference pictures
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
    /// Chance that two equal bakes are called different [default: 0.001]
    #[arg(long, value_name = "P", allow_negative_numbers = true)]
    pub(crate) alpha: Option<f64>,
    /// Relative RMSE that counts as equal where a side has no standard errors [default: 0.001]
    #[arg(long, value_name = "REL", allow_negative_numbers = true)]
    pub(crate) tolerance: Option<f64>,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct StudyArgs {
    #[command(flatten)]
    pub(crate) scene: SceneArgs,
    /// Folder to write: study.html, study.csv and plots [default: the scene's name + .study]
    #[arg(short, long, value_name = "DIR")]
    pub(crate) output: Option<PathBuf>,
    /// About how many texels the scene is given
    #[arg(long, value_name = "N", default_value_t = 30_000, value_parser = clap::value_parser!(u32).range(100..=100_000_000))]
    pub(crate) texels: u32,
    /// Unbiased paths per texel of each of the two references
    #[arg(long, value_name = "N", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(16..=1 << 20))]
    pub(crate) reference_samples: u32,
    /// Bakes of each setting, each with another seed
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(2..=64))]
    pub(crate) seeds: u32,
    /// Only these knobs, such as `samples,media rung`
    #[arg(long, value_name = "NAME,NAME,...", value_delimiter = ',')]
    pub(crate) knobs: Vec<String>,
    #[command(flatten)]
    pub(crate) work: WorkArgs,
}

impl StudyArgs {
    /// Settings of a bake as the study makes them: those of medium quality.
    pub(crate) fn settings(&self) -> SettingsArgs {
        /// Arguments of a command that has nothing else.
        #[derive(Parser)]
        struct Plain {
            #[command(flatten)]
            settings: SettingsArgs,
        }
        Plain::parse_from(["bake"]).settings
    }
}

#[derive(Debug, ClapArgs)]
pub(crate) struct HtmlArgs {
    /// A bake's folder
    #[arg(value_name = "DIR")]
    pub(crate) bake: PathBuf,
    /// File to write [default: the folder's name with .html, in the working directory]
    #[arg(short, long, value_name = "FILE.html")]
    pub(crate) output: Option<PathBuf>,
}

#[derive(Debug, ClapArgs)]
pub(crate) struct MergeArgs {
    /// Folder with shards
    #[arg(value_name = "DIR")]
    pub(crate) _dir: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum OnOff {
    On,
    Off,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum QualityArg {
    Draft,
    Medium,
    High,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum UnwrapArg {
    /// Use them; a surface without valid ones is an error
    Keep,
    /// Use valid ones, unwrap the rest
    Auto,
    /// Ignore them
    Always,
}

#[cfg(feature = "xatlas")]
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum EngineArg {
    /// Seconds for hundreds of thousands of triangles
    Uvunwrap,
    /// Fewer charts on small meshes; stopped after 60 s a mesh
    Xatlas,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum LightUnitsArg {
    /// Candela and lux, as the specification says
    Gltf,
    /// Watts, as Blender exports with "Raw"
    BlenderRaw,
    /// Watts over 4 pi, as Blender exports with "Unitless"
    BlenderUnitless,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum MediaArg {
    /// Media are ignored
    Off,
    /// Media weaken light, and scatter none
    Attenuate,
    /// Media weaken light and scatter it as if nothing bounded them: [IR19], for open air
    Table,
    /// Media weaken light and scatter it, walls and shadows included
    Bounded,
    /// Unbiased paths scatter in media: slow
    Reference,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum DirectArg {
    /// Few are weighed one by one, many are in a tree
    Auto,
    /// A ray to each of them from every surface; in media one is chosen
    All,
    /// One at a time is chosen from a tree
    Lightcuts,
    /// Lamps that shine everywhere are in a lighting grid hierarchy, of which surfaces ask all at once: smooth, and some per cent off; others as with auto
    Grid,
    /// Stochastic lightcuts as [SLC20] has them, to compare with: more noise
    Published,
    /// By intensity alone, to compare with
    #[cfg(feature = "comparison")]
    Intensity,
    /// Adaptive tree splitting, to compare with
    #[cfg(feature = "comparison")]
    Splitting,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum TextureArg {
    /// One byte a texel, with loss
    Bc6h,
    /// Eight bytes a texel, half floats
    Rgba16f,
    /// No textures
    None,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum DenoiseArg {
    /// Texels stay as they were gathered
    Off,
    /// One small neighbourhood for all texels
    Draft,
    /// For each texel the neighbourhood that promises it the smallest error
    Final,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ProgressArg {
    /// A bar on a terminal, lines elsewhere
    Auto,
    /// Lines
    Plain,
    /// One JSON object a line
    Json,
    /// Nothing
    None,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn arguments_are_consistent() {
        Args::command().debug_assert();
    }
}
