//! `manifest.json` and `timings.json`: what a bake wrote, and what it took.
//!
//! The manifest is deterministic: equal inputs and settings give equal bytes, so it holds no time,
//! no host and no thread count. Those are in [`Timings`].
//!
//! ```
//! use tables::format::manifest::Manifest;
//!
//! let mut manifest = Manifest::new("bake", "0.1.0");
//! manifest.seed = 7;
//! let text = manifest.to_json()?;
//! assert_eq!(Manifest::from_json(&text)?, manifest);
//! # Ok::<(), tables::format::manifest::ManifestError>(())
//! ```

use schemars::JsonSchema;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};

/// `format` of every manifest.
pub const FORMAT: &str = "bake-lightmaps";
/// `version` this build writes, and the newest it reads.
pub const VERSION: u32 = 1;
/// `format` of every timings file.
pub const TIMINGS_FORMAT: &str = "bake-timings";
/// What a lightmap texel holds: `E / pi`, the radiance of a white Lambertian surface, in nits.
pub const UNIT: &str = "radiance_white_lambert_nits";
/// Primaries and transfer of every colour.
pub const COLOR_SPACE: &str = "linear_rec709";
/// File name of a manifest within a bake's folder.
pub const FILE_NAME: &str = "manifest.json";
/// File name of the timings within a bake's folder.
pub const TIMINGS_FILE_NAME: &str = "timings.json";

/// Why a manifest cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum ManifestError {
    /// Not JSON, or not of the manifest's shape; line and column are in the text.
    #[error("not a valid {FORMAT} manifest: {0}")]
    Json(#[from] serde_json::Error),
    /// JSON that says it is something else, or nothing.
    #[error("`format` is {found}, expected \"{expected}\"")]
    Format {
        /// What the file says, as JSON; `missing` where it says nothing.
        found: String,
        /// The format that was to be read.
        expected: &'static str,
    },
    /// Written by a later release.
    #[error("version {found} is newer than {supported}, the newest this release reads: update the tool")]
    Newer {
        /// Version in the file.
        found: u64,
        /// Newest readable version.
        supported: u32,
    },
    /// `version` is missing or no positive integer.
    #[error("`version` is {0}, expected an integer from 1 on")]
    Version(String),
}

/// Contents of `manifest.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// Which program wrote this.
    pub tool: Tool,
    /// [`UNIT`].
    pub unit: String,
    /// [`COLOR_SPACE`].
    pub color_space: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Every file that was read, in the order it was met.
    pub inputs: Vec<Input>,
    /// Every resolved option by its long name, in the command line's order.
    pub settings: Map<String, Value>,
    /// Lightmap pages, `pages[n]` is `lightmap-n`.
    pub pages: Vec<Page>,
    /// What has texels, in the scene's order.
    pub surfaces: Vec<Surface>,
    /// Lights of the scene, also those that were not baked.
    pub lights: Vec<Light>,
    /// What rays saw that left the scene.
    pub sky: Sky,
    /// Findings about the input, in the order they were made.
    pub findings: Vec<Finding>,
    /// Paths traced; replaying with these counts gives the same bytes.
    pub samples: Samples,
    /// Error figure of the whole bake, before denoising.
    pub error: ErrorFigure,
    /// What more samples would not help against, where some texels were gathered without approximations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bias: Option<Bias>,
    /// What denoising did, where lightmaps were denoised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub denoised: Option<Denoised>,
    /// What had to be repaired or clamped.
    pub counts: Counts,
    /// What `preview.png` multiplied light by before tone mapping, 1/nit: 0.18 over the luminance of an average place.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<f32>,
    /// The camera that `preview.png` was drawn from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Camera>,
    /// Light in participating media, where it was found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light_grid: Option<LightGrid>,
    /// What fills the air, unless media were left out of the bake; empty where nothing scatters or absorbs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub media: Vec<Medium>,
    /// Seams between charts and what stitching did to them, if it was asked for. All errors and means elsewhere are
    /// those of the light before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seams: Option<Seams>,
    /// Volumes of light probes.
    #[serde(default)]
    pub probes: Vec<Probes>,
    /// Every other file of the folder but the timings, by name; the only files a later bake into
    /// the same folder replaces or removes.
    #[serde(default)]
    pub files: Vec<File>,
}

/// A program and its version.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Tool {
    /// Name.
    pub name: String,
    /// Semantic version.
    pub version: String,
}

