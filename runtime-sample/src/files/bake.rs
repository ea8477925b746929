//! A bake's folder as a whole.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, ensure};
use exr::prelude as exr;
use glam::{DMat4, DVec3, Vec3};
use half::f16;
use tables::{
    format::manifest::{self, LightMode, Manifest, Projection},
    probes::ProbeVolume,
};

use super::{
    page::{Page, Source},
    scene::{Camera, Scene},
    volume::{BLOCKS, Grid, Media},
};

/// What a folder holds.
#[derive(Debug)]
pub(crate) struct Bake {
    /// Name of the folder.
    pub(crate) label: String,
    /// Contents of `manifest.json`.
    pub(crate) manifest: Manifest,
    /// `pages[n]` is the page that surfaces call n.
    pub(crate) pages: Vec<Page>,
    /// What is drawn.
    pub(crate) scene: Scene,
    /// Light probes.
    pub(crate) probes: Option<ProbeVolume>,
    /// Suns and lamps; those that are emissive surfaces are part of the scene.
    pub(crate) lamps: Vec<Lamp>,
    /// What is between surfaces.
    pub(crate) media: Media,
    /// Light in the air, where there are media.
    pub(crate) grid: Option<Grid>,
    /// An image of the sky.
    pub(crate) sky: Option<SkyImage>,
    /// What light is multiplied by before tone mapping, 1/nit.
    pub(crate) exposure: f32,
}

/// A sun or a lamp.
#[derive(Clone, Debug)]
pub(crate) struct Lamp {
    /// Which kind.
    pub(crate) kind: Kind,
    /// Metres in the scene's axes.
    pub(crate) position: Vec3,
    /// Unit vector that light travels along.
    pub(crate) direction: Vec3,
    /// Candela, lux for suns.
    pub(crate) intensity: Vec3,
    /// Where its window ends, metres.
    pub(crate) range: Option<f32>,
    /// Half angles within which it is full and beyond which it is dark, radians.
    pub(crate) cone: [f32; 2],
    /// Whether lightmaps and probes hold its direct light.
    pub(crate) baked: bool,
}

/// Kinds of lamps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// Shines equally in all directions.
    Point,
    /// Shines in a cone.
    Spot,
    /// From infinitely far away.
    Sun,
}

/// The sky all around: the top row is +Y, the middle column looks along -Z, +X is a quarter to its right.
#[derive(Debug)]
pub(crate) struct SkyImage {
    /// Texels per row.
    pub(crate) width: u32,
    /// Rows.
    pub(crate) height: u32,
    /// Nits.
    pub(crate) texels: Vec<[f16; 4]>,
}

/// How folders are read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reading {
    /// From which files lightmaps come.
    pub(crate) pages: Source,
    /// Whether textures in blocks (BC6H) are drawn as they are.
    pub(crate) blocks: bool,
    /// Lamps whose light can be added to fog, at most.
    pub(crate) lamps: usize,
    /// Texels along one axis of a volume, at most.
    pub(crate) volume: u32,
}

/// The folders of the bakes in `dir`: itself, or those in it, by name.
///
/// # Errors
///
/// If there is none.
pub(crate) fn folders(dir: &Path) -> Result<Vec<PathBuf>> {
    let is_bake = |p: &Path| p.join(manifest::FILE_NAME).is_file();
    if is_bake(dir) {
        return Ok(vec![dir.to_owned()]);
    }
    let entries = fs::read_dir(dir).with_context(|| {
        format!("{}: cannot read this folder; name one that `bake run` wrote", dir.display())
    })?;
    let mut found: Vec<PathBuf> = entries.flatten().map(|e| e.path()).filter(|p| is_bake(p)).collect();
    found.sort();
    ensure!(
        !found.is_empty(),
        "{}: there is no {} in it or in a folder in it; is this what `bake run` wrote?",
        dir.display(),
        manifest::FILE_NAME
    );
    Ok(found)
}

