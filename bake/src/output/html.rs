//! A page that shows a bake in a browser: one file with the scene and its lightmaps, without a library or a network.
//!
//! The page draws base colour times lightmap plus emission with WebGL 2, exposed and tone-mapped as `preview.png` is
//! and from the same camera. It is made from a bake's folder alone. Geometry and texels are base64 of zlib streams:
//!
//! - positions relative to the middle of the scene, three floats; texture coordinates with their transforms applied,
//!   two floats; vertex colours, four 16-bit numbers; 16- or 32-bit indices, wound as seen in the world;
//! - lightmaps as RGB9E5 times a power of two;
//! - textures as the scene holds them, PNG, JPEG or WebP, else as PNG.

use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};
use std::path::Path;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use flate2::{Compression, write::ZlibEncoder};
use glam::{Affine3A, DAffine3, DVec3, Mat4, Vec2, Vec3};
use serde::Serialize;
use serde_json::{Value, json};
use tables::format::manifest::{self, Manifest, Projection};

use super::{exr, folder, glb, ktx, record::METALS_BLACK};
use crate::error::{Error, Result, Severity};
use crate::scene::config::{Config, SceneWords};
use crate::scene::document::Document;
use crate::scene::gltf::{self, LoadOptions};
use crate::scene::model::{AlphaMode, Image, Mesh, Scene, Surface, TextureRef, Wrap};

/// Greatest value that a page has after scaling, well inside what RGB9E5 holds.
const BRIGHTEST: i32 = 15;

/// What the script reads.
#[derive(Serialize)]
struct Data {
    exposure: f32,
    camera: Camera,
    /// Distance of the farthest point from the middle, metres.
    radius: f32,
    /// Light of surfaces without texels, nits.
    mean_light: [f32; 3],
    sky: Value,
    pages: Vec<Page>,
    textures: Vec<Texture>,
    draws: Vec<Draw>,
}

#[derive(Serialize)]
struct Camera {
    world_from_camera: [[f32; 4]; 4],
    projection: Projection,
    /// How far ahead the nearest surface is, metres.
    focus: f32,
}

#[derive(Serialize)]
struct Page {
    width: usize,
    height: usize,
    /// What stored values are multiplied by, nits.
    scale: f32,
    /// Where its words begin.
    at: usize,
}