/// A file that was read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Input {
    /// What it was read as, such as `scene`, `buffer`, `image`, `sky` or `config`.
    pub role: String,
    /// Path as it was given, or as the scene names it.
    pub path: String,
    /// BLAKE3 of its bytes, 64 hexadecimal digits.
    pub blake3: String,
    /// Length in bytes.
    pub bytes: u64,
}

/// One lightmap page.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Page {
    /// File name of the EXR.
    pub file: String,
    /// File name of the tone-mapped picture, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub preview: Option<String>,
    /// File name of the GPU-ready texture, where there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture: Option<String>,
    /// What that texture holds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture_figures: Option<Texture>,
    /// File name of the texture of the directions that light comes from, where they were asked for: half floats in three layers, x, y and z. A normal `m`
    /// beside the surface's own `n` has `E(m) / pi = texture + x (m - n).x + y (m - n).y + z (m - n).z`, in the scene's axes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub directions: Option<String>,
    /// What that texture holds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub directions_figures: Option<Texture>,
    /// Texels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Density of a surface without an override, texels per metre.
    pub texels_per_metre: f32,
    /// Texels that some chart covers at least in part.
    pub covered_texels: u64,
    /// Mean Rec. 709 luminance over covered texels, nits (of `E / pi`).
    pub mean_luminance: f64,
    /// Error figure of this page.
    pub error: ErrorFigure,
    /// What denoising did to this page, where it was denoised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub denoised: Option<Denoised>,
    /// How the standard errors were checked; none where too few texels are lit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub audit: Option<Audit>,
    /// Whether it was gathered without the irradiance cache although the settings have one, because that was off by more than the error that
    /// was asked for.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub uncached: bool,
}

/// A GPU-ready texture in comparison with the EXR of its page.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Texture {
    /// `bc6h_ufloat` or `rgba16f`.
    pub format: String,
    /// Length of the file.
    pub bytes: u64,
    /// Root mean squared difference of the three channels over covered texels, nits.
    pub rmse: f64,
    /// `rmse` over the page's mean luminance; absent where that is zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative_rmse: Option<f64>,
    /// Root mean squared difference of ln(luminance + a thousandth of its mean) over covered texels; absent where the mean is zero.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub log_rmse: Option<f64>,
    /// Values that the format cannot hold: beyond 65504 nits, not a number, or below 0 where it has no sign.
    pub clamped: u64,
}

/// Texels of about the same noise and how far their standard errors could be trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AuditClass {
    /// Greatest standard error before it was scaled, as a part of the texel's luminance.
    pub up_to: f64,
    /// Texels that were gathered again.
    pub audited: u64,
    /// By what standard errors were multiplied, so that 95 % intervals hold for 95 % of these.
    pub factor: f64,
}

/// Texels of a page that were gathered again without shortcuts, and what that said.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Audit {
    /// Texels by how noisy they are, from the smoothest to the noisiest.
    pub classes: Vec<AuditClass>,
    /// Mean luminance of the map minus that of the audit, nits.
    pub bias: f64,
    /// Standard error of `bias`, nits.
    pub bias_std_err: f64,
    /// Where an error was asked for: mean squared error of texels that were gathered again for it, as a part of what their standard
    /// errors say; the page's `error` contains its root.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub squares: Option<f64>,
}

/// The map before denoising against some of its texels gathered by unbiased paths: media, cache and limits of reflections approximate nothing
/// there. Luminances as parts of the mean of these texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Bias {
    /// Texels that were gathered.
    pub texels: u64,
    /// Mean difference of the map from them.
    pub mean: f64,
    /// Its standard error.
    pub mean_std_err: f64,
    /// Root mean squared difference without the noise of both.
    pub rms: f64,
    /// The same with two standard errors of its square on top.
    pub rms_at_most: f64,
    /// Root mean square of the noise of both.
    pub noise: f64,
}

/// Standard errors over covered texels, before denoising.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ErrorFigure {
    /// Root of the mean squared standard error of luminance, nits (of `E / pi`).
    pub rms_std_err: f64,
    /// `rms_std_err` over the mean luminance; absent where the mean is zero or nothing is covered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative: Option<f64>,
    /// Largest standard error of luminance of one texel, nits.
    pub max_std_err: f64,
}

/// What denoising did to covered texels.
///
/// The error is an estimate of the root mean squared error that is left, noise and blur together; the pages
/// hold it per texel as `rmse`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Denoised {
    /// Estimated root mean squared error of luminance, nits (of `E / pi`).
    pub rms_error: f64,
    /// `rms_error` over the mean luminance; absent where the mean is zero or nothing is covered.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative: Option<f64>,
    /// Largest estimated error of luminance of one texel, nits.
    pub max_error: f64,
    /// Part of the texels whose luminance changed by more than three of their standard errors.
    pub changed: f64,
}

