//! Packs accessors and images into the binary chunk of a GLB.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};

use crate::{
    error::{Error, Finding, Result, Severity},
    scene::{
        accessor::{AccessorData, Kind},
        document::Document,
    },
};

/// How an accessor is used, which decides how its values are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Use {
    /// Vertex attributes and morph targets: elements begin at multiples of four bytes.
    Vertices,
    /// Triangle indices.
    Indices,
    /// Animations, skins, instances.
    Other,
}

/// An accessor that the source does not have.
#[derive(Clone, Debug)]
pub(super) struct NewAccessor {
    /// Its values.
    pub(super) data: AccessorData,
    /// Name for people, where it has one.
    pub(super) name: Option<Value>,
    /// Whether to state the smallest and largest value, as glTF wants for positions.
    pub(super) bounds: bool,
}

/// Calls `visit` for every reference to an accessor that glTF 2.0 and the extensions we know have.
pub(super) fn visit_accessors(json: &mut Value, visit: &mut dyn FnMut(&mut Value, Use)) {
    for mesh in items(json, "meshes") {
        for primitive in items(mesh, "primitives") {
            for (_, index) in members(primitive.get_mut("attributes")) {
                visit(index, Use::Vertices);
            }
            for target in items(primitive, "targets") {
                for (_, index) in members(Some(target)) {
                    visit(index, Use::Vertices);
                }
            }
            if let Some(index) = primitive.get_mut("indices") {
                visit(index, Use::Indices);
            }
        }
    }
    for skin in items(json, "skins") {
        if let Some(index) = skin.get_mut("inverseBindMatrices") {
            visit(index, Use::Other);
        }
    }
    for animation in items(json, "animations") {
        for sampler in items(animation, "samplers") {
            for key in ["input", "output"] {
                if let Some(index) = sampler.get_mut(key) {
                    visit(index, Use::Other);
                }
            }
        }
    }
    for node in items(json, "nodes") {
        let attributes = node.pointer_mut("/extensions/EXT_mesh_gpu_instancing/attributes");
        for (_, index) in members(attributes) {
            visit(index, Use::Other);
        }
    }
}

/// The entries of an array property; none where it is absent or no array.
pub(super) fn items<'a>(json: &'a mut Value, key: &str) -> impl Iterator<Item = &'a mut Value> {
    json.get_mut(key).and_then(Value::as_array_mut).into_iter().flatten()
}

fn members(json: Option<&mut Value>) -> impl Iterator<Item = (&String, &mut Value)> {
    json.and_then(Value::as_object_mut).into_iter().flatten()
}

/// An index as glTF writes it.
pub(super) fn index(value: &Value) -> Option<usize> {
    usize::try_from(value.as_u64()?).ok()
}

/// Puts the accessors that `json` refers to, and its first `n_images` images, which are those of the
/// document, into one GLB. Later images lie beside it.
///
/// References below the number of the document's accessors mean those, others `added` in order.
/// Accessors without references are left out, and with them their data.
pub(super) fn pack(
    document: &Document,
    mut json: Value,
    added: &[NewAccessor],
    n_images: usize,
) -> Result<(Vec<u8>, Vec<Finding>)> {
    let mut findings = Vec::new();
    let mut bin = Bin::default();
    let n_old = document.json.get("accessors").and_then(Value::as_array).map_or(0, Vec::len);
    let mut uses: BTreeMap<usize, Use> = BTreeMap::new();
    visit_accessors(&mut json, &mut |value, how| {
        if let Some(i) = index(value) {
            uses.entry(i).and_modify(|u| *u = (*u).min(how)).or_insert(how);
        }
    });
    let mut accessors = Vec::new();
    let mut number: BTreeMap<usize, usize> = BTreeMap::new();
    for (&i, &how) in &uses {
        let accessor = match i.checked_sub(n_old) {
            None => bin.old_accessor(document, i, how)?,
            Some(k) => bin.new_accessor(added.get(k).ok_or_else(|| missing(i))?, how),
        };
        number.insert(i, accessors.len());
        accessors.push(accessor);
    }
    visit_accessors(&mut json, &mut |value, _| {
        if let Some(new) = index(value).and_then(|i| number.get(&i)) {
            *value = json!(new);
        }
    });
    for (i, image) in items(&mut json, "images").take(n_images).enumerate() {
        if let Err(finding) = bin.image(document, i, image) {
            // Whether it matters was said when the scene was read.
            findings.push(Finding { severity: finding.severity.min(Severity::Warning), ..finding });
        }
    }
    drop_foreign_views(&mut json, &mut findings);
    set_array(&mut json, "accessors", accessors);
    let Bin { bytes, views } = bin;
    set_array(&mut json, "bufferViews", views);
    let buffers = if bytes.is_empty() { Vec::new() } else { vec![json!({ "byteLength": bytes.len() })] };
    set_array(&mut json, "buffers", buffers);
    Ok((container(&json, &bytes)?, findings))
}