#[derive(Serialize)]
struct Texture {
    #[serde(rename = "type")]
    media_type: &'static str,
    at: usize,
    length: usize,
    wrap: [&'static str; 2],
    nearest: bool,
}

/// One surface. Numbers are places in the packed bytes.
#[derive(Serialize)]
struct Draw {
    world_from_mesh: [f32; 16],
    position: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    light_uv: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    base_uv: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    glow_uv: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pass_uv: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    tint: Option<usize>,
    indices: usize,
    count: usize,
    /// Whether indices have 32 bits.
    wide: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    page: Option<usize>,
    base: [f32; 4],
    #[serde(skip_serializing_if = "Option::is_none")]
    base_map: Option<usize>,
    glow: [f32; 3],
    #[serde(skip_serializing_if = "Option::is_none")]
    glow_map: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    cutoff: Option<f32>,
    /// Part of the light that passes straight through, coloured by `base`.
    pass: f32,
    /// A factor of it, in the red channel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pass_map: Option<usize>,
    /// Whether alpha counts as well.
    blend: bool,
    double_sided: bool,
}

/// The page that shows the bake in `folder`.
///
/// # Errors
/// [`Error::Usage`] if the folder holds no bake, [`Error::Io`] and [`Error::Input`] if one of its files is missing or
/// damaged.
pub fn build(folder: &Path) -> Result<String> {
    let manifest = open(folder)?;
    let mut document = Document::open(&folder::resolve(folder, "scene.glb"))?;
    forget_words(&mut document.json);
    let metals_black = manifest.settings.get(METALS_BLACK).and_then(Value::as_bool);
    let config = Config { scene: SceneWords { metals_black, ..SceneWords::default() }, ..Config::default() };
    let (scene, findings) = gltf::load(&document, &config, &LoadOptions::default());
    let errors: Vec<_> = findings.into_iter().filter(|f| f.severity == Severity::Error).collect();
    if !errors.is_empty() {
        return Err(Error::Input(errors));
    }
    let mut texels = Vec::new();
    let (pages, mean_light) = pages(folder, &manifest, &mut texels)?;
    let mut packer = Packer::new(&document, &scene, pages.len());
    let draws: Vec<Draw> = scene.surfaces.iter().filter_map(|s| packer.draw(s)).collect();
    let data = Data {
        exposure: manifest.exposure.unwrap_or(1.0),
        camera: camera(&manifest, &scene, packer.middle, packer.radius),
        radius: packer.radius,
        mean_light,
        sky: sky(&manifest.sky),
        pages,
        textures: packer.textures,
        draws,
    };
    let not_json = |e: serde_json::Error| Error::Usage(format!("the page cannot be written: {e}"));
    // `</script>` in a name would end the element.
    let data = serde_json::to_string(&data).map_err(not_json)?.replace('<', "\\u003c");
    Ok(fill(&[
        ("title", &escape(&name(folder))),
        ("style", include_str!("web/style.css")),
        ("scene", &data),
        ("vertices", &pack(&packer.vertices.bytes)?),
        ("indices", &pack(&packer.indices.bytes)?),
        ("texels", &pack(&texels)?),
        ("images", &pack(&packer.images.bytes)?),
        ("shaders", &shaders().to_string()),
        ("script", include_str!("web/view.js")),
    ]))
}

/// Removes words that a page has no use for: files that they name are not in the folder.
fn forget_words(json: &mut Value) {
    for scene in glb::items(json, "scenes") {
        scene.as_object_mut().map(|scene| scene.shift_remove("extras"));
    }
    for node in glb::items(json, "nodes") {
        if let Some(extras) = node.get_mut("extras").and_then(Value::as_object_mut) {
            extras.retain(|key, _| !key.starts_with("medium") && key != "probes");
        }
    }
}

fn open(folder: &Path) -> Result<Manifest> {
    if !folder::resolve(folder, manifest::FILE_NAME).is_file() {
        return Err(Error::Usage(format!(
            "{}: is no bake, since it holds no {}; name a folder that `bake run` wrote",
            folder.display(),
            manifest::FILE_NAME
        )));
    }
    folder::read_manifest(folder)
}

/// What people call the bake: its folder without `.bake`.
#[must_use]
pub fn name(folder: &Path) -> String {
    let full = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    let name = full.file_name().map_or_else(|| "bake".into(), |s| s.to_string_lossy());
    name.strip_suffix(".bake").filter(|n| !n.is_empty()).unwrap_or(&name).to_owned()
}

fn shaders() -> Value {
    let tone = include_str!("web/tone.glsl");
    let fragment = |text: &str| format!("{tone}\n{text}");
    json!({
        "surface": [include_str!("web/surface.vert"), fragment(include_str!("web/surface.frag"))],
        "sky": [include_str!("web/sky.vert"), fragment(include_str!("web/sky.frag"))],
    })
}

/// The page with `{{name}}` replaced, each once, so that what is filled in is not looked at.
fn fill(parts: &[(&str, &str)]) -> String {
    let mut out = String::new();
    let mut rest = include_str!("web/page.html");
    while let Some((before, after)) = rest.split_once("{{") {
        let (name, after) = after.split_once("}}").unwrap_or((after, ""));
        out.push_str(before);
        out.extend(parts.iter().find(|(n, _)| *n == name).map(|(_, text)| *text));
        rest = after;
    }
    out.push_str(rest);
    out
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;")
}

/// Base64 of the bytes deflated.
fn pack(bytes: &[u8]) -> Result<String> {
    let failed = |e: std::io::Error| Error::Usage(format!("the page cannot be packed: {e}"));
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).map_err(failed)?;
    Ok(STANDARD.encode(encoder.finish().map_err(failed)?))
}

/// Packs all pages; also the mean of covered texels.
fn pages(folder: &Path, manifest: &Manifest, texels: &mut Vec<u8>) -> Result<(Vec<Page>, [f32; 3])> {
    let mut pages = Vec::new();
    let (mut sum, mut n) = (DVec3::ZERO, 0_u64);
    for page in &manifest.pages {
        let path = folder::resolve(folder, &page.file);
        let file = exr::read(&path)?;
        let (Some(rgb), Some(coverage)) = (file.rgb(""), file.channel("A")) else {
            return Err(Error::Usage(format!(
                "{}: the channels R, G, B and A are not all there",
                path.display()
            )));
        };
        let colors = || (0..file.width * file.height).map(|i| rgb.map(|c| c.values[i]));
        for (color, _) in colors().zip(&coverage.values).filter(|(_, a)| 0.0 < **a) {
            sum += Vec3::from(color).as_dvec3();
            n += 1;
        }
        let most = colors().flatten().filter(|v| v.is_finite()).fold(0.0, f32::max);
        let scale = scale(most);
        pages.push(Page { width: file.width, height: file.height, scale, at: texels.len() });
        texels.extend(colors().flat_map(|c| ktx::rgb9e5(c.map(|v| v / scale)).to_le_bytes()));
    }
    let mean = if n == 0 { DVec3::ZERO } else { sum / n as f64 };
    Ok((pages, mean.as_vec3().to_array()))
}