/// Where one surface's texels are.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Surface {
    /// glTF node index in the input.
    pub node: usize,
    /// Node names from the root, such as `hall/column.3`.
    pub path: String,
    /// Index within the node's `EXT_mesh_gpu_instancing` instances, if it has them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu_instance: Option<usize>,
    /// glTF mesh index in the input.
    pub mesh: usize,
    /// Primitive index within the mesh.
    pub primitive: usize,
    /// Index into [`Manifest::pages`].
    pub page: usize,
    /// Rectangle on the page; row 0 is the top.
    pub rect: Rect,
    /// The same rectangle in [0, 1], the convention of glTF texture coordinates.
    pub uv_rect: UvRect,
    /// Density, texels per metre.
    pub texels_per_metre: f32,
    /// Whether the input's own second UV set was kept.
    pub kept_uvs: bool,
}

/// A rectangle of texels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Rect {
    /// Left-most column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Rect {
    /// This rectangle in units of a page of `width` by `height` texels (both at least 1). On pages of up to 16384 texels it stays within an eighth of a texel
    /// of its place when it is rounded to multiples of 1/65535, as Bevy does.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
    pub fn to_uv(self, width: u32, height: u32) -> UvRect {
        let part = |n: u32, of: u32| (f64::from(n) / f64::from(of.max(1))) as f32;
        UvRect {
            min: [part(self.x, width), part(self.y, height)],
            max: [part(self.x + self.width, width), part(self.y + self.height, height)],
        }
    }
}

/// A rectangle in texture coordinates; (0, 0) is the top left of the page.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UvRect {
    /// Top left.
    pub min: [f32; 2],
    /// Bottom right.
    pub max: [f32; 2],
}

/// A camera of the scene, or one that was found for it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Camera {
    /// Name in the scene, or `chosen`.
    pub name: String,
    /// Columns of the matrix from its space to the world, metres; it looks along -Z, +Y is up.
    pub world_from_camera: [[f32; 4]; 4],
    /// What it covers.
    pub projection: Projection,
}

/// What a [`Camera`] covers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Projection {
    /// Pinhole.
    Perspective {
        /// Full vertical angle, radians.
        yfov: f32,
        /// Width over height.
        aspect: f32,
    },
    /// Parallel.
    Orthographic {
        /// Half width, metres.
        xmag: f32,
        /// Half height, metres.
        ymag: f32,
    },
}

impl Default for Projection {
    fn default() -> Self {
        Self::Orthographic { xmag: 1.0, ymag: 1.0 }
    }
}

/// Light at the nodes of a lattice, a texture that fog shaders sample.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct LightGrid {
    /// File name of the texture.
    pub file: String,
    /// File name of a second texture like it, without what lamps and suns bring straight away; absent where none of them is baked, so that both would be
    /// the same. For games that add lamps to their fog themselves, with shadow maps.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub indirect: Option<String>,
    /// Nodes along x, y and z.
    pub size: [u32; 3],
    /// Slices of one of the texture's seven blocks along z.
    pub slices: u32,
    /// Where the first node is, metres in the scene's axes.
    pub first: [f32; 3],
    /// Distances of nodes along x, y and z, metres.
    pub cell: [f32; 3],
    /// Nodes inside of solid things, which hold nothing.
    pub inside: u64,
    /// Values too great for a half float, in both files.
    pub clamped: u64,
}

/// A participating medium: its coefficients are sigma times the density at a place, which is the product of all that follows.
///
/// Where media overlap, coefficients add, and the mean cosine is the mean of theirs weighed by scattering. Places are metres in the scene's axes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Medium {
    /// Where it stands in the scene.
    pub path: String,
    /// Scattering where the density is 1, per metre; at least 0.
    pub sigma_s: [f32; 3],
    /// Absorption where the density is 1, per metre; at least 0.
    pub sigma_a: [f32; 3],
    /// What it emits where the density is 1, nits per metre; at least 0. The light of it on surfaces and probes is baked, what one sees of it is not.
    #[serde(default, skip_serializing_if = "is_black")]
    pub emission: [f32; 3],
    /// Mean cosine of scattering (Henyey-Greenstein), between -1 and 1.
    pub g: f32,
    /// The affine map from the world to the cube \[0, 1\]^3 that the medium is in, outside of which the density is 0: the three columns of its matrix, then the
    /// translation. Absent: it is everywhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit_from_world: Option<[[f32; 3]; 4]>,
    /// Density that falls with height.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<HeightDensity>,
    /// Density as a texture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture: Option<DensityTexture>,
}

