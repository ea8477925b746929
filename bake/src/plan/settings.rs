//! Every knob of a bake with its resolved value.

use crate::geom::atlas::{AtlasOptions, Density, Engine, Unwrap};
use crate::light::Direct;
use crate::light::fires::FireOptions;
use crate::light::lamp_grid;
use crate::light::many::{SEVERAL, THRESHOLD};
use crate::media::Media;
use crate::plan::kernels::Force;
use serde_json::{Map, Value, json};
use std::path::PathBuf;
use tables::harmonics::BANDS;
use tables::probes::Basis;

/// Presets of density and samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quality {
    /// A first look.
    Draft,
    /// Good enough to work with.
    Medium,
    /// To ship.
    High,
}

impl Quality {
    /// All presets, cheapest first.
    pub const ALL: [Self; 3] = [Self::Draft, Self::Medium, Self::High];

    /// Paths per texel.
    #[must_use]
    pub const fn samples(self) -> u32 {
        match self {
            Self::Draft => 16,
            Self::Medium => 64,
            Self::High => 512,
        }
    }

    /// How lightmaps are denoised where nothing else is said of their paths.
    #[must_use]
    pub const fn denoise(self) -> Denoise {
        match self {
            Self::Draft | Self::Medium => Denoise::Draft,
            Self::High => Denoise::Final,
        }
    }

    /// How fine the light grid of media is.
    #[must_use]
    pub const fn light_grid(self) -> Fineness {
        let (nodes, paths) = match self {
            Self::Draft => (1 << 10, 32),
            Self::Medium => (1 << 13, 24),
            Self::High => (1 << 14, 64),
        };
        Fineness { nodes, paths, orders: None }
    }

    /// About how many light probes a scene gets, and paths from each.
    #[must_use]
    pub const fn probes(self) -> (u32, u32) {
        match self {
            Self::Draft => (1 << 10, 64),
            Self::Medium => (1 << 12, 128),
            Self::High => (1 << 14, 512),
        }
    }

    /// Side of the one page that the scene is fitted onto where no density is given, texels.
    #[must_use]
    pub const fn page_size(self) -> u32 {
        match self {
            Self::Draft => 1024,
            Self::Medium => 2048,
            Self::High => 4096,
        }
    }

    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Medium => "medium",
            Self::High => "high",
        }
    }
}

/// How fine the light grid of media is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fineness {
    /// About how many nodes.
    pub nodes: u32,
    /// Paths from each node.
    pub paths: u32,
    /// Most steps of scattering from node to node; `None`: as many as count.
    pub orders: Option<u32>,
}

/// Media that scatter backwards ask for no more than this times as many paths as where g is 0, which is what the most forward ones ask for.
const MOST_TURNS: f32 = 3.0;

/// Targets below this ask for as many nodes as the finest preset has.
const FINE_TARGET: f32 = 0.05;

/// Paths from each node times the squared target. Stated errors do not know of the grid's own noise, which has to stay a quarter of the target: in a room of 4 m in
/// mist it is 1.1 % with 8192 nodes and 24 paths, and 0.5 % with 16384 nodes and 64 paths.
const PATHS_FOR_TARGET: f32 = 0.03;

/// Most paths from each node that a target asks for.
const MOST_FOR_TARGET: f32 = 1024.0;

impl Fineness {
    /// Fine enough for an error that is asked for, as a part of the mean, and no coarser than it is.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of paths")]
    pub fn for_target(self, error: f32) -> Self {
        if FINE_TARGET <= error {
            return self;
        }
        let paths = (PATHS_FOR_TARGET / (error * error)).min(MOST_FOR_TARGET) as u32;
        let nodes = self.nodes.max(Quality::High.light_grid().nodes);
        Self { nodes, paths: self.paths.max(paths), ..self }
    }

    /// For media that scatter forwards or backwards: they ask for directions, of which each is known from fewer paths. What goes on almost straight does not count,
    /// [`Media::smoothed`], so that there are at most three times as many as where g is 0.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of paths")]
    pub fn for_media(self, media: &Media) -> Self {
        let turns = (1.0 / (1.0 - media.smoothed().most_forward())).min(MOST_TURNS);
        Self { paths: (self.paths as f32 * turns) as u32, ..self }
    }
}

/// Light probes of a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Probes {
    /// What is kept of the light.
    pub basis: Basis,
    /// About how many, where no distance is given.
    pub about: u32,
    /// Distance near surfaces, metres.
    pub spacing: Option<f32>,
    /// Paths from each.
    pub samples: u32,
}