/// The power of two that brings `most` to the upper end of RGB9E5.
fn scale(most: f32) -> f32 {
    if most < f32::MIN_POSITIVE {
        return 1.0;
    }
    let power = (most.to_bits() >> 23).cast_signed() - 126;
    // Smaller ones would make the quotient or the factor itself vanish.
    2.0_f32.powi((power - BRIGHTEST).max(-126))
}

fn sky(sky: &manifest::Sky) -> Value {
    let [zenith, horizon, ground] = match *sky {
        manifest::Sky::Uniform { radiance } => [radiance; 3],
        manifest::Sky::Gradient { zenith, horizon, ground } => [zenith, horizon, ground],
        // The image is not in the folder.
        manifest::Sky::Black | manifest::Sky::Image { .. } => [[0.0; 3]; 3],
    };
    json!({ "zenith": zenith, "horizon": horizon, "ground": ground })
}

/// The camera of `preview.png`, moved to the scene's middle; without one, a look at the whole from the front.
fn camera(manifest: &Manifest, scene: &Scene, middle: DVec3, radius: f32) -> Camera {
    let (world_from_camera, projection) = match &manifest.camera {
        Some(c) => {
            let mut columns = c.world_from_camera;
            let eye = DVec3::from([columns[3][0], columns[3][1], columns[3][2]].map(f64::from)) - middle;
            columns[3] = eye.as_vec3().extend(1.0).to_array();
            (columns, c.projection)
        }
        None => {
            let back = Mat4::from_translation(Vec3::Z * 2.0 * radius);
            (back.to_cols_array_2d(), Projection::Perspective { yfov: 1.0, aspect: 16.0 / 9.0 })
        }
    };
    let m = Mat4::from_cols_array_2d(&world_from_camera);
    let (eye, forward) = (m.w_axis.truncate(), -m.z_axis.truncate().normalize_or(Vec3::Z));
    let focus = nearest(scene, middle, eye, forward).unwrap_or(radius).clamp(1e-5 * radius, 2.0 * radius);
    Camera { world_from_camera, projection, focus }
}

/// Distance of the nearest triangle along a ray, by looking at all of them.
fn nearest(scene: &Scene, middle: DVec3, origin: Vec3, direction: Vec3) -> Option<f32> {
    let mut best: Option<f32> = None;
    for surface in &scene.surfaces {
        let mesh = &scene.meshes[surface.mesh];
        let world = centred(&surface.world_from_mesh, middle);
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| world.transform_point3(mesh.positions[i as usize]) - origin);
            let normal = (b - a).cross(c - a);
            let t = normal.dot(a) / normal.dot(direction);
            let p = direction * t;
            let inside =
                [(a, b), (b, c), (c, a)].iter().all(|(p0, p1)| 0.0 <= (p1 - p0).cross(p - p0).dot(normal));
            if inside && 0.0 < t && best.is_none_or(|best| t < best) {
                best = Some(t);
            }
        }
    }
    best
}

/// A transform into the world with its origin in the middle of the scene.
fn centred(world_from_mesh: &Affine3A, middle: DVec3) -> Affine3A {
    let m = DAffine3::from_mat3_translation(
        glam::DMat3::from_cols_array(&world_from_mesh.matrix3.to_cols_array().map(f64::from)),
        Vec3::from(world_from_mesh.translation).as_dvec3() - middle,
    );
    m.as_affine3a()
}

/// Middle of the surfaces' bounds, and how far they reach from it.
fn bounds(scene: &Scene) -> (DVec3, f32) {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for surface in &scene.surfaces {
        for p in &scene.meshes[surface.mesh].positions {
            let p = surface.world_from_mesh.transform_point3(*p).as_dvec3();
            (low, high) = (low.min(p), high.max(p));
        }
    }
    let half = 0.5 * (high - low);
    if !half.is_finite() || half == DVec3::ZERO {
        return (DVec3::ZERO, 1.0);
    }
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
    let radius = half.length() as f32;
    (low + half, radius)
}