fn missing(i: usize) -> Error {
    Finding::error(format!("accessors[{i}]"), "there is no such accessor", "export the scene again").into()
}

/// Sets a root array; glTF forbids empty ones.
pub(super) fn set_array(json: &mut Value, key: &str, values: Vec<Value>) {
    if let Some(root) = json.as_object_mut() {
        if values.is_empty() {
            root.shift_remove(key);
        } else {
            root.insert(key.to_owned(), Value::Array(values));
        }
    }
}

/// Removes extensions that refer to buffer views or accessors themselves: these have been laid out anew, and
/// only the extension's own reader would know which numbers to change.
fn drop_foreign_views(json: &mut Value, findings: &mut Vec<Finding>) {
    let mut dropped = Vec::new();
    for key in ["accessors", "bufferViews", "buffers"] {
        json.as_object_mut().and_then(|root| root.shift_remove(key));
    }
    strip(json, &mut String::new(), &mut dropped);
    for (path, name) in &dropped {
        findings.push(Finding::warning(
            path.clone(),
            format!("{name} may refer to buffer views or accessors, which this tool does not follow, so scene.glb lacks it"),
            "add it to scene.glb with the tool that made it",
        ));
    }
    for list in ["extensionsUsed", "extensionsRequired"] {
        let gone = |v: &Value| dropped.iter().any(|(_, name)| v.as_str() == Some(name));
        remove_names(json, list, gone);
    }
}

/// Removes the names of a root array that `gone` selects.
pub(super) fn remove_names(json: &mut Value, list: &str, gone: impl Fn(&Value) -> bool) {
    let names = json.get(list).and_then(Value::as_array).cloned().unwrap_or_default();
    set_array(json, list, names.into_iter().filter(|v| !gone(v)).collect());
}

fn strip(json: &mut Value, path: &mut String, dropped: &mut Vec<(String, String)>) {
    let length = path.len();
    match json {
        Value::Array(values) => {
            for (i, value) in values.iter_mut().enumerate() {
                path.push_str(&format!("[{i}]"));
                strip(value, path, dropped);
                path.truncate(length);
            }
        }
        Value::Object(object) => {
            if let Some(extensions) = object.get_mut("extensions").and_then(Value::as_object_mut) {
                let primitive = path.contains(".primitives[") && path.ends_with(']');
                let foreign = |name: &str, value: &Value| {
                    mentions_view(value) || name == METADATA || primitive && !OF_PRIMITIVES.contains(&name)
                };
                let names: Vec<String> =
                    extensions.iter().filter(|(n, v)| foreign(n, v)).map(|(n, _)| n.clone()).collect();
                for name in names {
                    extensions.shift_remove(&name);
                    dropped.push((
                        format!("{path}{}extensions.{name}", if path.is_empty() { "" } else { "." }),
                        name,
                    ));
                }
                if extensions.is_empty() {
                    object.shift_remove("extensions");
                }
            }
            for (key, value) in object.iter_mut().filter(|(key, _)| *key != "extras") {
                if length != 0 {
                    path.push('.');
                }
                path.push_str(key);
                strip(value, path, dropped);
                path.truncate(length);
            }
        }
        _ => {}
    }
}

