//! Fills the manifest.

use crate::error::Finding;
use crate::geom::atlas::Unwrap;
use crate::output::denoise::DenoiseStats;
use crate::output::dilate::Filled;
use crate::output::page::PageStats;
use crate::output::sky;
use crate::output::texture;
use crate::output::view;
use crate::plan::Plan;
use crate::plan::settings::TextureFormat;
use crate::scene::document::InputFile;
use crate::scene::model::{Camera, LightKind, LightMode, Projection, Sky};
use crate::solve::accumulate::Gate;
use glam::Vec3;
use tables::format::manifest::{self, Counts, Input, Manifest, Rect, Samples};

/// File of page `n`.
#[must_use]
pub fn page_file(n: usize) -> String {
    format!("lightmap-{n}.exr")
}

/// GPU-ready texture of page `n`.
#[must_use]
pub fn texture_file(n: usize) -> String {
    format!("lightmap-{n}.ktx2")
}

/// GPU-ready directions of page `n`.
#[must_use]
pub fn directions_file(n: usize) -> String {
    format!("lightmap-{n}.sh1.ktx2")
}

/// Tone-mapped picture of page `n`.
#[must_use]
pub fn preview_file(n: usize) -> String {
    format!("lightmap-{n}.png")
}

/// Picture of the relative standard error of page `n`.
#[must_use]
pub fn error_file(n: usize) -> String {
    format!("lightmap-{n}.stderr.png")
}

/// What the manifest says of one page.
#[derive(Clone, Debug)]
pub struct PageFigures {
    /// Sums over its texels.
    pub stats: PageStats,
    /// What denoising did, if it was asked for.
    pub denoised: Option<DenoiseStats>,
    /// What was filled.
    pub filled: Filled,
    /// Paths of its covered texels.
    pub samples: Samples,
    /// Mean paths per texel after each round, where rounds were planned by them.
    pub rounds: Vec<f32>,
    /// Whether it does without the irradiance cache that other pages may have.
    pub uncached: bool,
    /// What the audit said.
    pub audit: Option<crate::solve::audit::Audit>,
    /// What its texture holds, if there is one.
    pub texture: Option<texture::Figures>,
    /// The same of the directions of its light.
    pub directions: Option<texture::Figures>,
}

/// The manifest of a finished bake; the files themselves are listed by the folder.
#[must_use]
pub fn manifest(plan: &Plan, inputs: &[InputFile], pages: &[PageFigures], gate: &Gate) -> Manifest {
    let total = pages.iter().fold(PageStats::default(), |s, p| s.merge(p.stats));
    let mut m = Manifest::new("bake", env!("CARGO_PKG_VERSION"));
    m.seed = plan.settings().seed;
    m.inputs = inputs.iter().map(input).collect();
    m.settings = plan.settings().to_map();
    m.settings.insert(METALS_BLACK.to_owned(), plan.scene().metals_black.into());
    m.pages = pages.iter().enumerate().map(|(i, p)| page(plan, i, p)).collect();
    m.surfaces = surfaces(plan);
    m.lights = lights(plan);
    m.sky = sky_of(&plan.scene().sky, inputs);
    m.findings = plan.findings().iter().map(finding).collect();
    if pages.iter().any(|p| !p.rounds.is_empty()) {
        m.settings.insert("rounds".to_owned(), pages.iter().map(|p| p.rounds.clone()).collect());
    }
    let paths: u64 = pages.iter().map(|p| p.samples.total).sum();
    m.samples = Samples {
        total: paths,
        min: pages.iter().map(|p| p.samples.min).min().unwrap_or(0),
        mean: paths as f64 / total.covered.max(1) as f64,
        max: pages.iter().map(|p| p.samples.max).max().unwrap_or(0),
    };
    m.error = total.error();
    m.denoised = pages.iter().filter_map(|p| p.denoised).reduce(DenoiseStats::merge).map(|d| d.figures());
    m.counts = Counts {
        rejected_samples: gate.rejected,
        half_overflows: pages
            .iter()
            .flat_map(|p| [p.texture, p.directions])
            .flatten()
            .map(|t| t.overflows)
            .sum(),
        filled_texels: pages.iter().map(|p| p.filled.filled).sum(),
        black_charts: pages.iter().map(|p| p.filled.black_charts).sum(),
    };
    m
}

/// What the manifest says of texels that were gathered without approximations.
#[must_use]
pub fn bias(f: crate::solve::bias::Figures) -> manifest::Bias {
    manifest::Bias {
        texels: f.texels as u64,
        mean: f.mean,
        mean_std_err: f.mean_std_err,
        rms: f.rms,
        rms_at_most: f.rms_at_most,
        noise: f.noise,
    }
}

/// What the manifest says of the camera of a picture.
#[must_use]
pub fn camera(camera: &Camera) -> manifest::Camera {
    manifest::Camera {
        name: camera.name.clone(),
        world_from_camera: camera.world_from_camera.to_cols_array_2d(),
        projection: match camera.projection {
            Projection::Perspective { yfov, .. } => {
                manifest::Projection::Perspective { yfov, aspect: view::aspect(camera) }
            }
            Projection::Orthographic { xmag, ymag } => manifest::Projection::Orthographic { xmag, ymag },
        },
    }
}

/// Name among the manifest's settings of whether metals have no albedo, which the scene's words say.
pub const METALS_BLACK: &str = "metals_black";

