//! From a document to a scene: everything comes together, and all findings are collected.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use glam::{Affine3A, Quat, Vec3};
use serde_json::Value;

use super::{
    config::{Config, NodeWords, SceneWords},
    density::{Files, Place, Source, settle},
    document::Document,
    findings::Findings,
    gltf_material, gltf_mesh,
    gltf_nodes::{self, Hierarchy, NodeIndex, Placed},
    media_words::Unplaced,
    model::{
        BOUNDS, Camera, Density, Light, LightKind, LightMode, LightmapMode, Medium, Mesh, ProbeBox, Region,
        Scene, Shell, Sky, Surface,
    },
    read::{index_of, shown},
    sky,
};
use crate::error::Finding;

pub use super::gltf_nodes::LightUnits;

/// A bake has at most this many surfaces; a hostile instance count must not fill the memory.
const MAX_SURFACES: usize = 1 << 20;

/// What the command line says about loading.
#[derive(Clone, Debug, Default)]
pub struct LoadOptions {
    /// How the intensities of `KHR_lights_punctual` are meant.
    pub light_units: LightUnits,
    /// Stands above the sky of configuration and file, see [`super::sky::parse_sky`].
    pub sky: Option<Sky>,
    /// The number that stands for `#` in the names of files of volumes.
    pub frame: Option<u32>,
}

/// Makes the scene of a document, in world units, with all findings, gravest first.
///
/// The scene is to be used only where no finding is an error. Precedence is options, then
/// `config`, then the file's extras, then its extensions.
pub fn load(doc: &Document, config: &Config, options: &LoadOptions) -> (Scene, Vec<Finding>) {
    let mut out = Findings::default();
    let mut scene = Scene { name: doc.name().to_owned(), ..Scene::default() };
    config.inputs.iter().for_each(|input| doc.add_input(input.clone()));
    out.extend(doc.buffer_findings());
    super::check::references(doc, &mut out);
    if let Some(tree) = Hierarchy::new(doc, &mut out) {
        let (placed, chosen) = tree.place(&mut out);
        let null = Value::Null;
        let json = chosen.map_or(&null, |c| &doc.json["scenes"][c]);
        let path = format!("scenes[{}]", chosen.unwrap_or(0));
        let mut inputs = Vec::new();
        let dir = doc.base_dir();
        let extras = match json.get("extras") {
            Some(extras) => {
                let mut files = Files { dir, inputs: &mut inputs, frame: options.frame };
                SceneWords::read(extras, &format!("{path}.extras"), &mut files, &mut out)
            }
            None => SceneWords::default(),
        };
        inputs.into_iter().for_each(|input| doc.add_input(input));
        let file_sky = || sky::image_based(doc, json, &path, &mut out);
        let wished =
            options.sky.clone().or_else(|| config.scene.sky.clone()).or(extras.sky).or_else(file_sky);
        scene.texels_per_metre = config.scene.texels_per_metre.or(extras.texels_per_metre);
        let metals_black = config.scene.metals_black.or(extras.metals_black).unwrap_or(false);
        scene.metals_black = metals_black;
        let mut builder = Builder {
            doc,
            tree: &tree,
            options,
            meshes: BTreeMap::new(),
            corners: Vec::new(),
            scene: &mut scene,
            out: &mut out,
        };
        builder.nodes(&placed, config);
        let used: BTreeSet<usize> = scene.surfaces.iter().map(|s| s.material).collect();
        (scene.materials, scene.images) = gltf_material::load(doc, &used, metals_black, &mut out);
        lamps(&mut scene.lights, &extras.lamps, &config.scene.lamps);
        let of_nodes = std::mem::take(&mut scene.probe_boxes);
        scene.probe_boxes = config.scene.probes.clone().or(extras.probes);
        if let Some(boxes) = of_nodes {
            scene.probe_boxes.get_or_insert_default().extend(boxes);
        }
        scene.media.extend(extras.media);
        scene.media.extend(config.scene.media.iter().cloned());
        check_uv_sets(&mut scene, &mut out);
        ensure_light(&mut scene, wished, &mut out);
        check_media(&scene, &mut out);
    }
    if scene.surfaces.is_empty() && !out.any_error() {
        out.push(Finding::error(
            "scene",
            "there is not a single triangle to bake",
            "add meshes to the scene",
        ));
    }
    (scene, out.finish())
}

