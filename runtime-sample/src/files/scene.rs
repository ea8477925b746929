//! `scene.glb`: triangles in world space with the atlas coordinates of their lightmap.

use std::{collections::BTreeMap, fs, path::Path};

use anyhow::{Context, Result, bail, ensure};
use glam::{DMat3, DMat4, DVec3, Mat4, Vec2, Vec3};
use gltf::json::Value;
use tables::format::manifest::Projection;

use super::{
    accessor,
    material::{Alpha, MAPS, Map, Material, Picture},
};

/// What is drawn of `scene.glb`.
#[derive(Debug, Default)]
pub(crate) struct Scene {
    /// Middle of the bounds, metres in the scene's axes. All places below are relative to it: near an origin that is far away single
    /// precision would make them coarse.
    pub(crate) origin: DVec3,
    /// Distance of the farthest vertex from there, metres.
    pub(crate) radius: f32,
    /// Corners of triangles.
    pub(crate) vertices: Vec<Vertex>,
    /// Three of [`Scene::vertices`] each, counter-clockwise seen from the front.
    pub(crate) indices: Vec<u32>,
    /// Runs of `indices` that are drawn alike.
    pub(crate) parts: Vec<Part>,
    /// In file order, with the default one at the end.
    pub(crate) materials: Vec<Material>,
    /// By glTF's number; none where the bake does not hold it.
    pub(crate) pictures: Vec<Option<Picture>>,
    /// In the order of their nodes.
    pub(crate) cameras: Vec<Camera>,
}

/// A corner of triangles.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct Vertex {
    /// Metres from [`Scene::origin`].
    pub(crate) position: [f32; 3],
    /// Unit vector.
    pub(crate) normal: [f32; 3],
    /// Place on the page; (0, 0) is the top left corner.
    pub(crate) light: [f32; 2],
    /// Texture coordinates of base colour, emission, transmission, metal, normals; with their transforms.
    pub(crate) maps: [[f32; 2]; MAPS],
    /// Vertex colour, 65535 is 1.
    pub(crate) tint: [u16; 4],
}

/// A run of triangles of one material and one page.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// Which of [`Scene::indices`].
    pub(crate) indices: std::ops::Range<u32>,
    /// Which of [`Scene::materials`].
    pub(crate) material: usize,
    /// Which lightmap; none for what has no texels and is lit by probes.
    pub(crate) page: Option<usize>,
    /// Whether it stops light.
    pub(crate) shadow: bool,
    /// Mean of its vertices.
    pub(crate) centre: Vec3,
}

/// Where a picture is taken from.
#[derive(Clone, Debug)]
pub(crate) struct Camera {
    /// Name in the file.
    pub(crate) name: String,
    /// Camera, which looks along -Z, to the scene's axes.
    pub(crate) world_from_camera: DMat4,
    /// What it covers.
    pub(crate) projection: Projection,
}

/// Triangles before they are sorted.
struct Gathered {
    positions: Vec<DVec3>,
    vertices: Vec<Vertex>,
    /// By whether they are drawn last, material, page and whether they cast a shadow; those that are drawn last stay apart, so that they can be
    /// sorted.
    parts: BTreeMap<(usize, usize, Option<usize>, bool), Vec<u32>>,
}

impl Scene {
    /// Reads the file whose primitives lie on the first `pages` pages.
    ///
    /// # Errors
    ///
    /// Where it is missing or damaged; the place in the file is named.
    pub(crate) fn open(path: &Path, pages: usize) -> Result<Self> {
        let name = path.display();
        let bytes = fs::read(path).with_context(|| format!("{name}: missing; bake again"))?;
        Self::parse(&bytes, pages).with_context(|| format!("{name}: damaged; bake again"))
    }