fn is_black(light: &[f32; 3]) -> bool {
    *light == [0.0; 3]
}

/// The density exp(-(y - base) / falloff) at the height y.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct HeightDensity {
    /// Where it is 1, metres.
    pub base: f32,
    /// Over which it falls by a factor of e, metres; above 0.
    pub falloff: f32,
}

/// The density of a [`Medium`] in a three-dimensional texture of one channel of half floats: means over texels.
///
/// Texel i lies at (i + 0.5) / size along each axis of the cube that `unit_from_world` leads to. A linear filter that repeats texels at the border keeps the medium's mass;
/// outside of the cube the density is 0.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DensityTexture {
    /// File name: `medium-N.ktx2`, N is the index in [`Manifest::media`].
    pub file: String,
    /// Texels along the three axes of the cube, 1 to 128 each.
    pub size: [u32; 3],
    /// The affine map from the world to the cube \[0, 1\]^3 of the texture, as [`Medium::unit_from_world`].
    pub unit_from_world: [[f32; 3]; 4],
    /// Values too great for a half float, which are 65504.
    pub clamped: u64,
}

/// What coefficients of probes mean.
pub const PROBE_CONVENTION: &str = "incident radiance in nits; real orthonormal spherical harmonics without the Condon-Shortley phase, index \
     l(l+1)+m: 1, y, z, x, xy, yz, 3z^2-1, xz, x^2-y^2, ...; directions point away from the probe; zh3 has bands 0 and 1 and one \
     coefficient of band 2 about the axis of the luminance of band 1";

/// A volume of light probes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Probes {
    /// File name; its layout is that of `tables::probes`.
    pub file: String,
    /// `l1`, `l2`, `l3` or `zh3`.
    pub basis: String,
    /// Coefficients of a probe for each colour channel.
    pub coefficients: usize,
    /// [`PROBE_CONVENTION`].
    pub convention: String,
    /// First corner of the lattice, metres in the scene's axes.
    pub origin: [f32; 3],
    /// Side of its smallest cells, metres.
    pub spacing: f32,
    /// Its size along x, y and z in smallest bricks of 4 x 4 x 4 cells.
    pub size: [u32; 3],
    /// Sizes of bricks.
    pub levels: u32,
    /// Bricks.
    pub bricks: usize,
    /// Probes.
    pub probes: usize,
    /// Those in walls, which hold the light of their neighbours.
    pub invalid: u64,
    /// Those that were moved out of walls or off surfaces.
    pub moved: u64,
    /// Those of single regions of cells, which no corner of the lattice sees.
    pub own: u64,
    /// Those that were windowed so that no irradiance is negative.
    pub windowed: u64,
    /// Paths of each probe.
    pub samples: u32,
    /// Samples that were NaN or infinite and were replaced by black.
    pub rejected_samples: u64,
    /// Mean luminance over all directions and valid probes, nits.
    pub mean_luminance: f64,
    /// Standard errors of that, probe by probe.
    pub error: ErrorFigure,
    /// The same light in an even grid, for engines that take no bricks.
    pub grid: ProbeGrid,
}

/// Light of probes in an even grid of voxels.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ProbeGrid {
    /// File name of Bevy's irradiance volume: `E / pi` of six normals, nits.
    pub irradiance_volume: String,
    /// File name of the atlas of three.js' light probe grid: nine coefficients of radiance, nits.
    pub harmonics: String,
    /// Voxels along x, y and z; light is that of their centres.
    pub size: [u32; 3],
    /// Middle of the grid, metres in the scene's axes.
    pub centre: [f32; 3],
    /// Its edges along x, y and z, metres: the scale of an entity with a unit cube.
    pub extent: [f32; 3],
    /// Values too great for a half float, in both files.
    pub clamped: u64,
}

/// Edges where a surface goes on at another place of the atlas.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Seams {
    /// Pairs of edges, or of parts of edges, that were stitched.
    pub pairs: u64,
    /// Their length, metres.
    pub length: f64,
    /// Places along them that were compared, at least two a texel.
    pub places: u64,
    /// Texels that filters read there, gutter included; only they change.
    pub texels: u64,
    /// Steps across them before.
    pub before: SeamFilters,
    /// Steps across them after.
    pub after: SeamFilters,
    /// Mean luminance of covered texels after minus before, over that before.
    pub mean_change: f64,
}

