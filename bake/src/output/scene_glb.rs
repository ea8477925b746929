//! `scene.glb`: the input with final atlas coordinates in `TEXCOORD_1`.
//!
//! Every surface that has a place in the atlas gets it; vertices are repeated where the layout cut
//! the mesh. A mesh that several nodes show is repeated, sharing every accessor but
//! `TEXCOORD_1`; a node with `EXT_mesh_gpu_instancing` gets one child per instance. A second UV set
//! that textures use moves to a free number. Materials, nodes and primitives say which lightmap is
//! theirs, see `attach`. A mesh that only bounds a medium or light probes is no longer shown. All else of the document stays.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use serde_json::{Map, Value, json};

pub use super::attach::PageFile;
use super::{
    attach,
    glb::{self, NewAccessor, component_size, index, items},
};
use crate::{
    error::{Error, Finding, Result},
    geom::atlas::{Atlas, Layout, Placement},
    scene::{
        accessor::{AccessorData, Kind},
        document::Document,
        model::{BOUNDS, Scene},
    },
};

const INSTANCING: &str = "EXT_mesh_gpu_instancing";
const MESHOPT: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// Writes [`build`]'s file to `path`; returns its findings.
///
/// # Errors
/// As [`build`], and [`Error::Io`] if writing fails.
pub fn write(
    path: &Path,
    document: &Document,
    scene: &Scene,
    atlas: &Atlas,
    page_files: &[PageFile],
) -> Result<Vec<Finding>> {
    let (bytes, findings) = build(document, scene, atlas, page_files)?;
    std::fs::write(path, bytes).map_err(Error::io(path, "cannot write"))?;
    Ok(findings)
}

/// The bytes of `scene.glb`, and findings about what could not be taken over.
///
/// `scene` and `atlas` have to come from `document`; `page_files[n]` has the file names of page n.
///
/// # Errors
/// [`Error::Input`] if an accessor is broken or does not fit its layout, [`Error::Usage`] if the
/// file would exceed 4 GiB.
pub fn build(
    document: &Document,
    scene: &Scene,
    atlas: &Atlas,
    page_files: &[PageFile],
) -> Result<(Vec<u8>, Vec<Finding>)> {
    let mut writer = Writer {
        document,
        atlas,
        page_files,
        n_old: document.json.get("accessors").and_then(Value::as_array).map_or(0, Vec::len),
        added: Vec::new(),
        gathered: BTreeMap::new(),
        indices: BTreeMap::new(),
        coordinates: BTreeMap::new(),
        written: BTreeMap::new(),
        findings: Vec::new(),
    };
    let mut json = document.json.clone();
    attach::strip(&mut json);
    hide_bounds(&mut json, scene);
    let n_images = json.get("images").and_then(Value::as_array).map_or(0, Vec::len);
    let users = users(document, scene, atlas);
    let meshes = writer.meshes(&mut json, &users, scene.bounds.iter().map(|(_, mesh)| *mesh))?;
    point_nodes(document, &mut json, &users, &meshes)?;
    for (i, words) in node_words(document, &json, atlas, &users, page_files) {
        if let Some(node) = json["nodes"][i].as_object_mut() {
            attach::set_extras(node, words, &format!("nodes[{i}]"), &mut writer.findings);
        }
    }
    let pages = writer.written.values().map(|w| w.page).collect();
    let textures = attach::textures(&mut json, &pages, page_files);
    patch_materials(&mut json, &writer.written, &textures);
    clean_extensions(&mut json);
    let (bytes, more) = glb::pack(document, json, &writer.added, n_images)?;
    writer.findings.extend(more);
    Ok((bytes, writer.findings))
}

/// Where one primitive of a node lies.
#[derive(Clone, Copy, PartialEq)]
struct Placed<'a> {
    primitive: usize,
    placement: &'a Placement,
}

/// A node, or one GPU instance of it, that shows a mesh with places in the atlas.
struct User<'a> {
    node: usize,
    instance: Option<usize>,
    mesh: usize,
    placed: Vec<Placed<'a>>,
}