/// Look-ups of lights and tables, which hardly anybody has to change.
#[derive(Clone, Debug, PartialEq)]
pub struct Tuning {
    /// How many of many lights a texel asks at once.
    pub light_samples: u32,
    /// Squared half diagonal over squared distance beyond which a node of lights is opened.
    pub light_threshold: f32,
    /// Radius of influence over spacing of the lighting grid hierarchy that holds lamps.
    pub direct_alpha: f32,
    /// File of response tables instead of the embedded ones.
    pub tables: Option<PathBuf>,
    /// Bands of zonal harmonics that responses have, 1 to 11.
    pub zh_order: usize,
    /// How what media emit is found.
    pub fire: FireBy,
}

/// How what media emit is found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum FireBy {
    /// By directions and by places chosen for it.
    #[default]
    Paths,
    /// By directions alone, to compare with.
    March,
    /// As many lights.
    Grid(FireOptions),
}

impl FireBy {
    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Paths => "paths",
            Self::March => "march",
            Self::Grid(_) => "grid",
        }
    }

    /// How it becomes many lights, if it does.
    #[must_use]
    pub fn grid(self) -> Option<FireOptions> {
        if let Self::Grid(options) = self { Some(options) } else { None }
    }
}

impl Default for Tuning {
    fn default() -> Self {
        Self {
            light_samples: SEVERAL,
            light_threshold: THRESHOLD,
            direct_alpha: lamp_grid::ALPHA,
            tables: None,
            zh_order: BANDS,
            fire: FireBy::Paths,
        }
    }
}

/// How many paths texels get.
#[derive(Clone, Debug, PartialEq)]
pub enum Sampling {
    /// This many in every texel.
    Exact(u32),
    /// This many on average, more where the variance is greater.
    Mean(u32),
    /// In rounds, after which there are this many on average, for each page; the last page's go for those
    /// behind it. Replays a time budget.
    Rounds(Vec<Vec<f32>>),
    /// Until the map's relative error is this.
    Target(f32),
    /// As many as the whole command's wall time allows, seconds.
    Budget(f64),
}

/// What becomes of participating media.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MediaMode {
    /// They are ignored.
    #[default]
    Off,
    /// They weaken light, and scatter none.
    Attenuate,
    /// They weaken it, and scatter it as if nothing bounded them.
    Table,
    /// They weaken it, and scatter it between walls: a grid of light in the media.
    Bounded,
    /// Unbiased paths scatter in them.
    Reference,
}

impl MediaMode {
    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Attenuate => "attenuate",
            Self::Table => "table",
            Self::Bounded => "bounded",
            Self::Reference => "reference",
        }
    }
}

/// What `lightmap-N.ktx2` holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TextureFormat {
    /// `BC6H_UFLOAT_BLOCK`: a byte a texel, with loss, no negative values.
    Bc6h,
    /// `R16G16B16A16_SFLOAT`: eight bytes a texel, half floats.
    Rgba16f,
}

impl TextureFormat {
    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bc6h => "bc6h",
            Self::Rgba16f => "rgba16f",
        }
    }
}

/// Whether and how well lightmaps are denoised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Denoise {
    /// They stay as they were gathered.
    #[default]
    Off,
    /// One small neighbourhood for all texels.
    Draft,
    /// Each texel has the neighbourhood that promises it the smallest error.
    Final,
}

impl Denoise {
    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::Draft => "draft",
            Self::Final => "final",
        }
    }
}

/// Resolved settings of a bake.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The preset that the rest was taken from.
    pub quality: Quality,
    /// Paths per texel that the irradiance cache is made for.
    pub samples: u32,
    /// Paths of texels.
    pub sampling: Sampling,
    /// Most reflections; `None`: Russian roulette ends paths.
    pub bounces: Option<u32>,
    /// Texels per metre; `None`: fitted onto one page of the preset's size.
    pub texels_per_metre: Option<f32>,
    /// Greatest side of a page, texels.
    pub max_size: u32,
    /// Empty texels around each chart.
    pub padding: u32,
    /// What happens to second texture coordinates of the file.
    pub unwrap: Unwrap,
    /// What flattens.
    pub engine: Engine,
    /// What becomes of media.
    pub media: MediaMode,
    /// How fine the light grid of media is.
    pub light_grid: Fineness,
    /// How direct light is sampled.
    pub direct: Direct,
    /// How lights and tables are looked up.
    pub tuning: Tuning,
    /// Paths per texel for the direction of light; `None` where it is not asked for.
    pub directional: Option<u32>,
    /// Light probes; `None` for none.
    pub probes: Option<Probes>,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Whether paths may end at an irradiance cache.
    pub irradiance_cache: bool,
    /// Whether direct and indirect light are also written apart.
    pub split_direct: bool,
    /// Format of textures beside the EXRs; `None`: there are none.
    pub texture: Option<TextureFormat>,
    /// Whether and how well lightmaps are denoised.
    pub denoise: Denoise,
    /// Whether seams are stitched.
    pub seams: bool,
    /// Kernels that were asked for by name.
    pub force: Force,
}