/// Steps across seams by what reads the texture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SeamFilters {
    /// A bilinear filter.
    pub bilinear: SeamSteps,
    /// A bicubic filter (B-spline).
    pub bicubic: SeamSteps,
}

/// Differences of luminance between both sides of seams.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct SeamSteps {
    /// Root of the mean square in units of the texels' standard error there, over the seams' length on the pages; places
    /// without noise are left out.
    pub rms_noise: f64,
    /// The greatest in these units.
    pub max_noise: f64,
    /// Root of the mean square as a part of the luminance there.
    pub rms_relative: f64,
    /// The greatest as a part of the luminance there.
    pub max_relative: f64,
}

/// One light and what was baked of it.
///
/// A lamp of the intensity I brings I w a / d^2 lux to a surface at the distance d that faces it. w is 1 - (d / range)^4, not below 0, or 1 without a
/// range. Where rays leave the lamp at the angle t to its direction, a is the square of (cos t - cos outer) / (cos inner - cos outer), which is cut to 0 ... 1 and
/// whose divisor is at least 0.001; 1 without a cone. A directional light brings its intensity everywhere. Numbers are those that were baked, after `--light-units`;
/// emissive surfaces have none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Light {
    /// Node names from the root.
    pub path: String,
    /// Index of the node in `scene.glb`; absent for lamps that are not in the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<usize>,
    /// `point`, `spot`, `directional`, `emissive`, or what a later version adds.
    pub kind: String,
    /// What was baked.
    pub mode: LightMode,
    /// Where it is, metres in the scene's axes; of points and spots.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position: Option<[f32; 3]>,
    /// Unit vector that its light travels along; of spots and directional lights.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub direction: Option<[f32; 3]>,
    /// Linear Rec. 709, at least 0: candela of a point, candela on the axis of a spot, lux of a directional light on a surface that faces it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub intensity: Option<[f32; 3]>,
    /// Where its light ends, metres, above 0; absent: nowhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<f32>,
    /// Angles between a spot's direction and where its fall-off begins and ends, radians, 0 to pi / 2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cone: Option<[f32; 2]>,
}

/// Which part of a light was baked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum LightMode {
    /// Direct and indirect light.
    #[default]
    Baked,
    /// Indirect light only.
    Mixed,
    /// Nothing.
    Dynamic,
}

/// What rays saw that left the scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Sky {
    /// No light.
    #[default]
    Black,
    /// The same from everywhere.
    Uniform {
        /// Nits.
        radiance: [f32; 3],
    },
    /// Linear in the sine of elevation.
    Gradient {
        /// Nits, straight up.
        zenith: [f32; 3],
        /// Nits, at the horizon.
        horizon: [f32; 3],
        /// Nits, straight down.
        ground: [f32; 3],
    },
    /// Equirectangular image; its file is among the inputs.
    Image {
        /// Path as it was given.
        path: String,
        /// File name of the image within the folder: half floats `R G B`, nits, at most 65504, not more than 2048 columns. It is in sky space: the top row is +Y, the
        /// middle column looks along -Z, and +X is a quarter of the width to its right. `scale` is applied, `rotation` is not.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        file: Option<String>,
        /// Multiplier from the file's values to nits.
        scale: f32,
        /// Quaternion x, y, z, w from sky space to world.
        rotation: [f32; 4],
    },
}

/// A finding about the input.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Finding {
    /// `note`, `warning` or `error`.
    pub severity: String,
    /// Place in the input.
    pub path: String,
    /// What is wrong.
    pub what: String,
    /// What the author can do.
    pub fix: String,
}

/// Paths per covered texel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Samples {
    /// Paths in all.
    pub total: u64,
    /// Fewest in a covered texel; standard errors have at least `min - 1` degrees of freedom.
    pub min: u64,
    /// Mean over covered texels.
    pub mean: f64,
    /// Most in a covered texel.
    pub max: u64,
}

/// What had to be repaired or clamped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Counts {
    /// Samples that were NaN or infinite and were replaced by black.
    pub rejected_samples: u64,
    /// Values beyond half-float range that were clamped in a half-float file.
    pub half_overflows: u64,
    /// Covered texels inside other geometry, filled from valid ones of their chart.
    pub filled_texels: u64,
    /// Charts without any valid texel; they stay black.
    pub black_charts: u64,
}