/// All users in the order of nodes and instances.
fn users<'a>(document: &Document, scene: &Scene, atlas: &'a Atlas) -> Vec<User<'a>> {
    let mut users: BTreeMap<(usize, Option<usize>), User<'a>> = BTreeMap::new();
    for (surface, placement) in scene.surfaces.iter().zip(&atlas.placements) {
        let (Some(placement), Some(source)) = (placement, scene.meshes.get(surface.mesh)) else { continue };
        let (mesh, primitive) = source.source;
        if index(&document.json["nodes"][surface.node]["mesh"]) != Some(mesh) {
            continue;
        }
        users
            .entry((surface.node, surface.gpu_instance))
            .or_insert_with(|| User {
                node: surface.node,
                instance: surface.gpu_instance,
                mesh,
                placed: Vec::new(),
            })
            .placed
            .push(Placed { primitive, placement });
    }
    users.into_values().collect()
}

/// A primitive with texels as it was written.
#[derive(Clone, Copy)]
struct Written {
    page: usize,
    /// New number of its second UV set, if that moved.
    second: Option<usize>,
}

struct Writer<'a> {
    document: &'a Document,
    atlas: &'a Atlas,
    page_files: &'a [PageFile],
    n_old: usize,
    added: Vec<NewAccessor>,
    /// (source accessor, layout) to the accessor with the layout's vertices.
    gathered: BTreeMap<(usize, usize), usize>,
    /// Layout to the accessor of its triangles.
    indices: BTreeMap<usize, usize>,
    /// (layout, page, rectangle) to the accessor of its texture coordinates.
    coordinates: BTreeMap<(usize, usize, [u32; 4]), usize>,
    /// By mesh and number of the primitive.
    written: BTreeMap<(usize, usize), Written>,
    findings: Vec<Finding>,
}