/// Lamps of the configuration replace those of the extras that have the same name.
fn lamps(lights: &mut Vec<Light>, extras: &[Light], config: &[Light]) {
    let replaced = |lamp: &&Light| !config.iter().any(|c| c.path == lamp.path);
    lights.extend(extras.iter().filter(replaced).cloned());
    lights.extend(config.iter().cloned());
}

/// Chooses the sky; a scene without any light gets a uniform one, so that it is not black.
fn ensure_light(scene: &mut Scene, wished: Option<Sky>, out: &mut Findings) {
    let lit = |l: &Light| match l.kind {
        LightKind::Point { intensity, .. } | LightKind::Spot { intensity, .. } => {
            0.0 < intensity.max_element()
        }
        LightKind::Directional { illuminance, .. } => 0.0 < illuminance.max_element(),
    };
    let lamps = scene.lights.iter().any(lit);
    let glows = |s: &Surface| {
        let m = &scene.materials[s.material];
        0.0 < m.emission.max_element() && !m.unlit
    };
    let emission = scene.surfaces.iter().any(glows) || scene.media.iter().any(|m| m.emission != Vec3::ZERO);
    match wished {
        Some(sky) => scene.sky = sky,
        None if lamps || emission => {}
        None => {
            scene.sky = Sky::Uniform(Vec3::ONE);
            out.push(Finding::warning(
                "scene",
                "the scene has no light; a uniform sky of 1 nit lights it",
                "add lights, emission or a sky (--sky COLOUR|FILE)",
            ));
        }
    }
    let only_dynamic = scene.lights.iter().filter(|l| lit(l)).all(|l| l.mode == LightMode::Dynamic);
    if matches!(scene.sky, Sky::Black) && !emission && only_dynamic {
        let what = "nothing is baked: the sky is black, no surface glows and no lamp has mode baked or mixed";
        out.push(Finding::warning("scene", what, "bake a lamp, or add a sky"));
    }
}

/// Names lights that no medium lets through, and more media than there may be.
fn check_media(scene: &Scene, out: &mut Findings) {
    if MOST_MEDIA < scene.media.len() {
        let what = format!("{} media, and {MOST_MEDIA} are possible", scene.media.len());
        out.push(Finding::error("media", what, "merge media"));
    }
    let endless = |m: &&Medium| m.region == Region::Everywhere && m.density == Density::Constant && m.dims();
    let Some(medium) = scene.media.iter().find(endless) else { return };
    let sun = scene.lights.iter().find(|l| matches!(l.kind, LightKind::Directional { .. }));
    let far = match (sun, &scene.sky) {
        (Some(sun), _) => sun.path.clone(),
        (None, Sky::Black) => return,
        (None, _) => "the sky".to_owned(),
    };
    let what =
        format!("the medium has no end, so no light of {far} comes through it where it absorbs or scatters");
    out.push(Finding::warning(&medium.path, what, "give the medium a `box`"));
}