impl Bake {
    /// Reads a folder.
    ///
    /// # Errors
    ///
    /// Where a file that the manifest names is missing, damaged or of another kind; the file is named.
    pub(crate) fn open(dir: &Path, reading: Reading) -> Result<Self> {
        let path = dir.join(manifest::FILE_NAME);
        let text = fs::read_to_string(&path).with_context(|| format!("{}: cannot read", path.display()))?;
        let manifest = Manifest::from_json(&text).with_context(|| {
            format!("{}: cannot be used; bake again, or take the release that wrote it", path.display())
        })?;
        ensure!(manifest.unit == manifest::UNIT, "{}: unit {} is not known", path.display(), manifest.unit);
        lengths(dir, &manifest)?;
        let mut pages = Vec::new();
        for entry in &manifest.pages {
            pages.push(Page::open(dir, entry, reading.pages, reading.blocks)?);
        }
        let scene = Scene::open(&dir.join("scene.glb"), pages.len())?;
        let probes = manifest.probes.first().map(|p| volume(&dir.join(&p.file))).transpose()?;
        let lamps: Vec<Lamp> = manifest.lights.iter().filter_map(lamp).collect();
        // What only emits is no fog.
        let dims = |m: &&manifest::Medium| m.sigma_s != [0.0; 3] || m.sigma_a != [0.0; 3];
        let media: Vec<_> = manifest.media.iter().filter(dims).cloned().collect();
        let media = Media::open(dir, &media, reading.volume)?;
        let apart = lamps.len() <= reading.lamps;
        let fits = |g: &manifest::LightGrid| {
            let slices = g.slices.saturating_mul(BLOCKS);
            g.size[0].max(g.size[1]).max(slices) <= reading.volume
        };
        let grid = match &manifest.light_grid {
            Some(g) if fits(g) => Some(Grid::open(dir, g, apart)?),
            _ if media.all.is_empty() => None,
            other => {
                if let Some(g) = other {
                    let name = dir.join(&g.file);
                    crate::say(&format!(
                        "{}: larger than this adapter takes; fog is lit by probes",
                        name.display()
                    ));
                }
                probes.as_ref().and_then(Grid::from_probes)
            }
        };
        let sky = match &manifest.sky {
            manifest::Sky::Image { file: Some(file), .. } => Some(sky(&dir.join(file))?),
            _ => None,
        };
        let label = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
        let label = label.file_name().map_or_else(|| "bake".to_owned(), |n| n.to_string_lossy().into_owned());
        let exposure = exposure(&manifest, &pages);
        Ok(Self { label, manifest, pages, scene, probes, lamps, media, grid, sky, exposure })
    }

    /// The camera of `preview.png`, else the scene's first one, else one outside that looks at the middle.
    pub(crate) fn camera(&self) -> Camera {
        if let Some(c) = &self.manifest.camera {
            let columns = c.world_from_camera.map(|c| c.map(f64::from));
            let world_from_camera = DMat4::from_cols_array_2d(&columns);
            return Camera { name: c.name.clone(), world_from_camera, projection: c.projection };
        }
        if let Some(c) = self.scene.cameras.first() {
            return c.clone();
        }
        let middle = self.scene.origin;
        let away = f64::from(self.scene.radius.max(f32::MIN_POSITIVE)) * DVec3::new(1.5, 1.0, 1.5);
        let world_from_camera =
            glam::dcamera::rh::view::look_at_mat4(middle + away, middle, DVec3::Y).inverse();
        let projection = Projection::Perspective { yfov: 0.8, aspect: 16.0 / 9.0 };
        Camera { name: "outside".to_owned(), world_from_camera, projection }
    }

    /// A camera by its number or name, or [`Bake::camera`].
    ///
    /// # Errors
    ///
    /// If there is no such camera.
    pub(crate) fn camera_named(&self, name: Option<&str>) -> Result<Camera> {
        let Some(name) = name else { return Ok(self.camera()) };
        if let Some(c) = self.scene.cameras.iter().find(|c| c.name == name) {
            return Ok(c.clone());
        }
        let names: Vec<&str> = self.scene.cameras.iter().map(|c| c.name.as_str()).collect();
        let only =
            if names.is_empty() { "none at all".to_owned() } else { format!("only {}", names.join(", ")) };
        let index = name.parse::<usize>().ok();
        let index = index.with_context(|| format!("there is no camera `{name}`, {only}"))?;
        self.scene.camera(index).cloned()
    }