/// A file of the folder.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct File {
    /// Name within the folder.
    pub name: String,
    /// Length in bytes.
    pub bytes: u64,
}

impl Manifest {
    /// A manifest with nothing in it yet.
    #[must_use]
    pub fn new(tool: &str, tool_version: &str) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            tool: Tool { name: tool.to_owned(), version: tool_version.to_owned() },
            unit: UNIT.to_owned(),
            color_space: COLOR_SPACE.to_owned(),
            seed: 0,
            inputs: Vec::new(),
            settings: Map::new(),
            pages: Vec::new(),
            surfaces: Vec::new(),
            lights: Vec::new(),
            sky: Sky::Black,
            findings: Vec::new(),
            samples: Samples::default(),
            error: ErrorFigure::default(),
            bias: None,
            denoised: None,
            counts: Counts::default(),
            exposure: None,
            camera: None,
            light_grid: None,
            media: Vec::new(),
            seams: None,
            probes: Vec::new(),
            files: Vec::new(),
        }
    }

    /// Indented JSON with a final line break.
    ///
    /// # Errors
    /// [`ManifestError::Json`] where a number is not finite: JSON has no word for it.
    pub fn to_json(&self) -> Result<String, ManifestError> {
        write(self)
    }

    /// JSON schema (draft 2020-12) of what [`Manifest::to_json`] writes, indented, with a final line break.
    #[must_use]
    pub fn schema() -> String {
        let mut text = serde_json::to_string_pretty(&schemars::schema_for!(Self)).unwrap_or_default();
        text.push('\n');
        text
    }

    /// Reads what [`Manifest::to_json`] wrote, by this or an earlier release.
    ///
    /// # Errors
    /// Text that is no JSON, is another format, or comes from a newer release.
    pub fn from_json(text: &str) -> Result<Self, ManifestError> {
        read(text, FORMAT)
    }
}

/// Contents of `timings.json`: what a bake took, different in every run.
///
/// ```
/// use tables::format::manifest::{Stage, Timings};
///
/// let mut timings = Timings::new();
/// timings.stages.push(Stage { name: "load".into(), wall_seconds: 0.1, cpu_seconds: 0.3 });
/// assert_eq!(Timings::from_json(&timings.to_json()?)?, timings);
/// # Ok::<(), tables::format::manifest::ManifestError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Timings {
    /// [`TIMINGS_FORMAT`].
    pub format: String,
    /// [`VERSION`].
    pub version: u32,
    /// Seconds per stage, in the order they ran.
    pub stages: Vec<Stage>,
    /// Wall seconds of the whole command.
    pub wall_seconds: f64,
    /// CPU seconds (user and system, all threads) of the whole command.
    pub cpu_seconds: f64,
    /// Rays traced, of all kinds.
    pub rays: u64,
    /// Paths traced.
    pub paths: u64,
    /// Largest resident set, bytes.
    pub peak_memory_bytes: u64,
    /// Worker threads.
    pub threads: usize,
    /// Model name of the processor; empty where unknown.
    pub cpu: String,
}

/// What one stage took.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Stage {
    /// Name of the stage.
    pub name: String,
    /// Wall seconds.
    pub wall_seconds: f64,
    /// CPU seconds, all threads.
    pub cpu_seconds: f64,
}

impl Timings {
    /// Timings with nothing in them yet.
    #[must_use]
    pub fn new() -> Self {
        Self {
            format: TIMINGS_FORMAT.to_owned(),
            version: VERSION,
            stages: Vec::new(),
            wall_seconds: 0.0,
            cpu_seconds: 0.0,
            rays: 0,
            paths: 0,
            peak_memory_bytes: 0,
            threads: 0,
            cpu: String::new(),
        }
    }

    /// Indented JSON with a final line break.
    ///
    /// # Errors
    /// [`ManifestError::Json`] where a number is not finite.
    pub fn to_json(&self) -> Result<String, ManifestError> {
        write(self)
    }

    /// Reads what [`Timings::to_json`] wrote.
    ///
    /// # Errors
    /// As [`Manifest::from_json`].
    pub fn from_json(text: &str) -> Result<Self, ManifestError> {
        read(text, TIMINGS_FORMAT)
    }
}

impl Default for Timings {
    fn default() -> Self {
        Self::new()
    }
}

/// `serde_json` writes NaN as `null` without a word, so the text is only accepted if it reads back.
fn write<T: Serialize + DeserializeOwned>(value: &T) -> Result<String, ManifestError> {
    let mut text = serde_json::to_string_pretty(value)?;
    serde_json::from_str::<T>(&text)?;
    text.push('\n');
    Ok(text)
}

