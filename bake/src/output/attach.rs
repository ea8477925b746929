//! How `scene.glb` says which lightmap belongs to what.
//!
//! Three ways, for three kinds of readers; none is needed to load the file.
//!
//! - Materials have the draft extension `MOZ_lightmap`: `index` of a texture, `texCoord` 1,
//!   `intensity` 1. The texture's image is the page as KTX 2 beside the file. A material on several
//!   pages is repeated. Without such files there is no such extension.
//! - Nodes have a list `extras.lightmap` with an entry for each primitive that has texels: `primitive`,
//!   `page`, `file`, `texture`, `rect` in texels, `uv_rect` in [0, 1], and `unit`. `TEXCOORD_1` is final, so
//!   rectangles are for information alone.
//! - Primitives have `extras.lightmap` with `page`, `file` and `texture`.
//!
//! [`strip`] removes all of it, so that a file that was baked can be baked again.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value, json};
use tables::format::manifest::{Rect, UNIT};

use super::glb::{self, index, items};
use crate::error::Finding;
use crate::geom::atlas::{Atlas, Placement};

/// The extension of materials.
pub(super) const EXTENSION: &str = "MOZ_lightmap";

/// File names of a page.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageFile {
    /// The page as EXR.
    pub exr: String,
    /// The page as engines take it; `None` where there is none.
    pub texture: Option<String>,
}

/// What a primitive says of its place: page and files.
pub(super) fn page(placement: &Placement, page_files: &[PageFile]) -> Value {
    let mut page = json!({ "page": placement.page });
    if let Some(file) = page_files.get(placement.page) {
        page["file"] = json!(file.exr);
        if let Some(texture) = &file.texture {
            page["texture"] = json!(texture);
        }
    }
    page
}

/// What a node says of the place of one of its primitives.
pub(super) fn place(
    atlas: &Atlas,
    primitive: usize,
    placement: &Placement,
    page_files: &[PageFile],
) -> Value {
    let size = atlas.pages[placement.page];
    let ([x, y], [width, height]) = (placement.min, placement.size);
    let rect = Rect { x, y, width, height };
    let mut place = json!({ "primitive": primitive });
    if let (Some(place), Value::Object(page)) = (place.as_object_mut(), page(placement, page_files)) {
        place.extend(page);
    }
    place["rect"] = json!(rect);
    place["uv_rect"] = json!(rect.to_uv(size.width, size.height));
    place["unit"] = json!(UNIT);
    place
}

/// Sets `extras.lightmap` of a node or primitive at `path`. Extras that are no object stay as they are, which is a finding.
pub(super) fn set_extras(
    owner: &mut Map<String, Value>,
    lightmap: Value,
    path: &str,
    findings: &mut Vec<Finding>,
) {
    let extras = owner.entry("extras").or_insert_with(|| json!({}));
    if let Some(extras) = extras.as_object_mut() {
        extras.insert("lightmap".to_owned(), lightmap);
    } else {
        let what = "is no object, so it cannot name its lightmap, and pages and engines that look there will miss it";
        findings.push(Finding::warning(format!("{path}.extras"), what, "make it an object, or remove it"));
    }
}

/// Adds a texture for each of `pages`: linear, clamped, without smaller copies, which would mix
/// charts. The index of each page's texture.
pub(super) fn textures(
    json: &mut Value,
    pages: &BTreeSet<usize>,
    page_files: &[PageFile],
) -> BTreeMap<usize, usize> {
    let files: Vec<(usize, &String)> =
        pages.iter().filter_map(|&p| Some((p, page_files.get(p)?.texture.as_ref()?))).collect();
    if files.is_empty() {
        return BTreeMap::new();
    }
    let sampler = json!({ "magFilter": 9729, "minFilter": 9729, "wrapS": 33071, "wrapT": 33071 });
    let sampler = push_new(json, "samplers", sampler);
    let mut places = BTreeMap::new();
    for (page, file) in files {
        let name = file.strip_suffix(".ktx2").unwrap_or(file);
        let image = push(json, "images", json!({ "name": name, "uri": file }));
        places.insert(
            page,
            push(json, "textures", json!({ "name": name, "sampler": sampler, "source": image })),
        );
    }
    add_name(json, "extensionsUsed", EXTENSION);
    places
}

