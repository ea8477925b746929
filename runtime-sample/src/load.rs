//! Opens a bake's folder: manifest, pages, `scene.glb`.

use std::{fs, path::Path};

use anyhow::{Context, Result, bail, ensure};
use exr::prelude as exr;
use glam::{Mat3, Mat4, Vec2, Vec3};
use tables::format::manifest::{self, Manifest};

/// Weights of Rec. 709 luminance.
const LUMINANCE: Vec3 = Vec3::new(0.2126, 0.7152, 0.0722);

/// A manifest with its pages.
#[derive(Debug)]
pub(crate) struct Bake {
    /// Contents of `manifest.json`.
    pub(crate) manifest: Manifest,
    /// `pages[n]` is the page that surfaces call n.
    pub(crate) pages: Vec<Page>,
}

/// One lightmap: `E / pi` in nits, linear Rec. 709, row 0 at the top.
#[derive(Debug)]
pub(crate) struct Page {
    /// Texels per row.
    pub(crate) width: usize,
    /// Rows.
    pub(crate) height: usize,
    texels: Vec<Vec3>,
    /// Which part of the texel charts cover.
    coverage: Vec<f32>,
}

impl Bake {
    /// Reads the manifest and every page it names.
    pub(crate) fn open(dir: &Path) -> Result<Self> {
        let path = dir.join(manifest::FILE_NAME);
        let text = fs::read_to_string(&path).with_context(|| {
            format!("{}: cannot read; is this a folder that `bake run` wrote?", path.display())
        })?;
        let manifest = Manifest::from_json(&text).with_context(|| path.display().to_string())?;
        ensure!(manifest.unit == manifest::UNIT, "{}: unit {} is not known", path.display(), manifest.unit);
        let mut pages = Vec::new();
        for entry in &manifest.pages {
            let page = Page::open(&dir.join(&entry.file))?;
            let said = (entry.width as usize, entry.height as usize);
            if said != (page.width, page.height) {
                bail!(
                    "{}: {} x {} texels, the manifest says {} x {}: bake again",
                    entry.file,
                    page.width,
                    page.height,
                    said.0,
                    said.1
                );
            }
            pages.push(page);
        }
        if let Some(s) = manifest.surfaces.iter().find(|s| pages.len() <= s.page) {
            bail!("{}: surface {} is on page {}, which does not exist", path.display(), s.path, s.page);
        }
        Ok(Self { manifest, pages })
    }

    /// What maps the mean of all pages to middle grey.
    pub(crate) fn exposure(&self) -> f32 {
        let n = self.pages.len().max(1) as f32;
        let mean = self.pages.iter().map(Page::mean_luminance).sum::<f32>() / n;
        if 0.0 < mean { 0.36 / mean } else { 1.0 }
    }
}

impl Page {
    fn open(path: &Path) -> Result<Self> {
        let name = path.display();
        let image = exr::read_first_flat_layer_from_file(path)
            .with_context(|| format!("{name}: the page is missing or damaged; bake again"))?;
        let (size, channels) = (image.layer_data.size, &image.layer_data.channel_data.list);
        let channel = |wanted: &str| {
            let found = channels.iter().find(|c| c.name.eq(wanted));
            let found = found.with_context(|| format!("{name}: there is no channel {wanted}"))?;
            Ok::<Vec<f32>, anyhow::Error>(found.sample_data.values_as_f32().collect())
        };
        let (r, g, b) = (channel("R")?, channel("G")?, channel("B")?);
        let texels = r.iter().zip(&g).zip(&b).map(|((&r, &g), &b)| Vec3::new(r, g, b)).collect();
        Ok(Self { width: size.x(), height: size.y(), texels, coverage: channel("A")? })
    }

    /// Mean over covered texels.
    pub(crate) fn mean_luminance(&self) -> f32 {
        let covered = self.texels.iter().zip(&self.coverage).filter(|(_, a)| 0.0 < **a);
        let (sum, n) = covered.fold((0.0, 0u32), |(s, n), (t, _)| (s + f64::from(t.dot(LUMINANCE)), n + 1));
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
        let mean = (sum / f64::from(n.max(1))) as f32;
        mean
    }

    /// Interpolated between texel centres; (0, 0) is the top left corner of the page.
    pub(crate) fn sample(&self, uv: Vec2) -> Vec3 {
        bilinear(self.width, self.height, uv, false, |i| self.texels[i])
    }
}