/// Extensions of primitives that survive other accessors and vertices; any other is taken to speak of these.
const OF_PRIMITIVES: [&str; 2] = ["KHR_materials_variants", "EXT_mesh_features"];

/// Its tables name buffer views by `values`.
const METADATA: &str = "EXT_structural_metadata";

fn mentions_view(json: &Value) -> bool {
    match json {
        Value::Array(values) => values.iter().any(mentions_view),
        Value::Object(object) => {
            ["bufferView", "accessor"].iter().any(|k| object.get(*k).is_some_and(Value::is_u64))
                || object.iter().any(|(key, value)| key != "extras" && mentions_view(value))
        }
        _ => false,
    }
}

/// The binary chunk as it grows.
#[derive(Default)]
struct Bin {
    bytes: Vec<u8>,
    views: Vec<Value>,
}

impl Bin {
    /// Appends a view at a multiple of four; its index.
    fn view(&mut self, bytes: &[u8], properties: Value) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        if let (Some(view), Value::Object(properties)) = (view.as_object_mut(), properties) {
            view.extend(properties);
        }
        self.bytes.extend_from_slice(bytes);
        self.views.push(view);
        self.views.len() - 1
    }

    fn values(&mut self, data: &AccessorData, how: Use) -> usize {
        match how {
            Use::Vertices => {
                let size = data.bytes.len() / data.count.max(1);
                let stride = size.next_multiple_of(4);
                if size == stride {
                    return self.view(&data.bytes, json!({ "target": 34962 }));
                }
                let bytes = padded(&data.bytes, size, stride);
                self.view(&bytes, json!({ "byteStride": stride, "target": 34962 }))
            }
            Use::Indices => self.view(&data.bytes, json!({ "target": 34963 })),
            Use::Other => {
                // Columns of matrices begin at multiples of four bytes.
                let rows = match data.kind {
                    Kind::Mat2 => 2,
                    Kind::Mat3 => 3,
                    _ => return self.view(&data.bytes, json!({})),
                };
                let column = rows * component_size(data.component_type);
                let bytes = padded(&data.bytes, column, column.next_multiple_of(4));
                self.view(&bytes, json!({}))
            }
        }
    }

    fn old_accessor(&mut self, document: &Document, i: usize, how: Use) -> Result<Value> {
        let mut accessor = document.json["accessors"][i].clone();
        let data = document.accessor(i).map_err(Error::from)?;
        let Some(object) = accessor.as_object_mut() else { return Err(missing(i)) };
        for key in ["bufferView", "byteOffset", "sparse"] {
            object.shift_remove(key);
        }
        object.insert("bufferView".to_owned(), json!(self.values(&data, how)));
        Ok(accessor)
    }

    fn new_accessor(&mut self, new: &NewAccessor, how: Use) -> Value {
        let data = &new.data;
        let mut accessor = Map::new();
        if let Some(name) = &new.name {
            accessor.insert("name".to_owned(), name.clone());
        }
        accessor.insert("bufferView".to_owned(), json!(self.values(data, how)));
        accessor.insert("componentType".to_owned(), json!(data.component_type));
        if data.normalized {
            accessor.insert("normalized".to_owned(), json!(true));
        }
        accessor.insert("count".to_owned(), json!(data.count));
        accessor.insert("type".to_owned(), json!(data.kind.name()));
        if new.bounds {
            let (min, max) = bounds(data);
            accessor.insert("min".to_owned(), Value::Array(min));
            accessor.insert("max".to_owned(), Value::Array(max));
        }
        Value::Object(accessor)
    }

    /// Embeds `images[i]`. An image that cannot be read stays as it is: materials may never use it.
    fn image(&mut self, document: &Document, i: usize, image: &mut Value) -> Result<(), Finding> {
        let (bytes, stated) = document.image_bytes(i)?;
        // The content decides; a stated type may be wrong or absent.
        let mime = media_type(&bytes).map_or(stated, str::to_owned);
        if mime.is_empty() {
            let fix = "use PNG, JPEG, WebP or KTX2";
            return Err(Finding::warning(
                format!("images[{i}]"),
                "of unknown type, so it was not embedded",
                fix,
            ));
        }
        let Some(object) = image.as_object_mut() else { return Ok(()) };
        object.shift_remove("uri");
        object.insert("bufferView".to_owned(), json!(self.view(&bytes, json!({}))));
        object.insert("mimeType".to_owned(), json!(mime));
        Ok(())
    }
}