impl Settings {
    /// Paths in all of a bake with `covered` texels, where that is known beforehand.
    #[must_use]
    pub fn paths(&self, covered: u64) -> Option<u64> {
        match &self.sampling {
            Sampling::Exact(n) | Sampling::Mean(n) => Some(covered * u64::from(*n)),
            Sampling::Rounds(_) | Sampling::Target(_) | Sampling::Budget(_) => None,
        }
    }

    fn sampling(&self) -> (&'static str, Value) {
        match &self.sampling {
            Sampling::Exact(n) => ("samples", json!(n)),
            Sampling::Mean(n) => ("mean_samples", json!(n)),
            Sampling::Target(x) => ("target_error", json!(x)),
            // The manifest has those that were done: what replays a time budget.
            Sampling::Rounds(_) | Sampling::Budget(_) => ("rounds", Value::Null),
        }
    }

    /// Whether an irradiance cache is gathered. Its light has any number of reflections, so a limit of
    /// them rules it out.
    #[must_use]
    pub fn caches(&self) -> bool {
        self.irradiance_cache && self.bounces.is_none() && self.media != MediaMode::Reference
    }

    /// How fine the light grid of media is, if there is one.
    #[must_use]
    pub fn light_grid(&self) -> Option<Fineness> {
        (self.media == MediaMode::Bounded).then_some(self.light_grid)
    }

    /// How what media emit becomes many lights, if it does.
    #[must_use]
    pub fn fire(&self) -> Option<FireOptions> {
        self.tuning.fire.grid().filter(|_| matches!(self.media, MediaMode::Attenuate | MediaMode::Bounded))
    }

    pub(crate) fn atlas(&self) -> AtlasOptions {
        let density = match self.texels_per_metre {
            Some(d) => Density::Fixed(d),
            None => Density::Fit { page_size: self.quality.page_size().min(self.max_size) },
        };
        AtlasOptions {
            density,
            max_size: self.max_size,
            padding: self.padding,
            unwrap: self.unwrap,
            engine: self.engine,
        }
    }

    /// Name and value of every setting, for the manifest and `bake plan`.
    #[must_use]
    pub fn to_map(&self) -> Map<String, Value> {
        let unwrap = match self.unwrap {
            Unwrap::Keep => "keep",
            Unwrap::Auto => "auto",
            Unwrap::Always => "always",
        };
        let engine = match self.engine {
            Engine::Uvunwrap => "uvunwrap",
            #[cfg(feature = "xatlas")]
            Engine::Xatlas { .. } => "xatlas",
        };
        let pairs = [
            ("quality", json!(self.quality.name())),
            self.sampling(),
            ("bounces", json!(self.bounces)),
            ("texels_per_metre", json!(self.texels_per_metre)),
            ("max_size", json!(self.max_size)),
            ("padding", json!(self.padding)),
            ("unwrap", json!(unwrap)),
            ("unwrap_engine", json!(engine)),
            ("irradiance_cache", json!(self.caches())),
            ("direct", json!(self.direct.name())),
            ("light_samples", json!(self.tuning.light_samples)),
            ("light_threshold", json!(self.tuning.light_threshold)),
            ("direct_alpha", json!((self.direct == Direct::Grid).then_some(self.tuning.direct_alpha))),
            ("media", json!(self.media.name())),
            ("zh_order", json!((self.media == MediaMode::Table).then_some(self.tuning.zh_order))),
            ("fire", json!(self.tuning.fire.name())),
            ("fire_alpha", json!(self.fire().map(|f| f.alpha))),
            ("fire_depths", json!(self.fire().map(|f| f.depths))),
            ("fire_build", json!(self.fire().map(|f| f.build.name()))),
            ("fire_blend", json!(self.fire().map(|f| f.blend.name()))),
            ("grid_nodes", json!(self.light_grid().map(|f| f.nodes))),
            ("grid_paths", json!(self.light_grid().map(|f| f.paths))),
            ("grid_orders", json!(self.light_grid().and_then(|f| f.orders))),
            ("probes", json!(self.probes.map(|p| p.basis.name()))),
            ("probe_spacing", json!(self.probes.and_then(|p| p.spacing))),
            ("probe_count", json!(self.probes.filter(|p| p.spacing.is_none()).map(|p| p.about))),
            ("probe_samples", json!(self.probes.map(|p| p.samples))),
            ("directional", json!(self.directional)),
            ("split_direct", json!(self.split_direct)),
            ("texture", json!(self.texture.map_or("none", TextureFormat::name))),
            ("denoise", json!(self.denoise.name())),
            ("seams", json!(self.seams)),
        ];
        let force = (!self.force.texts().is_empty()).then(|| ("force", json!(self.force.texts())));
        pairs.into_iter().chain(force).map(|(k, v)| (k.to_owned(), v)).collect()
    }
}