    fn parse(bytes: &[u8], pages: usize) -> Result<Self> {
        let glb = gltf::Glb::from_slice(bytes)?;
        let blob = glb.bin.as_deref().unwrap_or_default();
        let mut root = gltf::json::Root::from_slice(&glb.json)?;
        checked(&mut root)?;
        let file = gltf::Document::from_json_without_validation(root);
        let mut scene = Self::default();
        scene.materials.extend(file.materials().map(|m| Material::read(&m)));
        scene.materials.push(Material::standard());
        let used: Vec<bool> = {
            let mut used = vec![false; file.images().len()];
            let maps = scene.materials.iter().flat_map(|m| m.maps.iter().flatten());
            maps.for_each(|m| {
                if let Some(u) = used.get_mut(m.image) {
                    *u = true
                }
            });
            used
        };
        for (image, used) in file.images().zip(used) {
            // As in the bake, a picture that cannot be read is none.
            let picture = if used { Picture::read(&image, blob) } else { Ok(None) };
            scene.pictures.push(picture.unwrap_or_else(|e| {
                crate::say(&format!("scene.glb: {e:#}; it is left out"));
                None
            }));
        }
        for m in &mut scene.materials {
            for map in &mut m.maps {
                *map = map.filter(|m| matches!(scene.pictures.get(m.image), Some(Some(_))));
            }
        }
        let mut seen = vec![false; file.nodes().len()];
        let mut gathered = Gathered { positions: Vec::new(), vertices: Vec::new(), parts: BTreeMap::new() };
        let mut cameras = Vec::new();
        let mut stack: Vec<_> = roots(&file).into_iter().map(|n| (n, DMat4::IDENTITY)).collect();
        while let Some((node, parent)) = stack.pop() {
            // Below two parents, or above itself.
            ensure!(
                !std::mem::replace(&mut seen[node.index()], true),
                "node {} is there twice",
                node.index()
            );
            if hidden(&node) {
                continue;
            }
            let world = parent * Mat4::from_cols_array_2d(&node.transform().matrix()).as_dmat4();
            stack.extend(node.children().map(|n| (n, world)));
            if let Some(camera) = node.camera() {
                let name = node.name().or(camera.name()).unwrap_or("camera").to_owned();
                let projection = projection(&camera);
                cameras.push((node.index(), Camera { name, world_from_camera: world, projection }));
            }
            let shadow = casts_shadow(&node);
            for primitive in node.mesh().iter().flat_map(gltf::Mesh::primitives) {
                let what = || format!("node {}, primitive {}", node.index(), primitive.index());
                gathered
                    .add(&primitive, blob, (world, shadow), &scene.materials, pages)
                    .with_context(what)?;
            }
        }
        cameras.sort_by_key(|(node, _)| *node);
        scene.cameras = cameras.into_iter().map(|(_, camera)| camera).collect();
        scene.take(gathered);
        Ok(scene)
    }

    /// Moves all that was gathered to around the middle.
    fn take(&mut self, gathered: Gathered) {
        let Gathered { positions, mut vertices, parts } = gathered;
        let (min, max) =
            positions.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
        let middle = 0.5 * (min + max);
        self.origin = if middle.is_finite() { middle } else { DVec3::ZERO };
        for (v, p) in vertices.iter_mut().zip(&positions) {
            let p = (*p - self.origin).as_vec3();
            v.position = p.to_array();
            self.radius = self.radius.max(p.length());
        }
        self.vertices = vertices;
        for ((_, material, page, shadow), indices) in parts {
            let start = self.end();
            let sum: Vec3 = indices.iter().map(|i| Vec3::from(self.vertices[*i as usize].position)).sum();
            let centre = sum / indices.len().max(1) as f32;
            self.indices.extend(indices);
            self.parts.push(Part { indices: start..self.end(), material, page, shadow, centre });
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        reason = "vertices are fewer than 2^32, and so are indices of real scenes"
    )]
    fn end(&self) -> u32 {
        self.indices.len() as u32
    }

    /// One of the cameras.
    ///
    /// # Errors
    ///
    /// If there are fewer.
    pub(crate) fn camera(&self, index: usize) -> Result<&Camera> {
        let n = self.cameras.len();
        self.cameras
            .get(index)
            .with_context(|| format!("camera {index} of {n} does not exist; the first one is 0"))
    }