/// What an image is, by its content.
pub(super) fn media_type(bytes: &[u8]) -> Option<&'static str> {
    if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        Some("image/png")
    } else if bytes.starts_with(b"\xff\xd8\xff") {
        Some("image/jpeg")
    } else if bytes.starts_with(b"RIFF") && bytes.get(8..12) == Some(b"WEBP".as_slice()) {
        Some("image/webp")
    } else if bytes.starts_with(b"\xabKTX 20\xbb\r\n\x1a\n") {
        Some("image/ktx2")
    } else {
        None
    }
}

/// `size`-byte pieces, each filled up with zeros to `stride`.
fn padded(bytes: &[u8], size: usize, stride: usize) -> Vec<u8> {
    let n_pieces = bytes.len() / size.max(1);
    let mut out = Vec::with_capacity(n_pieces * stride);
    for piece in bytes.chunks_exact(size.max(1)) {
        out.extend_from_slice(piece);
        out.resize(out.len() + stride - size, 0);
    }
    out
}

/// Bytes of a component.
pub(super) fn component_size(component_type: u32) -> usize {
    match component_type {
        5120 | 5121 => 1,
        5122 | 5123 => 2,
        _ => 4,
    }
}

/// Smallest and largest stored value of each component; integers stay integers.
fn bounds(data: &AccessorData) -> (Vec<Value>, Vec<Value>) {
    let stored = AccessorData { normalized: false, ..data.clone() }.floats();
    let n = data.kind.components();
    let extreme = |start: f32, pick: fn(f32, f32) -> f32| -> Vec<Value> {
        let of = |c: usize| stored.iter().skip(c).step_by(n).copied().fold(start, pick);
        #[expect(
            clippy::cast_possible_truncation,
            reason = "integer components are whole numbers below 2^32"
        )]
        let number = |v: f32| if data.component_type == 5126 { json!(f64::from(v)) } else { json!(v as i64) };
        (0..n).map(|c| number(of(c))).collect()
    };
    (extreme(f32::INFINITY, f32::min), extreme(f32::NEG_INFINITY, f32::max))
}

/// Header, JSON chunk and binary chunk (glTF 2.0, section 4.4).
fn container(json: &Value, bin: &[u8]) -> Result<Vec<u8>> {
    let too_large = |e: &dyn std::fmt::Display| Error::Usage(format!("scene.glb cannot be written: {e}"));
    let mut text = serde_json::to_vec(json).map_err(|e| too_large(&e))?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let padding = bin.len().next_multiple_of(4) - bin.len();
    let bin_chunk = if bin.is_empty() { 0 } else { 8 + bin.len() + padding };
    let total = 12 + 8 + text.len() + bin_chunk;
    let word = |n: usize| {
        u32::try_from(n)
            .map(u32::to_le_bytes)
            .map_err(|_| too_large(&format!("{n} bytes are more than a GLB can hold")))
    };
    let mut out = Vec::with_capacity(total);
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2_u32.to_le_bytes());
    out.extend_from_slice(&word(total)?);
    out.extend_from_slice(&word(text.len())?);
    out.extend_from_slice(b"JSON");
    out.extend_from_slice(&text);
    if !bin.is_empty() {
        out.extend_from_slice(&word(bin.len() + padding)?);
        out.extend_from_slice(b"BIN\0");
        out.extend_from_slice(bin);
        out.resize(total, 0);
    }
    Ok(out)
}