/// Bilinear interpolation between texel centres, `repeat`ing or with the border held.
fn bilinear(width: usize, height: usize, uv: Vec2, repeat: bool, texel: impl Fn(usize) -> Vec3) -> Vec3 {
    let at = uv * Vec2::new(width as f32, height as f32) - 0.5;
    let (low, part) = (at.floor(), at - at.floor());
    #[expect(clippy::cast_possible_truncation, reason = "texture coordinates are small")]
    let wrap = |v: f32, step: i64, n: usize| -> usize {
        let n = i64::try_from(n).unwrap_or(i64::MAX);
        let v = v as i64 + step;
        let v = if repeat { v.rem_euclid(n) } else { v.clamp(0, n - 1) };
        usize::try_from(v).unwrap_or(0)
    };
    let row = |step: i64| {
        let start = wrap(low.y, step, height) * width;
        let (a, b) = (wrap(low.x, 0, width), wrap(low.x, 1, width));
        texel(start + a).lerp(texel(start + b), part.x)
    };
    row(0).lerp(row(1), part.y)
}

/// What `scene.glb` holds, as far as it is drawn.
#[derive(Debug, Default)]
pub(crate) struct Scene {
    /// In world space.
    pub(crate) triangles: Vec<Triangle>,
    /// In file order, with the default one at the end.
    pub(crate) materials: Vec<Material>,
    cameras: Vec<Camera>,
}

/// Where a picture is taken from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Camera {
    /// World to camera, which looks along -Z.
    pub(crate) camera_from_world: Mat4,
    /// Full vertical angle, radians.
    pub(crate) yfov: f32,
    /// Width over height.
    pub(crate) aspect: f32,
}

/// Base colour and emission.
#[derive(Debug)]
pub(crate) struct Material {
    color: Vec3,
    texture: Option<Texture>,
    /// Nits.
    pub(crate) emission: Vec3,
    /// Drawn from behind, too.
    pub(crate) double_sided: bool,
}

/// A base colour texture, decoded to linear values. It repeats.
#[derive(Clone, Debug)]
struct Texture {
    width: usize,
    height: usize,
    texels: Vec<Vec3>,
}

/// A triangle with everything that varies over it.
#[derive(Debug)]
pub(crate) struct Triangle {
    /// World space, metres.
    pub(crate) positions: [Vec3; 3],
    /// `TEXCOORD_0`; zero where there is none.
    pub(crate) uvs: [Vec2; 3],
    /// Page and `TEXCOORD_1`; `None` for what has no texels.
    pub(crate) lightmap: Option<(usize, [Vec2; 3])>,
    /// Index into [`Scene::materials`].
    pub(crate) material: usize,
}

impl Material {
    /// Linear base colour.
    pub(crate) fn albedo(&self, uv: Vec2) -> Vec3 {
        let texture = self.texture.as_ref();
        self.color * texture.map_or(Vec3::ONE, |t| bilinear(t.width, t.height, uv, true, |i| t.texels[i]))
    }
}