    /// Whether light was baked with metals as black as they are; else base colour is albedo.
    pub(crate) fn metals_black(&self) -> bool {
        self.manifest.settings.get("metals_black").and_then(serde_json::Value::as_bool) == Some(true)
    }

    /// Light where nothing is known of it, nits: the mean of all pages.
    pub(crate) fn mean_light(&self) -> Vec3 {
        let n = self.pages.len().max(1) as f32;
        self.pages.iter().map(|p| p.mean).sum::<Vec3>() / n
    }
}

/// Every file that the manifest lists has the length that it states.
fn lengths(dir: &Path, manifest: &Manifest) -> Result<()> {
    for f in &manifest.files {
        // Pictures for people are not needed.
        if Path::new(&f.name).extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
            continue;
        }
        let path = dir.join(&f.name);
        let name = path.display();
        let found = fs::metadata(&path).with_context(|| format!("{name}: missing; bake again"))?.len();
        ensure!(found == f.bytes, "{name}: {found} bytes, the manifest says {}; bake again", f.bytes);
    }
    Ok(())
}

/// That of the preview, else what maps the mean of all pages to middle grey.
fn exposure(manifest: &Manifest, pages: &[Page]) -> f32 {
    let n = pages.len().max(1) as f32;
    let mean = pages.iter().map(|p| p.mean_luminance).sum::<f32>() / n;
    let found = manifest.exposure.unwrap_or(0.18 / mean);
    if found.is_normal() && 0.0 < found { found } else { 1.0 }
}

fn volume(path: &Path) -> Result<ProbeVolume> {
    let name = path.display();
    let bytes = fs::read(path).with_context(|| format!("{name}: missing; bake again"))?;
    ProbeVolume::from_bytes(&bytes).with_context(|| format!("{name}: cannot be used; bake again"))
}

fn lamp(light: &manifest::Light) -> Option<Lamp> {
    let kind = match light.kind.as_str() {
        "point" => Kind::Point,
        "spot" => Kind::Spot,
        "directional" => Kind::Sun,
        _ => return None,
    };
    Some(Lamp {
        kind,
        position: light.position.map(Vec3::from).unwrap_or_default(),
        direction: light.direction.map_or(Vec3::NEG_Y, Vec3::from),
        intensity: light.intensity?.into(),
        range: light.range,
        cone: light.cone.unwrap_or([0.0, std::f32::consts::PI]),
        baked: light.mode == LightMode::Baked,
    })
}

fn sky(path: &Path) -> Result<SkyImage> {
    let name = path.display();
    let pixels =
        |size: exr::Vec2<usize>, _: &exr::RgbaChannels| (size.x(), vec![[f16::ZERO; 4]; size.area()]);
    let set = |(width, texels): &mut (usize, Vec<[f16; 4]>),
               at: exr::Vec2<usize>,
               (r, g, b, _): (f32, f32, f32, f32)| {
        texels[at.y() * *width + at.x()] = [r, g, b, 1.0].map(f16::from_f32);
    };
    let image = exr::read_first_rgba_layer_from_file(path, pixels, set)
        .with_context(|| format!("{name}: missing or damaged; bake again"))?;
    let (size, (_, texels)) = (image.layer_data.size, image.layer_data.channel_data.pixels);
    let side = |n: usize| u32::try_from(n).with_context(|| format!("{name}: too large"));
    Ok(SkyImage { width: side(size.x())?, height: side(size.y())?, texels })
}

#[cfg(test)]
impl Bake {
    /// Nothing at all.
    pub(crate) fn empty() -> Self {
        Self {
            label: String::new(),
            manifest: Manifest::new("bake", "0"),
            pages: Vec::new(),
            scene: Scene::default(),
            probes: None,
            lamps: Vec::new(),
            media: Media::default(),
            grid: None,
            sky: None,
            exposure: 1.0,
        }
    }
}