/// Gives a material the lightmap of a texture, unless it takes no light.
pub(super) fn give(material: &mut Value, texture: usize) {
    let Some(material) = material.as_object_mut() else { return };
    // Extensions that are no object are an error of the file that nothing here depends on.
    let extensions = material.entry("extensions").or_insert_with(|| json!({}));
    let Some(extensions) = extensions.as_object_mut() else { return };
    if !extensions.contains_key("KHR_materials_unlit") {
        let lightmap = json!({ "index": texture, "texCoord": 1, "intensity": 1 });
        extensions.insert(EXTENSION.to_owned(), lightmap);
    }
}

/// Removes what an earlier bake attached.
pub(super) fn strip(json: &mut Value) {
    let mut textures = BTreeSet::new();
    for material in items(json, "materials") {
        if let Some(extensions) = material.get_mut("extensions").and_then(Value::as_object_mut) {
            textures.extend(extensions.shift_remove(EXTENSION).and_then(|e| index(&e["index"])));
            if extensions.is_empty() {
                material.as_object_mut().and_then(|m| m.shift_remove("extensions"));
            }
        }
    }
    glb::remove_names(json, "extensionsUsed", |name| name == EXTENSION);
    glb::remove_names(json, "extensionsRequired", |name| name == EXTENSION);
    // Whatever else may use one of them, extensions that nobody here knows included.
    for key in ["materials", "nodes", "meshes", "scenes"] {
        for user in items(json, key) {
            visit_keys(user, "index", &mut |i| {
                textures.remove(&i);
            });
        }
    }
    if let Some(extensions) = json.get("extensions") {
        visit_keys(extensions, "index", &mut |i| {
            textures.remove(&i);
        });
    }
    // They were added last. Those that are not the last now stay, since others are counted after them.
    let mut images = BTreeSet::new();
    while let Some((i, texture)) = last(json, "textures").filter(|(i, _)| textures.contains(i)) {
        images.extend(index(&texture["source"]));
        textures.remove(&i);
        pop(json, "textures");
    }
    for texture in items(json, "textures") {
        visit_keys(texture, "source", &mut |i| {
            images.remove(&i);
        });
    }
    while last(json, "images").is_some_and(|(i, _)| images.remove(&i)) {
        pop(json, "images");
    }
    for node in items(json, "nodes") {
        strip_extras(node);
    }
    for mesh in items(json, "meshes") {
        items(mesh, "primitives").for_each(strip_extras);
    }
}

/// Removes `extras.lightmap` unless it is a word for the baker.
fn strip_extras(owner: &mut Value) {
    let Some(extras) = owner.get_mut("extras").and_then(Value::as_object_mut) else { return };
    if extras.get("lightmap").is_some_and(|l| l.is_array() || l.is_object()) {
        extras.shift_remove("lightmap");
        if extras.is_empty() {
            owner.as_object_mut().and_then(|o| o.shift_remove("extras"));
        }
    }
}

/// Calls `visit` with every index that stands under `name`, at any depth.
fn visit_keys(json: &Value, name: &str, visit: &mut dyn FnMut(usize)) {
    match json {
        Value::Object(object) => {
            object.get(name).and_then(index).into_iter().for_each(&mut *visit);
            object.iter().filter(|(key, _)| *key != "extras").for_each(|(_, v)| visit_keys(v, name, visit));
        }
        Value::Array(values) => values.iter().for_each(|v| visit_keys(v, name, visit)),
        _ => {}
    }
}

fn last(json: &Value, key: &str) -> Option<(usize, Value)> {
    let list = json.get(key)?.as_array()?;
    Some((list.len().checked_sub(1)?, list.last()?.clone()))
}

fn pop(json: &mut Value, key: &str) {
    let mut list = json[key].as_array().cloned().unwrap_or_default();
    list.pop();
    glb::set_array(json, key, list);
}

/// Appends to a root array; the index.
fn push(json: &mut Value, key: &str, value: Value) -> usize {
    let mut list = json.get(key).and_then(Value::as_array).cloned().unwrap_or_default();
    list.push(value);
    let n = list.len();
    glb::set_array(json, key, list);
    n - 1
}

/// [`push`] unless it is there.
fn push_new(json: &mut Value, key: &str, value: Value) -> usize {
    let there = json.get(key).and_then(Value::as_array);
    let there = there.and_then(|list| list.iter().position(|v| *v == value));
    there.unwrap_or_else(|| push(json, key, value))
}

fn add_name(json: &mut Value, list: &str, name: &str) {
    push_new(json, list, json!(name));
}