    /// Distance along a ray, in units of `direction`, to the first triangle it meets from either side; `direction` is finite and not 0.
    pub(crate) fn meets(&self, from: Vec3, direction: Vec3) -> Option<f32> {
        let corner = |i: u32| Vec3::from(self.vertices[i as usize].position);
        let mut nearest = f32::INFINITY;
        for t in self.indices.chunks_exact(3) {
            let (a, b, c) = (corner(t[0]), corner(t[1]), corner(t[2]));
            let (u, v) = (b - a, c - a);
            let p = direction.cross(v);
            let det = u.dot(p);
            let s = from - a;
            let q = s.cross(u);
            let (x, y, t) = (s.dot(p) / det, direction.dot(q) / det, v.dot(q) / det);
            if 0.0 <= x && 0.0 <= y && x + y <= 1.0 && 0.0 < t && t < nearest {
                nearest = t;
            }
        }
        nearest.is_finite().then_some(nearest)
    }
}

/// Nodes of the scene; where there is none, all that are below no other.
fn roots(file: &gltf::Document) -> Vec<gltf::Node<'_>> {
    if let Some(scene) = file.default_scene().or_else(|| file.scenes().next()) {
        return scene.nodes().collect();
    }
    let mut below = vec![false; file.nodes().len()];
    file.nodes()
        .flat_map(|n| n.children().map(|c| c.index()).collect::<Vec<_>>())
        .for_each(|c| below[c] = true);
    file.nodes().filter(|n| !below[n.index()]).collect()
}

/// Takes away what does not matter here, and refuses what points nowhere.
fn checked(root: &mut gltf::json::Root) -> Result<()> {
    use gltf::json::validation::{Checked, Error, Validate};
    // Extensions that are required but do not matter here are no reason to refuse the file.
    root.extensions_required.clear();
    for s in &mut root.samplers {
        s.mag_filter = s.mag_filter.take().filter(|f| matches!(f, Checked::Valid(_)));
        s.min_filter = s.min_filter.take().filter(|f| matches!(f, Checked::Valid(_)));
    }
    // The crate looks at the accessors of positions before it knows that they are there.
    let n = root.accessors.len();
    for (i, mesh) in root.meshes.iter().enumerate() {
        let attributes = mesh.primitives.iter().flat_map(|p| p.attributes.values());
        ensure!(attributes.into_iter().all(|a| a.value() < n), "meshes[{i}]: an accessor does not exist");
    }
    let mut wrong = Vec::new();
    root.validate(root, gltf::json::Path::new, &mut |path, error| {
        let path = path().to_string();
        // Bounds of positions are not needed, and bakes are made without them.
        let bounds = path.ends_with(".min") || path.ends_with(".max");
        if !(bounds && matches!(error, Error::Missing | Error::Invalid)) {
            wrong.push(format!("{path}: {error}"));
        }
    });
    ensure!(wrong.is_empty(), "{}", wrong.join("; "));
    Ok(())
}

/// Whether `KHR_node_visibility` hides a node and all below it.
fn hidden(node: &gltf::Node<'_>) -> bool {
    let said = node.extension_value("KHR_node_visibility");
    said.and_then(|v| v.get("visible")).and_then(Value::as_bool) == Some(false)
}

/// The word `casts_shadow` of a node.
fn casts_shadow(node: &gltf::Node<'_>) -> bool {
    let extras =
        node.extras().as_ref().and_then(|e| gltf::json::deserialize::from_str::<Value>(e.get()).ok());
    extras.and_then(|e| e.get("casts_shadow")?.as_bool()) != Some(false)
}

fn projection(camera: &gltf::Camera<'_>) -> Projection {
    match camera.projection() {
        gltf::camera::Projection::Perspective(p) => {
            Projection::Perspective { yfov: p.yfov(), aspect: p.aspect_ratio().unwrap_or(16.0 / 9.0) }
        }
        gltf::camera::Projection::Orthographic(o) => {
            Projection::Orthographic { xmag: o.xmag(), ymag: o.ymag() }
        }
    }
}