impl Writer<'_> {
    /// Writes the placed meshes, leaving those that are `bounds` as they are; the mesh index of each user.
    fn meshes(
        &mut self,
        json: &mut Value,
        users: &[User<'_>],
        bounds: impl Iterator<Item = usize>,
    ) -> Result<Vec<usize>> {
        let source = json["meshes"].as_array().cloned().unwrap_or_default();
        let mut meshes = source.clone();
        let mut kept = meshes_still_needed(self.document, users)?;
        kept.extend(bounds);
        let mut written: Vec<(usize, &[Placed<'_>], usize)> = Vec::new();
        let mut result = Vec::with_capacity(users.len());
        // Users of one mesh in the same place, as with an atlas that the file brought, share it.
        let mut of_mesh: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for user in users {
            let same = of_mesh.entry(user.mesh).or_default();
            if let Some(&w) = same.iter().find(|&&w| written[w].1 == user.placed) {
                result.push(written[w].2);
                continue;
            }
            // The first takes the source's own slot unless somebody shows the mesh unchanged.
            let slot = if kept.insert(user.mesh) { user.mesh } else { meshes.len() };
            let mut mesh = source.get(user.mesh).cloned().unwrap_or_default();
            for placed in &user.placed {
                let path = format!("meshes[{}].primitives[{}]", user.mesh, placed.primitive);
                let Some(primitive) = mesh["primitives"].get_mut(placed.primitive) else { continue };
                let second = self.primitive(primitive, placed, &path)?;
                let page = placed.placement.page;
                self.written.insert((slot, placed.primitive), Written { page, second });
            }
            if slot == meshes.len() {
                meshes.push(mesh);
            } else {
                meshes[slot] = mesh;
            }
            same.push(written.len());
            written.push((user.mesh, &user.placed, slot));
            result.push(slot);
        }
        glb::set_array(json, "meshes", meshes);
        Ok(result)
    }

    /// Rewrites a primitive for its place; the new number of its second UV set, if that moved.
    fn primitive(&mut self, primitive: &mut Value, placed: &Placed<'_>, path: &str) -> Result<Option<usize>> {
        let placement = placed.placement;
        let layout = &self.atlas.layouts[placement.layout];
        let moves = uses_second_set(&self.document.json, primitive);
        let mut attributes = Map::new();
        let mut second = None;
        for (name, value) in primitive["attributes"].as_object().into_iter().flatten() {
            // A second set that no texture uses makes way.
            if name == "TEXCOORD_1" && !moves {
                continue;
            }
            let gathered = self.gather(value, placement.layout, name == "POSITION", path)?;
            if name == "TEXCOORD_1" {
                second = Some(gathered);
            } else {
                attributes.insert(name.clone(), json!(gathered));
            }
        }
        let coordinates = self.coordinates(placement);
        // Sets are numbered without gaps, so a mesh without a first one gets the same again.
        attributes.entry("TEXCOORD_0").or_insert_with(|| json!(coordinates));
        attributes.insert("TEXCOORD_1".to_owned(), json!(coordinates));
        let mut moved = None;
        if let Some(second) = second {
            let free = (2..).find(|n| !attributes.contains_key(&format!("TEXCOORD_{n}"))).unwrap_or(2);
            attributes.insert(format!("TEXCOORD_{free}"), json!(second));
            moved = Some(free);
        }
        let mut targets = Vec::new();
        for target in primitive["targets"].as_array().into_iter().flatten() {
            let mut gathered = Map::new();
            for (name, value) in target.as_object().into_iter().flatten() {
                gathered.insert(
                    name.clone(),
                    json!(self.gather(value, placement.layout, name == "POSITION", path)?),
                );
            }
            targets.push(Value::Object(gathered));
        }
        let indices = self.triangles(placement.layout, layout);
        let Some(object) = primitive.as_object_mut() else { return Ok(None) };
        object.insert("attributes".to_owned(), Value::Object(attributes));
        object.insert("indices".to_owned(), json!(indices));
        if !targets.is_empty() {
            object.insert("targets".to_owned(), Value::Array(targets));
        }
        // Strips and fans have become lists.
        object.shift_remove("mode");
        attach::set_extras(object, attach::page(placement, self.page_files), path, &mut self.findings);
        Ok(moved)
    }

    fn add(&mut self, accessor: NewAccessor) -> usize {
        self.added.push(accessor);
        self.n_old + self.added.len() - 1
    }

    /// The accessor with the elements of `source` that the layout's vertices stand for.
    fn gather(&mut self, source: &Value, layout: usize, bounds: bool, path: &str) -> Result<usize> {
        let bad = |what: String| Error::from(Finding::error(path, what, "export the scene again"));
        let source = index(source).ok_or_else(|| bad(format!("`{source}` is not an accessor")))?;
        if let Some(&done) = self.gathered.get(&(source, layout)) {
            return Ok(done);
        }
        let data = self.document.accessor(source).map_err(Error::from)?;
        let vertices = &self.atlas.layouts[layout].vertices;
        let unchanged = vertices.len() == data.count && vertices.iter().zip(0..).all(|(&v, i)| v == i);
        let result = if unchanged {
            source
        } else {
            let size = data.kind.components() * component_size(data.component_type);
            let mut bytes = Vec::with_capacity(vertices.len() * size);
            for &vertex in vertices {
                let start = vertex as usize * size;
                let element = data.bytes.get(start..start + size).ok_or_else(|| {
                    bad(format!("vertex {vertex} is beyond the {} elements of accessor {source}", data.count))
                })?;
                bytes.extend_from_slice(element);
            }
            let name = self.document.json["accessors"][source].get("name").cloned();
            self.add(NewAccessor {
                data: AccessorData { count: vertices.len(), bytes, ..data },
                name,
                bounds,
            })
        };
        self.gathered.insert((source, layout), result);
        Ok(result)
    }

    fn triangles(&mut self, index: usize, layout: &Layout) -> usize {
        if let Some(&done) = self.indices.get(&index) {
            return done;
        }
        let corners = layout.triangles.as_flattened();
        // The largest 16-bit index would restart a strip and is forbidden, so 65535 vertices are
        // the most that 16 bits take.
        let short = layout.vertices.len() <= usize::from(u16::MAX);
        let (component_type, n_bytes) = if short { (5123, 2) } else { (5125, 4) };
        let bytes = corners.iter().flat_map(|c| c.to_le_bytes().into_iter().take(n_bytes)).collect();
        let data = AccessorData {
            component_type,
            kind: Kind::Scalar,
            normalized: false,
            count: corners.len(),
            bytes,
        };
        let added = self.add(NewAccessor { data, name: None, bounds: false });
        self.indices.insert(index, added);
        added
    }

    fn coordinates(&mut self, placement: &Placement) -> usize {
        let ([x, y], [w, h]) = (placement.min, placement.size);
        let key = (placement.layout, placement.page, [x, y, w, h]);
        if let Some(&done) = self.coordinates.get(&key) {
            return done;
        }
        let n_vertices = self.atlas.layouts[placement.layout].vertices.len();
        let mut bytes = Vec::with_capacity(8 * n_vertices);
        for vertex in (0..).take(n_vertices) {
            let uv = self.atlas.page_uv(placement, vertex);
            bytes.extend_from_slice(&uv.x.to_le_bytes());
            bytes.extend_from_slice(&uv.y.to_le_bytes());
        }
        let data = AccessorData {
            component_type: 5126,
            kind: Kind::Vec2,
            normalized: false,
            count: n_vertices,
            bytes,
        };
        let added = self.add(NewAccessor { data, name: Some(json!("lightmap")), bounds: false });
        self.coordinates.insert(key, added);
        added
    }
}

/// Meshes that some node, or some GPU instance of one, shows without any place in the atlas.
fn meshes_still_needed(document: &Document, users: &[User<'_>]) -> Result<BTreeSet<usize>> {
    let mut n_placed: BTreeMap<usize, usize> = BTreeMap::new();
    for user in users {
        *n_placed.entry(user.node).or_default() += 1;
    }
    let mut needed = BTreeSet::new();
    for (i, node) in document.json["nodes"].as_array().into_iter().flatten().enumerate() {
        let Some(mesh) = index(&node["mesh"]) else { continue };
        let n_shown = match node["extensions"].get(INSTANCING) {
            Some(_) => instance_transforms(document, i)?.len(),
            None => 1,
        };
        if n_placed.get(&i).copied().unwrap_or(0) < n_shown {
            needed.insert(mesh);
        }
    }
    Ok(needed)
}

/// Takes the meshes that only bound media and light probes from their nodes, so that nobody draws them; their extras keep the numbers
/// for another bake.
fn hide_bounds(json: &mut Value, scene: &Scene) {
    for (node, mesh) in &scene.bounds {
        let Some(node) = json["nodes"][*node].as_object_mut() else { continue };
        if let Some(extras) = node.entry("extras").or_insert_with(|| json!({})).as_object_mut() {
            extras.insert(BOUNDS.to_owned(), json!(mesh));
            for key in ["mesh", "skin", "weights"] {
                node.shift_remove(key);
            }
        }
    }
}

/// Gives each node its mesh, and one with GPU instances a child for each.
fn point_nodes(document: &Document, json: &mut Value, users: &[User<'_>], meshes: &[usize]) -> Result<()> {
    let mut instances: BTreeMap<usize, BTreeMap<usize, usize>> = BTreeMap::new();
    for (user, &mesh) in users.iter().zip(meshes) {
        match user.instance {
            None => json["nodes"][user.node]["mesh"] = json!(mesh),
            Some(instance) => {
                instances.entry(user.node).or_default().insert(instance, mesh);
            }
        }
    }
    for (node, meshes) in instances {
        let transforms = instance_transforms(document, node)?;
        let mut parent = json["nodes"][node].take();
        let first = json["nodes"].as_array().map_or(0, Vec::len);
        let mut children = Vec::with_capacity(transforms.len());
        for (i, transform) in transforms.into_iter().enumerate() {
            let mut child = Map::new();
            if let Some(name) = parent["name"].as_str() {
                child.insert("name".to_owned(), json!(format!("{name}.{i}")));
            }
            let mesh = meshes.get(&i).map_or_else(|| parent["mesh"].clone(), |m| json!(m));
            child.insert("mesh".to_owned(), mesh);
            child.extend(transform);
            if let Some(weights) = parent.get("weights") {
                child.insert("weights".to_owned(), weights.clone());
            }
            children.push(Value::Object(child));
        }
        if let Some(object) = parent.as_object_mut() {
            object.shift_remove("mesh");
            object.shift_remove("weights");
            if let Some(extensions) = object.get_mut("extensions").and_then(Value::as_object_mut) {
                extensions.shift_remove(INSTANCING);
                if extensions.is_empty() {
                    object.shift_remove("extensions");
                }
            }
            let list = object.entry("children").or_insert_with(|| json!([]));
            if let Some(list) = list.as_array_mut() {
                list.extend((first..first + children.len()).map(|i| json!(i)));
            }
        }
        json["nodes"][node] = parent;
        if let Some(nodes) = json["nodes"].as_array_mut() {
            nodes.extend(children);
        }
    }
    Ok(())
}

/// What nodes say of their lightmaps. The instances of a node have become its last children.
fn node_words(
    document: &Document,
    json: &Value,
    atlas: &Atlas,
    users: &[User<'_>],
    page_files: &[PageFile],
) -> Vec<(usize, Value)> {
    let children = |json: &Value, node: usize| json["nodes"][node]["children"].as_array().cloned();
    let node = |user: &User<'_>| match user.instance {
        None => Some(user.node),
        Some(instance) => {
            let n_before = children(&document.json, user.node).map_or(0, |c| c.len());
            children(json, user.node)?.get(n_before + instance).and_then(index)
        }
    };
    let words = |user: &User<'_>| {
        let place = |p: &Placed<'_>| attach::place(atlas, p.primitive, p.placement, page_files);
        Some((node(user)?, user.placed.iter().map(place).collect()))
    };
    users.iter().filter_map(words).collect()
}

/// `translation`, `rotation` and `scale` of each instance of a node.
fn instance_transforms(document: &Document, node: usize) -> Result<Vec<Map<String, Value>>> {
    let attributes = &document.json["nodes"][node]["extensions"][INSTANCING]["attributes"];
    let mut transforms: Vec<Map<String, Value>> = Vec::new();
    for (attribute, property) in
        [("TRANSLATION", "translation"), ("ROTATION", "rotation"), ("SCALE", "scale")]
    {
        let Some(i) = index(&attributes[attribute]) else { continue };
        let data = document.accessor(i).map_err(Error::from)?;
        let values = data.floats();
        if transforms.is_empty() {
            transforms.resize(data.count, Map::new());
        }
        for (transform, value) in transforms.iter_mut().zip(values.chunks_exact(data.kind.components())) {
            let mut value: Vec<f64> = value.iter().copied().map(f64::from).collect();
            if property == "rotation" {
                // Integers are rarely of unit length, which a node's rotation has to be.
                let length = value.iter().map(|v| v * v).sum::<f64>().sqrt();
                value.iter_mut().filter(|_| 0.0 < length).for_each(|v| *v /= length);
            }
            transform.insert(property.to_owned(), json!(value));
        }
    }
    if transforms.is_empty() {
        // Attributes that move nothing leave one instance where the node is.
        transforms.push(Map::new());
    }
    Ok(transforms)
}

/// The materials of a primitive, its variants' included.
fn materials(primitive: &Value) -> Vec<usize> {
    let mappings = primitive["extensions"]["KHR_materials_variants"]["mappings"].as_array();
    let variants = mappings.into_iter().flatten().map(|m| &m["material"]);
    std::iter::once(&primitive["material"]).chain(variants).filter_map(index).collect()
}

fn uses_second_set(json: &Value, primitive: &Value) -> bool {
    primitive["attributes"].get("TEXCOORD_1").is_some()
        && materials(primitive).iter().any(|&m| has_second_set(&json["materials"][m]))
}

/// Whether some texture of a material reads `TEXCOORD_1`.
fn has_second_set(material: &Value) -> bool {
    match material {
        Value::Object(object) => object.iter().any(|(key, value)| {
            key != "extras" && (is_texture(object, key) && value == &json!(1) || has_second_set(value))
        }),
        Value::Array(values) => values.iter().any(has_second_set),
        _ => false,
    }
}

/// Whether `texCoord` of `object` selects the UV set of a texture: it stands beside the texture's
/// `index`, or in a `KHR_texture_transform`, which has no other use for the word.
fn is_texture(object: &Map<String, Value>, key: &str) -> bool {
    key == "texCoord" && (object.contains_key("index") || !object.contains_key("extensions"))
}

/// Points a material's textures from the second set to set `to`.
fn move_second_set(material: &mut Value, to: usize) {
    match material {
        Value::Object(object) => {
            let selects = is_texture(object, "texCoord");
            for (key, value) in object.iter_mut().filter(|(key, _)| *key != "extras") {
                if key == "texCoord" && selects && *value == json!(1) {
                    *value = json!(to);
                } else {
                    move_second_set(value, to);
                }
            }
        }
        Value::Array(values) => values.iter_mut().for_each(|v| move_second_set(v, to)),
        _ => {}
    }
}

/// What becomes of the material of a primitive: with these it is another one.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
struct Change {
    /// Texture of its lightmap.
    lightmap: Option<usize>,
    /// New number of the second UV set, if that moved.
    second: Option<usize>,
}

impl Change {
    fn of(self, material: &Value) -> Value {
        let mut material = material.clone();
        if let Some(second) = self.second {
            move_second_set(&mut material, second);
        }
        if let Some(texture) = self.lightmap {
            attach::give(&mut material, texture);
        }
        material
    }
}

/// Gives the materials of placed primitives their lightmaps, and points them to second UV sets that
/// moved. A material that others use differently is copied; a primitive without one gets glTF's default.
fn patch_materials(
    json: &mut Value,
    written: &BTreeMap<(usize, usize), Written>,
    textures: &BTreeMap<usize, usize>,
) {
    let change = |mesh: usize, primitive: usize| {
        written.get(&(mesh, primitive)).map_or_else(Change::default, |w| Change {
            lightmap: textures.get(&w.page).copied(),
            second: w.second,
        })
    };
    let mut wanted: BTreeMap<Option<usize>, BTreeSet<Change>> = BTreeMap::new();
    for (m, mesh) in items(json, "meshes").enumerate() {
        for (p, primitive) in items(mesh, "primitives").enumerate() {
            let change = change(m, p);
            if primitive.get("material").is_none() && change.lightmap.is_some() {
                wanted.entry(None).or_default().insert(change);
            }
            for i in materials(primitive) {
                wanted.entry(Some(i)).or_default().insert(change);
            }
        }
    }
    let source = json["materials"].as_array().cloned().unwrap_or_default();
    let mut result = source.clone();
    let mut place: BTreeMap<(Option<usize>, Change), usize> = BTreeMap::new();
    for (&i, changes) in &wanted {
        let default = json!({});
        let Some(material) = i.map_or(Some(&default), |i| source.get(i)) else { continue };
        let mut made: Vec<(Value, usize)> = Vec::new();
        for &change in changes {
            let changed = change.of(material);
            let there = made.iter().find(|(m, _)| *m == changed).map(|(_, at)| *at);
            let at = there.unwrap_or_else(|| match i.filter(|_| made.is_empty()) {
                Some(i) => {
                    result[i] = changed.clone();
                    i
                }
                None => {
                    result.push(changed.clone());
                    result.len() - 1
                }
            });
            made.push((changed, at));
            place.insert((i, change), at);
        }
    }
    for (m, mesh) in items(json, "meshes").enumerate() {
        for (p, primitive) in items(mesh, "primitives").enumerate() {
            let change = change(m, p);
            let new = |value: Option<&Value>| place.get(&(value.and_then(index), change)).copied();
            if let Some(new) = new(primitive.get("material"))
                && let Some(object) = primitive.as_object_mut()
            {
                object.insert("material".to_owned(), json!(new));
            }
            if let Some(variants) = primitive.pointer_mut("/extensions/KHR_materials_variants") {
                for mapping in items(variants, "mappings") {
                    if let Some(new) = mapping.get("material").and_then(|m| new(Some(m))) {
                        mapping["material"] = json!(new);
                    }
                }
            }
        }
    }
    glb::set_array(json, "materials", result);
}

/// Names of extensions that the file no longer has.
fn clean_extensions(json: &mut Value) {
    let nodes = json["nodes"].as_array().into_iter().flatten();
    let instancing = nodes.into_iter().any(|n| n["extensions"].get(INSTANCING).is_some());
    for list in ["extensionsUsed", "extensionsRequired"] {
        glb::remove_names(json, list, |name| {
            let name = name.as_str().unwrap_or_default();
            MESHOPT.contains(&name) || name == INSTANCING && !instancing
        });
    }
}

#[cfg(test)]
#[path = "scene_glb_tests.rs"]
mod tests;