/// Bytes in the making; equal runs are stored once.
#[derive(Default)]
struct Bytes {
    bytes: Vec<u8>,
    known: BTreeMap<[u8; 32], usize>,
}

impl Bytes {
    /// Where `run` is, at a multiple of four.
    fn place(&mut self, run: &[u8]) -> usize {
        let hash = *blake3::hash(run).as_bytes();
        if let Some(&at) = self.known.get(&hash) {
            return at;
        }
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let at = self.bytes.len();
        self.bytes.extend_from_slice(run);
        self.known.insert(hash, at);
        at
    }

    fn floats(&mut self, values: impl IntoIterator<Item = f32>) -> usize {
        let run: Vec<u8> = values.into_iter().flat_map(f32::to_le_bytes).collect();
        self.place(&run)
    }
}

struct Packer<'a> {
    document: &'a Document,
    scene: &'a Scene,
    n_pages: usize,
    middle: DVec3,
    radius: f32,
    vertices: Bytes,
    indices: Bytes,
    images: Bytes,
    textures: Vec<Texture>,
    /// Image with wrapping and filter to the entry of `textures`; `None` where it cannot be encoded.
    known: BTreeMap<(usize, [&'static str; 2], bool), Option<usize>>,
}

impl<'a> Packer<'a> {
    fn new(document: &'a Document, scene: &'a Scene, n_pages: usize) -> Self {
        let (middle, radius) = bounds(scene);
        Self {
            document,
            scene,
            n_pages,
            middle,
            radius,
            vertices: Bytes::default(),
            indices: Bytes::default(),
            images: Bytes::default(),
            textures: Vec::new(),
            known: BTreeMap::new(),
        }
    }

    /// A surface; `None` where nothing of it can be seen.
    fn draw(&mut self, surface: &Surface) -> Option<Draw> {
        let mesh = &self.scene.meshes[surface.mesh];
        let material = &self.scene.materials[surface.material];
        let world = centred(&surface.world_from_mesh, self.middle);
        if mesh.triangles.is_empty() || !world.is_finite() {
            return None;
        }
        let mirrored = world.matrix3.determinant() < 0.0;
        let page = self.page(mesh).filter(|_| mesh.uvs.get(1).is_some_and(|uvs| !uvs.is_empty()));
        let base = material.base_color_texture.as_ref();
        let glow = material.emission_texture.as_ref().filter(|_| material.emission != Vec3::ZERO);
        let pass = material.transmission_texture.as_ref().filter(|_| 0.0 < material.transmission);
        let wide = usize::from(u16::MAX) <= mesh.positions.len();
        Some(Draw {
            world_from_mesh: Mat4::from(world).to_cols_array(),
            position: self.vertices.floats(mesh.positions.iter().flat_map(Vec3::to_array)),
            light_uv: page.map(|_| self.vertices.floats(mesh.uvs[1].iter().flat_map(Vec2::to_array))),
            base_uv: base.and_then(|t| self.coordinates(mesh, t)),
            glow_uv: glow.and_then(|t| self.coordinates(mesh, t)),
            pass_uv: pass.and_then(|t| self.coordinates(mesh, t)),
            tint: (!mesh.colors.is_empty()).then(|| self.tint(mesh)),
            indices: self.triangles(mesh, mirrored, wide),
            count: 3 * mesh.triangles.len(),
            wide,
            page,
            base: material.base_color.to_array(),
            base_map: base.and_then(|t| self.texture(t)),
            glow: material.emission.to_array(),
            glow_map: glow.and_then(|t| self.texture(t)),
            cutoff: match material.alpha_mode {
                AlphaMode::Mask(cutoff) => Some(cutoff),
                _ => None,
            },
            pass: material.transmission.clamp(0.0, 1.0),
            pass_map: pass.and_then(|t| self.texture(t)),
            blend: material.alpha_mode == AlphaMode::Blend,
            double_sided: material.double_sided,
        })
    }

    /// The page that a primitive says it is on.
    fn page(&self, mesh: &Mesh) -> Option<usize> {
        let (mesh, primitive) = mesh.source;
        let page = &self.document.json["meshes"][mesh]["primitives"][primitive]["extras"]["lightmap"]["page"];
        page.as_u64().and_then(|p| usize::try_from(p).ok()).filter(|p| *p < self.n_pages)
    }

    fn coordinates(&mut self, mesh: &Mesh, texture: &TextureRef) -> Option<usize> {
        let uvs = mesh.uvs.get(texture.uv_set).filter(|uvs| !uvs.is_empty())?;
        let [x, y] = texture.transform;
        let moved = |uv: &Vec2| [x.dot(uv.extend(1.0)), y.dot(uv.extend(1.0))];
        Some(self.vertices.floats(uvs.iter().flat_map(moved)))
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 16 bits")]
    fn tint(&mut self, mesh: &Mesh) -> usize {
        let word = |v: f32| ((v.clamp(0.0, 1.0) * 65535.0).round() as u16).to_le_bytes();
        let run: Vec<u8> = mesh.colors.iter().flat_map(|c| c.to_array()).flat_map(word).collect();
        self.vertices.place(&run)
    }

    fn triangles(&mut self, mesh: &Mesh, mirrored: bool, wide: bool) -> usize {
        let n_bytes = if wide { 4 } else { 2 };
        let wound = |t: &[u32; 3]| if mirrored { [t[0], t[2], t[1]] } else { *t };
        let corners = mesh.triangles.iter().flat_map(wound);
        let run: Vec<u8> = corners.flat_map(|i| i.to_le_bytes().into_iter().take(n_bytes)).collect();
        self.indices.place(&run)
    }

    fn texture(&mut self, texture: &TextureRef) -> Option<usize> {
        let wrap = texture.wrap.map(|w| match w {
            Wrap::Repeat => "repeat",
            Wrap::Mirror => "mirror",
            Wrap::Clamp => "clamp",
        });
        let key = (texture.image, wrap, texture.nearest);
        if let Some(&known) = self.known.get(&key) {
            return known;
        }
        let image = &self.scene.images[texture.image];
        let made = self.encoded(image).map(|(bytes, media_type)| {
            let at = self.images.place(&bytes);
            self.textures.push(Texture {
                media_type,
                at,
                length: bytes.len(),
                wrap,
                nearest: texture.nearest,
            });
            self.textures.len() - 1
        });
        self.known.insert(key, made);
        made
    }

    /// An image as the document holds it, or as PNG.
    fn encoded(&self, image: &Image) -> Option<(Vec<u8>, &'static str)> {
        let held = image.source.and_then(|i| self.document.image_bytes(i).ok());
        if let Some((bytes, media_type)) = held.and_then(|(b, _)| super::glb::media_type(&b).map(|m| (b, m)))
        {
            return Some((bytes, media_type));
        }
        let mut png = Cursor::new(Vec::new());
        let pixels = image.pixels.as_flattened();
        let color = image::ExtendedColorType::Rgba8;
        let format = image::ImageFormat::Png;
        image::write_buffer_with_format(&mut png, pixels, image.width, image.height, color, format).ok()?;
        Some((png.into_inner(), "image/png"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_bring_every_light_into_range() {
        for most in [1e-30_f32, 1e-6, 0.9, 1.0, 1.5, 1e9, 3e38] {
            let scaled = most / scale(most);
            assert!((16384.0..=32768.0).contains(&scaled), "{most}: {scaled}");
        }
        assert_eq!(scale(0.0), 1.0);
    }

    #[test]
    fn what_is_filled_in_is_taken_as_it_is() {
        let page = fill(&[("title", "{{script}}"), ("script", "S")]);
        assert!(page.contains("<title>{{script}}</title>") && page.contains("\nS</script>"), "{page}");
        assert_eq!(escape("a<b>&"), "a&lt;b>&amp;");
    }

    #[test]
    fn equal_runs_are_stored_once() {
        let mut bytes = Bytes::default();
        let first = bytes.place(&[1, 2, 3]);
        assert_eq!((bytes.floats([1.0]), bytes.place(&[1, 2, 3])), (4, first));
        assert_eq!(bytes.bytes.len(), 8);
    }

    #[test]
    fn a_folder_without_a_bake_is_refused() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        for folder in [dir.path().to_owned(), dir.path().join("absent")] {
            let Err(error) = build(&folder) else { panic!("accepted") };
            assert!(error.to_string().contains("is no bake"), "{error}");
        }
        Ok(())
    }
}