fn page(plan: &Plan, number: usize, figures: &PageFigures) -> manifest::Page {
    let size = plan.atlas().pages[number];
    let texture = figures.texture.zip(plan.settings().texture);
    manifest::Page {
        file: page_file(number),
        preview: Some(preview_file(number)),
        texture: texture.map(|_| texture_file(number)),
        texture_figures: texture.map(|(figures, format)| figures.record(format)),
        directions: figures.directions.map(|_| directions_file(number)),
        directions_figures: figures.directions.map(|f| f.record(TextureFormat::Rgba16f)),
        width: size.width,
        height: size.height,
        texels_per_metre: plan.atlas().texels_per_metre,
        covered_texels: figures.stats.covered,
        mean_luminance: figures.stats.mean_luminance(),
        error: figures.stats.error(),
        denoised: figures.denoised.map(|d| d.figures()),
        uncached: figures.uncached,
        audit: figures.audit.as_ref().map(|a| manifest::Audit {
            classes: a
                .classes
                .iter()
                .map(|c| manifest::AuditClass { up_to: c.up_to, audited: c.audited as u64, factor: c.factor })
                .collect(),
            bias: a.bias,
            bias_std_err: a.bias_std_err,
            squares: a.squares,
        }),
    }
}

fn surfaces(plan: &Plan) -> Vec<manifest::Surface> {
    let (scene, atlas) = (plan.scene(), plan.atlas());
    let mut list = Vec::new();
    for (s, placement) in scene.surfaces.iter().zip(&atlas.placements) {
        let Some(p) = placement else { continue };
        let size = atlas.pages[p.page];
        let rect = Rect { x: p.min[0], y: p.min[1], width: p.size[0], height: p.size[1] };
        let (mesh, primitive) = scene.meshes[s.mesh].source;
        list.push(manifest::Surface {
            node: s.node,
            path: s.path.clone(),
            gpu_instance: s.gpu_instance,
            mesh,
            primitive,
            page: p.page,
            rect,
            uv_rect: rect.to_uv(size.width, size.height),
            texels_per_metre: p.texels_per_metre,
            kept_uvs: atlas.layouts[p.layout].kept && plan.settings().unwrap != Unwrap::Always,
        });
    }
    list
}

fn lights(plan: &Plan) -> Vec<manifest::Light> {
    let scene = plan.scene();
    let mode = |m| match m {
        LightMode::Baked => manifest::LightMode::Baked,
        LightMode::Mixed => manifest::LightMode::Mixed,
        LightMode::Dynamic => manifest::LightMode::Dynamic,
    };
    let mut list: Vec<manifest::Light> = scene
        .lights
        .iter()
        .map(|l| manifest::Light {
            path: l.path.clone(),
            node: l.node,
            mode: mode(l.mode),
            ..punctual(&l.kind)
        })
        .collect();
    for s in &scene.surfaces {
        let m = &scene.materials[s.material];
        if 0.0 < m.emission.max_element() && s.casts_shadow && !m.unlit {
            list.push(manifest::Light {
                path: s.path.clone(),
                node: Some(s.node),
                kind: "emissive".to_owned(),
                mode: manifest::LightMode::Baked,
                ..manifest::Light::default()
            });
        }
    }
    list
}

/// Kind and numbers of a light, as far as JSON has words for these.
fn punctual(kind: &LightKind) -> manifest::Light {
    let of = |v: Vec3| v.is_finite().then(|| v.to_array());
    match *kind {
        LightKind::Point { position, intensity, range } => manifest::Light {
            kind: "point".to_owned(),
            position: of(position),
            intensity: of(intensity),
            range: range.filter(|r| r.is_finite()),
            ..manifest::Light::default()
        },
        LightKind::Spot { position, direction, intensity, range, inner_cone, outer_cone } => {
            manifest::Light {
                kind: "spot".to_owned(),
                position: of(position),
                direction: of(direction),
                intensity: of(intensity),
                range: range.filter(|r| r.is_finite()),
                cone: Some([inner_cone, outer_cone]),
                ..manifest::Light::default()
            }
        }
        LightKind::Directional { direction, illuminance, .. } => manifest::Light {
            kind: "directional".to_owned(),
            direction: of(direction),
            intensity: of(illuminance),
            ..manifest::Light::default()
        },
    }
}

fn sky_of(sky: &Sky, inputs: &[InputFile]) -> manifest::Sky {
    match sky {
        Sky::Black => manifest::Sky::Black,
        Sky::Uniform(l) => manifest::Sky::Uniform { radiance: l.to_array() },
        Sky::Gradient { zenith, horizon, ground } => manifest::Sky::Gradient {
            zenith: zenith.to_array(),
            horizon: horizon.to_array(),
            ground: ground.to_array(),
        },
        Sky::Image { rotation, scale, .. } => {
            let is_image = |f: &&InputFile| f.path.ends_with(".hdr") || f.path.ends_with(".exr");
            manifest::Sky::Image {
                path: inputs.iter().find(is_image).map_or_else(String::new, |f| f.path.clone()),
                file: Some(sky::FILE.to_owned()),
                scale: *scale,
                rotation: rotation.to_array(),
            }
        }
    }
}

fn input(file: &InputFile) -> Input {
    Input {
        role: role(&file.path).to_owned(),
        path: file.path.clone(),
        blake3: file.blake3.clone(),
        bytes: file.bytes,
    }
}

/// What a file is, by its name: good enough for a reader, since the path stands beside it.
fn role(path: &str) -> &'static str {
    let extension = path.rsplit('.').next().unwrap_or_default().to_ascii_lowercase();
    match extension.as_str() {
        "toml" => "config",
        "hdr" | "exr" => "sky",
        "zht" => "tables",
        "bin" => "buffer",
        "png" | "jpg" | "jpeg" | "webp" => "image",
        _ => "scene",
    }
}

fn finding(f: &Finding) -> manifest::Finding {
    manifest::Finding {
        severity: f.severity.to_string(),
        path: f.path.clone(),
        what: f.what.clone(),
        fix: f.fix.clone(),
    }
}