/// Format and version are judged before the rest, so that a file of another kind is named as such
/// and not by the first field it lacks.
fn read<T: DeserializeOwned>(text: &str, expected: &'static str) -> Result<T, ManifestError> {
    let value: Value = serde_json::from_str(text)?;
    let missing = || "missing".to_owned();
    match value.get("format") {
        Some(Value::String(format)) if format == expected => {}
        other => {
            return Err(ManifestError::Format {
                found: other.map_or_else(missing, Value::to_string),
                expected,
            });
        }
    }
    match value.get("version").and_then(Value::as_u64) {
        Some(found) if u64::from(VERSION) < found => {
            return Err(ManifestError::Newer { found, supported: VERSION });
        }
        Some(1..) => {}
        _ => return Err(ManifestError::Version(value.get("version").map_or_else(missing, Value::to_string))),
    }
    Ok(serde_json::from_value(value)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full() -> Manifest {
        let mut m = Manifest::new("bake", "0.1.0");
        m.seed = u64::MAX;
        m.inputs.push(Input {
            role: "scene".into(),
            path: "a b/ä.gltf".into(),
            blake3: "00".repeat(32),
            bytes: 9,
        });
        m.settings.insert("samples".into(), 64.into());
        m.settings.insert("media".into(), Value::Null);
        m.pages.push(Page {
            file: "lightmap-0.exr".into(),
            preview: Some("lightmap-0.png".into()),
            texture: Some("lightmap-0.ktx2".into()),
            directions: Some("lightmap-0.sh1.ktx2".into()),
            directions_figures: None,
            texture_figures: Some(Texture {
                format: "bc6h_ufloat".into(),
                bytes: 9,
                rmse: 0.25,
                relative_rmse: Some(2.5),
                log_rmse: None,
                clamped: 3,
            }),
            width: 512,
            height: 256,
            texels_per_metre: 12.3,
            covered_texels: 77,
            mean_luminance: 0.1,
            error: ErrorFigure { rms_std_err: 1e-3, relative: Some(1e-2), max_std_err: 0.3 },
            denoised: Some(Denoised { rms_error: 4e-4, relative: Some(4e-3), max_error: 0.2, changed: 0.01 }),
            audit: Some(Audit {
                classes: vec![AuditClass { up_to: 0.5, audited: 128, factor: 0.75 }],
                bias: -0.5,
                squares: None,
                bias_std_err: 0.25,
            }),
            uncached: false,
        });
        let rect = Rect { x: 4, y: 8, width: 12, height: 20 };
        m.surfaces.push(Surface {
            node: 3,
            path: "hall/column.3".into(),
            gpu_instance: Some(1),
            mesh: 2,
            primitive: 1,
            page: 0,
            rect,
            uv_rect: rect.to_uv(512, 256),
            texels_per_metre: 12.3,
            kept_uvs: true,
        });
        m.lights.push(Light {
            path: "sun".into(),
            node: Some(3),
            kind: "directional".into(),
            mode: LightMode::Mixed,
            direction: Some([0.0, -1.0, 0.0]),
            intensity: Some([1e5, 9e4, 0.1]),
            ..Light::default()
        });
        m.media.push(Medium {
            path: "air".into(),
            sigma_s: [0.1, 0.2, 0.3],
            g: 0.7,
            unit_from_world: Some([[1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.1], [0.5; 3]]),
            height: Some(HeightDensity { base: -1.0, falloff: 2.5 }),
            texture: Some(DensityTexture {
                file: "medium-0.ktx2".into(),
                size: [128, 1, 7],
                ..DensityTexture::default()
            }),
            ..Medium::default()
        });
        m.sky = Sky::Gradient { zenith: [0.1, 0.2, 0.3], horizon: [1.0; 3], ground: [0.0; 3] };
        let steps = SeamSteps { rms_noise: 1.5, max_noise: 4.0, rms_relative: 0.25, max_relative: 0.5 };
        let filters = SeamFilters { bilinear: steps, bicubic: SeamSteps::default() };
        m.seams = Some(Seams {
            pairs: 3,
            length: 4.5,
            places: 70,
            texels: 200,
            before: filters,
            ..Seams::default()
        });
        m.findings.push(Finding { severity: "warning".into(), ..Finding::default() });
        m.samples = Samples { total: 640, min: 8, mean: 8.3, max: 16 };
        m.counts.rejected_samples = 1;
        m.camera = Some(Camera {
            name: "above".into(),
            projection: Projection::Perspective { yfov: 0.9, aspect: 1.5 },
            ..Camera::default()
        });
        m.files.push(File { name: "lightmap-0.exr".into(), bytes: 4 });
        m
    }

    #[test]
    fn round_trip_keeps_everything_and_every_byte() -> Result<(), ManifestError> {
        for m in [Manifest::new("bake", "0.1.0"), full()] {
            let text = m.to_json()?;
            let back = Manifest::from_json(&text)?;
            assert_eq!(back, m);
            assert_eq!(back.to_json()?, text);
        }
        Ok(())
    }

    /// Bevy sends rectangles as 16-bit fractions, `round(65535 x)`; a shader that multiplies by the page's size has to find the texel again.
    #[test]
    fn rectangles_survive_sixteen_bits() {
        for size in [1, 3, 4, 30, 416, 2048, 4095, 4096, 8192, 12345, 16383, 16384] {
            let mut worst = 0.0f64;
            for n in 0..=size {
                let rect = Rect { x: n, y: size - n, width: size - n, height: n };
                let uv = rect.to_uv(size, size);
                for (part, texel) in
                    [(uv.min[0], n), (uv.min[1], size - n), (uv.max[0], size), (uv.max[1], size)]
                {
                    assert!((0.0..=1.0).contains(&part));
                    let sent = (f64::from(part) * 65535.0).round() / 65535.0;
                    let back = sent * f64::from(size);
                    assert_eq!(back.round(), f64::from(texel), "{texel} of {size}");
                    worst = worst.max((back - f64::from(texel)).abs());
                }
            }
            // Half of a step of 1/65535, and what single precision rounds: an eighth of a texel, which two rings of gutter hide.
            assert!(worst <= f64::from(size) * (0.5 / 65535.0 + 1e-7), "{size}: {worst}");
        }
    }

    #[test]
    fn settings_keep_their_order() -> Result<(), ManifestError> {
        let mut m = Manifest::new("bake", "0.1.0");
        for key in ["z", "a", "m"] {
            m.settings.insert(key.into(), true.into());
        }
        let back = Manifest::from_json(&m.to_json()?)?;
        assert_eq!(back.settings.keys().collect::<Vec<_>>(), ["z", "a", "m"]);
        Ok(())
    }

    #[test]
    fn an_unknown_field_of_the_same_version_is_passed_over() -> Result<(), ManifestError> {
        let text = full().to_json()?.replacen('{', "{ \"later\": [1],", 1);
        assert_eq!(Manifest::from_json(&text)?, full());
        Ok(())
    }

    #[test]
    fn rejects_what_it_cannot_read() -> Result<(), ManifestError> {
        let text = full().to_json()?;
        let message = |text: &str| match Manifest::from_json(text) {
            Ok(_) => "accepted".to_owned(),
            Err(e) => e.to_string(),
        };
        assert_eq!(
            message(&text.replace(FORMAT, "godot")),
            "`format` is \"godot\", expected \"bake-lightmaps\""
        );
        assert_eq!(message("{}"), "`format` is missing, expected \"bake-lightmaps\"");
        assert_eq!(message("[1]"), "`format` is missing, expected \"bake-lightmaps\"");
        let version = format!("\"version\": {VERSION}");
        assert!(message(&text.replacen(&version, "\"version\": 2", 1)).contains("version 2 is newer than 1"));
        assert_eq!(
            message(&text.replacen(&version, "\"version\": 0", 1)),
            "`version` is 0, expected an integer from 1 on"
        );
        assert_eq!(
            message(&text.replacen(&version, "\"version\": -1", 1)),
            "`version` is -1, expected an integer from 1 on"
        );
        assert!(message(&text[..text.len() / 2]).contains("not a valid"));
        assert!(message(&text.replacen("\"seed\"", "\"speed\"", 1)).contains("missing field `seed`"));
        Ok(())
    }

    #[test]
    fn a_number_that_is_not_finite_cannot_be_written() {
        let mut m = full();
        m.error.rms_std_err = f64::NAN;
        assert!(matches!(m.to_json(), Err(ManifestError::Json(_))));
    }

    #[test]
    fn timings_are_told_from_manifests() -> Result<(), ManifestError> {
        let t = Timings::new();
        assert_eq!(Timings::from_json(&t.to_json()?)?, t);
        assert!(matches!(Timings::from_json(&full().to_json()?), Err(ManifestError::Format { .. })));
        Ok(())
    }
}