impl Gathered {
    fn add(
        &mut self,
        primitive: &gltf::Primitive<'_>,
        blob: &[u8],
        (world, shadow): (DMat4, bool),
        materials: &[Material],
        pages: usize,
    ) -> Result<()> {
        use gltf::Semantic;
        let read = |s: Semantic| primitive.get(&s);
        let positions = read(Semantic::Positions).context("it has no positions")?;
        let positions: Vec<[f32; 3]> = accessor::floats(&positions, blob)?;
        let n = positions.len();
        let pairs = |set: u32| -> Result<Option<Vec<[f32; 2]>>> {
            read(Semantic::TexCoords(set)).map(|a| accessor::floats(&a, blob)).transpose()
        };
        let normals: Option<Vec<[f32; 3]>> =
            read(Semantic::Normals).map(|a| accessor::floats(&a, blob)).transpose()?;
        let tints = read(Semantic::Colors(0));
        let opaque = tints.as_ref().is_some_and(|a| a.dimensions().multiplicity() < 4);
        let tints: Option<Vec<[f32; 4]>> = tints.map(|a| accessor::floats(&a, blob)).transpose()?;
        let page = page(primitive);
        ensure!(page.is_none_or(|p| p < pages), "page {page:?} does not exist");
        let light =
            if page.is_some() { Some(pairs(1)?.context("it has a page but no TEXCOORD_1")?) } else { None };
        let material = primitive.material().index().unwrap_or(materials.len() - 1);
        let m = materials.get(material).context("its material does not exist")?;
        let mut sets = BTreeMap::new();
        for map in m.maps.iter().flatten() {
            sets.insert(map.set, pairs(map.set)?.unwrap_or_default());
        }
        let indices = match primitive.indices() {
            Some(a) => accessor::indices(&a, blob)?,
            None => (0..n).collect(),
        };
        // A mirroring transform turns front faces around.
        let turned = DMat3::from_mat4(world);
        let mirrored = turned.determinant() < 0.0;
        let mut triangles = triangles(primitive.mode(), &indices);
        ensure!(triangles.iter().flatten().all(|i| *i < n), "an index is out of range");
        if mirrored {
            triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let first = u32::try_from(self.vertices.len()).ok();
        // Zero where a map has no coordinates, as glTF leaves them undefined.
        let lies = |map: Option<&Map>, i: usize| {
            let uv = map.map(|m| m.at(sets[&m.set].get(i).copied().map_or(Vec2::ZERO, Vec2::from)));
            uv.unwrap_or_default().to_array()
        };
        // Normals go by cofactors, which also flat nodes have.
        let sign = if mirrored { -1.0 } else { 1.0 };
        let [x, y, z] = [0, 1, 2].map(|i| turned.col(i));
        let up = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y)) * sign;
        let vertex = |i: usize, flat: Vec3| {
            let normal = normals.as_ref().and_then(|n| n.get(i)).map(|n| up * Vec3::from(*n).as_dvec3());
            let mut tint = tints.as_ref().and_then(|t| t.get(i)).copied().unwrap_or([1.0; 4]);
            if opaque {
                tint[3] = 1.0;
            }
            Vertex {
                position: [0.0; 3],
                normal: normal.and_then(DVec3::try_normalize).map_or(flat, DVec3::as_vec3).to_array(),
                light: light.as_ref().and_then(|l| l.get(i)).copied().unwrap_or_default(),
                maps: std::array::from_fn(|k| lies(m.maps[k].as_ref(), i)),
                tint: tint.map(sixteen),
            }
        };
        let place = |i: usize| world.transform_point3(Vec3::from(positions[i]).as_dvec3());
        let key = (if m.passes() { 1 + self.parts.len() } else { 0 }, material, page, shadow);
        let out = self.parts.entry(key).or_default();
        let number = |n: usize| u32::try_from(n).ok().context("there are more than 2^32 vertices");
        if normals.is_some() {
            let first = first.context("there are more than 2^32 vertices")?;
            for i in 0..n {
                self.positions.push(place(i));
                self.vertices.push(vertex(i, Vec3::Y));
            }
            for i in triangles.iter().flatten() {
                out.push(first + number(*i)?);
            }
        } else {
            // Without normals surfaces are flat, so that corners are not shared.
            for t in &triangles {
                let [a, b, c] = t.map(place);
                let flat = (b - a).cross(c - a).try_normalize().unwrap_or(DVec3::Y).as_vec3();
                for i in t {
                    out.push(number(self.vertices.len())?);
                    self.positions.push(place(*i));
                    self.vertices.push(vertex(*i, flat));
                }
            }
        }
        if self.positions.iter().any(|p| !p.is_finite()) {
            bail!("a position is not finite");
        }
        Ok(())
    }
}