impl Scene {
    /// Reads a scene whose primitives lie on the first `pages` pages.
    pub(crate) fn open(path: &Path, pages: usize) -> Result<Self> {
        let name = path.display();
        let bytes = fs::read(path).with_context(|| format!("{name}: cannot read"))?;
        // Extensions that are required but do not matter here are no reason to refuse the file.
        let file =
            gltf::Gltf::from_slice_without_validation(&bytes).with_context(|| format!("{name}: damaged"))?;
        let blob = file.blob.as_deref().unwrap_or_default();
        let mut scene = Self::default();
        for m in file.materials() {
            scene.materials.push(material(&m, blob).with_context(|| name.to_string())?);
        }
        let default = scene.materials.len();
        scene.materials.push(Material {
            color: Vec3::ONE,
            texture: None,
            emission: Vec3::ZERO,
            double_sided: false,
        });
        let root = file.default_scene().or_else(|| file.scenes().next()).context("there is no scene")?;
        let mut cameras = Vec::new();
        let mut stack: Vec<_> = root.nodes().map(|n| (n, Mat4::IDENTITY)).collect();
        while let Some((node, parent)) = stack.pop() {
            let world = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
            stack.extend(node.children().map(|n| (n, world)));
            if let Some(camera) = node.camera()
                && let gltf::camera::Projection::Perspective(p) = camera.projection()
            {
                let aspect = p.aspect_ratio().unwrap_or(16.0 / 9.0);
                let seen = Camera { camera_from_world: world.inverse(), yfov: p.yfov(), aspect };
                cameras.push((node.index(), seen));
            }
            for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
                let what = || format!("{name}: {}", node.name().unwrap_or("a node"));
                scene.add(&primitive, blob, world, default, pages).with_context(what)?;
            }
        }
        cameras.sort_by_key(|(node, _)| *node);
        scene.cameras = cameras.into_iter().map(|(_, camera)| camera).collect();
        Ok(scene)
    }

    /// One of the cameras.
    pub(crate) fn camera(&self, index: usize) -> Result<Camera> {
        let n = self.cameras.len();
        self.cameras.get(index).copied().with_context(|| format!("camera {index} of {n} does not exist"))
    }

    fn add(
        &mut self,
        primitive: &gltf::Primitive<'_>,
        blob: &[u8],
        world: Mat4,
        default: usize,
        pages: usize,
    ) -> Result<()> {
        let reader = primitive.reader(|_| Some(blob));
        let positions = reader.read_positions().context("a primitive has no positions")?;
        let positions: Vec<Vec3> = positions.map(|p| world.transform_point3(p.into())).collect();
        let set =
            |n: u32| reader.read_tex_coords(n).map(|t| t.into_f32().map(Vec2::from).collect::<Vec<_>>());
        let (uvs, light) = (set(0), set(1));
        let indices: Vec<usize> = match reader.read_indices() {
            Some(i) => i.into_u32().map(|i| i as usize).collect(),
            None => (0..positions.len()).collect(),
        };
        let page = page(primitive).unwrap_or(0);
        ensure!(light.is_none() || page < pages, "page {page} does not exist");
        // A mirroring transform turns front faces around.
        let mirrored = Mat3::from_mat4(world).determinant() < 0.0;
        for t in indices.chunks_exact(3) {
            let t = if mirrored { [t[0], t[2], t[1]] } else { [t[0], t[1], t[2]] };
            let n = positions.len().min(light.as_ref().map_or(usize::MAX, Vec::len));
            ensure!(t.iter().all(|&i| i < n), "an index of {t:?} is out of range");
            self.triangles.push(Triangle {
                positions: t.map(|i| positions[i]),
                uvs: t.map(|i| uvs.as_ref().and_then(|uvs| uvs.get(i)).copied().unwrap_or_default()),
                lightmap: light.as_ref().map(|uvs| (page, t.map(|i| uvs[i]))),
                material: primitive.material().index().unwrap_or(default),
            });
        }
        Ok(())
    }
}

/// `extras.lightmap.page` of a primitive.
fn page(primitive: &gltf::Primitive<'_>) -> Option<usize> {
    let extras: gltf::json::Value =
        gltf::json::deserialize::from_str(primitive.extras().as_ref()?.get()).ok()?;
    usize::try_from(extras.get("lightmap")?.get("page")?.as_u64()?).ok()
}

fn material(m: &gltf::Material<'_>, blob: &[u8]) -> Result<Material> {
    let pbr = m.pbr_metallic_roughness();
    let [r, g, b, _] = pbr.base_color_factor();
    let texture = match pbr.base_color_texture().map(|t| t.texture().source().source()) {
        Some(gltf::image::Source::View { view, .. }) => {
            let bytes =
                blob.get(view.offset()..view.offset() + view.length()).context("an image is cut off")?;
            let decoded = image::load_from_memory(bytes).context("an image is damaged")?.to_rgb32f();
            let linear = |c: f32| if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
            let texels = decoded.pixels().map(|p| Vec3::from(p.0.map(linear))).collect();
            Some(Texture { width: decoded.width() as usize, height: decoded.height() as usize, texels })
        }
        // A file beside the bake is not ours to find; the factor alone is shown.
        _ => None,
    };
    let emission = Vec3::from(m.emissive_factor()) * m.emissive_strength().unwrap_or(1.0);
    Ok(Material { color: Vec3::new(r, g, b), texture, emission, double_sided: m.double_sided() })
}