/// Drops textures whose coordinates a mesh does not have, where no mesh of the material has them.
fn check_uv_sets(scene: &mut Scene, out: &mut Findings) {
    let Scene { surfaces, meshes, materials, .. } = scene;
    let pairs: BTreeSet<(usize, usize)> = surfaces.iter().map(|s| (s.material, s.mesh)).collect();
    for (material, mesh) in pairs {
        let (material, mesh) = (&materials[material], &meshes[mesh]);
        let slots =
            [&material.base_color_texture, &material.emission_texture, &material.transmission_texture];
        for set in slots.into_iter().flatten().map(|t| t.uv_set) {
            if mesh.uvs.get(set).is_none_or(Vec::is_empty) {
                let (m, p) = mesh.source;
                let what =
                    format!("material `{}` uses TEXCOORD_{set}, which the primitive lacks", material.name);
                let fix = "add the coordinates; without them textures are read at (0, 0)";
                out.push(Finding::warning(format!("meshes[{m}].primitives[{p}].attributes"), what, fix));
            }
        }
    }
}

/// Most media of a scene: what a ray is inside of has one bit for each.
pub const MOST_MEDIA: usize = 64;

struct Builder<'a> {
    doc: &'a Document,
    tree: &'a Hierarchy<'a>,
    options: &'a LoadOptions,
    /// Index into the scene's meshes by glTF mesh and primitive; `None` where it cannot be baked.
    meshes: BTreeMap<(usize, usize), Option<usize>>,
    /// Bounding box corners of the scene's meshes.
    corners: Vec<[Vec3; 8]>,
    scene: &'a mut Scene,
    out: &'a mut Findings,
}