/// Corners of triangles; nothing of points and lines.
fn triangles(mode: gltf::mesh::Mode, indices: &[usize]) -> Vec<[usize; 3]> {
    use gltf::mesh::Mode;
    match mode {
        Mode::Triangles => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        Mode::TriangleStrip => {
            let turn =
                |(i, t): (usize, &[usize])| if i % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
            indices.windows(3).enumerate().map(turn).collect()
        }
        Mode::TriangleFan => {
            indices.get(1..).unwrap_or_default().windows(2).map(|t| [indices[0], t[0], t[1]]).collect()
        }
        _ => Vec::new(),
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0 to 65535")]
fn sixteen(x: f32) -> u16 {
    (x.clamp(0.0, 1.0) * 65535.0).round() as u16
}

/// `extras.lightmap.page` of a primitive.
fn page(primitive: &gltf::Primitive<'_>) -> Option<usize> {
    let extras: Value = gltf::json::deserialize::from_str(primitive.extras().as_ref()?.get()).ok()?;
    usize::try_from(extras.get("lightmap")?.get("page")?.as_u64()?).ok()
}

impl Material {
    /// The alpha below which nothing is there; -1 where alpha says no such thing.
    pub(crate) fn cutoff(&self) -> f32 {
        if let Alpha::Mask(cutoff) = self.alpha { cutoff } else { -1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gltf::mesh::Mode;

    #[test]
    fn strips_and_fans_become_triangles() {
        assert_eq!(triangles(Mode::TriangleStrip, &[0, 1, 2, 3]), [[0, 1, 2], [2, 1, 3]]);
        assert_eq!(triangles(Mode::TriangleFan, &[0, 1, 2, 3]), [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(triangles(Mode::Triangles, &[0, 1, 2, 3]), [[0, 1, 2]]);
        assert!(
            triangles(Mode::TriangleFan, &[]).is_empty() && triangles(Mode::Lines, &[0, 1, 2]).is_empty()
        );
    }

    #[test]
    fn nodes_in_a_circle_are_refused() {
        let json = br#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"children":[1]},{"children":[0]}]}"#;
        let mut json = json.to_vec();
        json.resize(json.len().next_multiple_of(4), b' ');
        let length = |n: usize| u32::try_from(n).unwrap_or(0).to_le_bytes();
        let glb =
            [&b"glTF"[..], &length(2), &length(20 + json.len()), &length(json.len()), &b"JSON"[..], &json];
        let refused = Scene::parse(&glb.concat(), 0).expect_err("a circle");
        assert!(refused.to_string().contains("is there twice"), "{refused}");
    }

    #[test]
    fn rays_meet_the_nearest_triangle() {
        let mut scene = Scene::default();
        for z in [-2.0, -1.0] {
            let n = u32::try_from(scene.vertices.len()).unwrap_or(0);
            for [x, y] in [[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]] {
                scene.vertices.push(Vertex { position: [x, y, z], ..Vertex::default() });
            }
            scene.indices.extend([n, n + 1, n + 2]);
        }
        assert_eq!(scene.meets(Vec3::ZERO, Vec3::NEG_Z * 0.5), Some(2.0));
        assert_eq!(scene.meets(Vec3::ZERO, Vec3::Z), None);
        assert_eq!(scene.meets(Vec3::new(0.9, 0.9, 0.0), Vec3::NEG_Z), None);
    }
}