impl Builder<'_> {
    fn nodes(&mut self, placed: &[Placed], config: &Config) {
        let mut budget = gltf_mesh::Budget::new(self.doc);
        let mut index = NodeIndex::new(&config.nodes);
        for at in placed {
            let json = self.tree.node(at.node);
            let mut words = index.find(self.tree, at.node);
            let mut medium = None;
            if let Some(extras) = json.get("extras") {
                let path = format!("nodes[{}].extras", at.node);
                words = words.over(NodeWords::read(extras, &path, true, self.out));
                let mut inputs = Vec::new();
                let frame = self.options.frame;
                let mut files = Files { dir: self.doc.base_dir(), inputs: &mut inputs, frame };
                medium = super::media_words::node_medium(extras, &path, &mut files, self.out);
                inputs.into_iter().for_each(|input| self.doc.add_input(input));
            }
            let light = gltf_nodes::light(self.doc, self.tree, at, self.options.light_units, words, self.out);
            self.scene.lights.extend(light);
            let camera: Option<Camera> = gltf_nodes::camera(self.doc, self.tree, at, self.out);
            self.scene.cameras.extend(camera);
            let bounded = medium.is_some();
            if let Some((medium, bounds)) = medium {
                // In the place of the mesh, which is not a surface then.
                self.medium(at, json, medium, bounds, &mut budget);
            }
            if let Some(spacing) = words.probes {
                self.probes(at, json, spacing, &mut budget);
            }
            if bounded || words.probes.is_some() {
                self.scene.bounds.extend(bounds_of(json).map(|mesh| (at.node, mesh)));
            } else if json.get("mesh").is_some() {
                self.surfaces(at, json, words, &mut budget);
            }
        }
        let names: Vec<String> = placed.iter().map(|p| self.tree.name(p.node)).collect();
        index.finish(&names, self.out);
        let used: BTreeSet<usize> = self.meshes.keys().map(|(mesh, _)| *mesh).collect();
        super::check::unused_meshes(self.doc, &used, &mut budget, self.out);
    }

    /// A medium in a node's mesh, or in the mesh's bounds.
    fn medium(
        &mut self,
        at: &Placed,
        json: &Value,
        Unplaced { medium, source, path, glows }: Unplaced,
        bounds: bool,
        budget: &mut gltf_mesh::Budget,
    ) {
        let place = format!("nodes[{}]", at.node);
        let world_from_node = gltf_nodes::single_affine(at.world);
        let mut medium = Medium { path: self.tree.path(at.node), ..medium };
        let mesh = bounds_of(json);
        let mut world_from_unit = None;
        if let Some(mesh) = mesh {
            let list = self.doc.json["meshes"].get(mesh).and_then(|m| m["primitives"].as_array());
            let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            let mut shell = Shell::default();
            for p in 0..list.map_or(0, Vec::len) {
                let Some(index) = self.mesh(mesh, p, budget) else { continue };
                low = low.min(self.corners[index][0]);
                high = high.max(self.corners[index][7]);
                let part = &self.scene.meshes[index];
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "the loader admits fewer than 2^32 vertices"
                )]
                let first = shell.positions.len() as u32;
                shell.positions.extend(part.positions.iter().map(|p| world_from_node.transform_point3(*p)));
                shell.triangles.extend(part.triangles.iter().map(|t| t.map(|i| first + i)));
            }
            let to =
                world_from_node * Affine3A::from_scale_rotation_translation(high - low, Quat::IDENTITY, low);
            let unit_from_world = to.inverse();
            if !(low.cmplt(high).all() && to.is_finite() && unit_from_world.is_finite()) {
                let what = "a medium needs the bounds of a mesh with a volume";
                self.out.push(Finding::error(place, what, "give the node a mesh, and no scale of 0"));
                return;
            }
            world_from_unit = Some(to);
            medium.region =
                if bounds { Region::Turned { unit_from_world } } else { Region::Mesh(Arc::new(shell)) };
        } else if !matches!(source, Source::Grid(_))
            && (medium.acts() || !glows.iter().any(|g| matches!(g.source, Some(Source::Grid(_)))))
        {
            let what = "a medium needs a mesh to be in";
            self.out.push(Finding::error(
                place,
                what,
                "give the node a mesh, or the medium a grid from a VDB file",
            ));
            return;
        }
        let unplaced = Unplaced { medium, source, path, glows };
        let settled =
            settle(unplaced, Place { world_from_space: world_from_node, world_from_unit }, self.out);
        self.scene.media.extend(settled);
    }

    /// Light probes in the bounds of a node's mesh, metres along the axes of the scene.
    fn probes(&mut self, at: &Placed, json: &Value, spacing: f32, budget: &mut gltf_mesh::Budget) {
        let path = format!("nodes[{}]", at.node);
        let Some(mesh) = bounds_of(json) else {
            let fix = "give the node a mesh such as a cube, or write a box in the scene's `probes`";
            self.out.push(Finding::error(path, "probes need a mesh whose bounds they fill", fix));
            return;
        };
        let world_from_node = gltf_nodes::single_affine(at.world);
        let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let list = self.doc.json["meshes"].get(mesh).and_then(|m| m["primitives"].as_array());
        for p in 0..list.map_or(0, Vec::len) {
            let Some(index) = self.mesh(mesh, p, budget) else { continue };
            for corner in self.corners[index].map(|c| world_from_node.transform_point3(c)) {
                min = min.min(corner);
                max = max.max(corner);
            }
        }
        if !min.cmplt(max).all() {
            let fix = "give the node a mesh with a volume, and no scale of 0";
            self.out.push(Finding::error(path, "the bounds that probes should fill are empty", fix));
            return;
        }
        let boxed = super::probe_words::checked(ProbeBox { path, min, max, spacing }, self.out);
        self.scene.probe_boxes.get_or_insert_default().extend(boxed);
    }

    fn surfaces(&mut self, at: &Placed, json: &Value, words: NodeWords, budget: &mut gltf_mesh::Budget) {
        let place = format!("nodes[{}].mesh", at.node);
        let fix = "correct the node and export again";
        let value = &json["mesh"];
        let Some((mesh, list)) = index_of(value).and_then(|i| Some((i, self.doc.json["meshes"].get(i)?)))
        else {
            self.out.push(Finding::error(place, format!("there is no mesh {}", shown(value)), fix));
            return;
        };
        let Some(primitives) = list["primitives"].as_array().filter(|p| !p.is_empty()) else {
            let path = format!("meshes[{mesh}].primitives");
            self.out.push(Finding::error(path, "missing, empty, or not a list", "give the mesh primitives"));
            return;
        };
        if json.get("skin").is_some() {
            let path = format!("nodes[{}].skin", at.node);
            self.out.push(Finding::info(path, "skinned meshes are baked in their base pose", "nothing"));
        }
        let room = MAX_SURFACES - self.scene.surfaces.len();
        let copies = gltf_nodes::instances(self.doc, json, at.node, room / primitives.len(), self.out);
        let copies: Vec<_> = match copies {
            Some(list) => list.into_iter().enumerate().map(|(i, t)| (Some(i), at.world * t)).collect(),
            None => vec![(None, at.world)],
        };
        if room < copies.len().saturating_mul(primitives.len()) {
            self.out.push(Finding::error(
                place,
                format!("the scene has more than {MAX_SURFACES} surfaces"),
                "merge meshes",
            ));
            return;
        }
        let path = self.tree.path(at.node);
        for (p, primitive) in primitives.iter().enumerate() {
            let (Some(index), Some(material)) =
                (self.mesh(mesh, p, budget), self.material(mesh, p, primitive))
            else {
                continue;
            };
            for (gpu_instance, world) in &copies {
                let world_from_mesh = gltf_nodes::single_affine(*world);
                // A large scale can carry finite vertices to infinity.
                let far = |v: &Vec3| !world_from_mesh.transform_point3(*v).is_finite();
                if !world_from_mesh.is_finite() || self.corners[index].iter().any(far) {
                    let what = "vertices are beyond what 32-bit numbers hold once in the world";
                    self.out.push(Finding::error(&place, what, "make scales and translations smaller"));
                    continue;
                }
                self.scene.surfaces.push(Surface {
                    path: path.clone(),
                    node: at.node,
                    gpu_instance: *gpu_instance,
                    mesh: index,
                    material,
                    world_from_mesh,
                    lightmap: words.lightmap.unwrap_or(LightmapMode::On),
                    casts_shadow: words.casts_shadow.unwrap_or(true),
                    texels_per_metre: words.texels_per_metre,
                });
            }
        }
    }

    fn mesh(&mut self, mesh: usize, primitive: usize, budget: &mut gltf_mesh::Budget) -> Option<usize> {
        if let Some(known) = self.meshes.get(&(mesh, primitive)) {
            return *known;
        }
        let loaded: Option<Mesh> = gltf_mesh::load(self.doc, mesh, primitive, budget, self.out);
        let index = loaded.map(|m| {
            self.corners.push(corners(&m.positions));
            self.scene.meshes.push(m);
            self.scene.meshes.len() - 1
        });
        self.meshes.insert((mesh, primitive), index);
        index
    }

    /// Index of a primitive's material; the default one comes after all others.
    fn material(&mut self, mesh: usize, primitive: usize, json: &Value) -> Option<usize> {
        let count = self.doc.json.get("materials").and_then(Value::as_array).map_or(0, Vec::len);
        let Some(value) = json.get("material") else { return Some(count) };
        let found = index_of(value).filter(|i| *i < count);
        if found.is_none() {
            let path = format!("meshes[{mesh}].primitives[{primitive}].material");
            let what = format!("there is no material {}", shown(value));
            self.out.push(Finding::error(path, what, "name a material that exists, or none"));
        }
        found
    }
}

/// The mesh in whose place something else is. A file that was baked has its number in the extras, so that nobody draws it.
fn bounds_of(node: &Value) -> Option<usize> {
    node.get("mesh").or_else(|| node["extras"].get(BOUNDS)).and_then(index_of)
}

fn corners(positions: &[Vec3]) -> [Vec3; 8] {
    let low = positions.iter().copied().fold(Vec3::INFINITY, Vec3::min);
    let high = positions.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
    std::array::from_fn(|i| Vec3::select(glam::BVec3::new(i & 1 != 0, i & 2 != 0, i & 4 != 0), high, low))
}
