//! Checks of the document as a whole, whether a part takes part in the bake or not.

use std::collections::BTreeSet;

use serde_json::Value;

use super::{
    document::Document,
    findings::Findings,
    gltf_mesh::{self, Budget},
    read::{index_of, shown},
    uri::{self, Target},
};
use crate::error::{Finding, Severity};

const FIX: &str = "the exporter is at fault; the bake goes on where the part is not needed";

/// Top-level lists of objects.
const LISTS: &[&str] = &[
    "accessors",
    "animations",
    "buffers",
    "bufferViews",
    "cameras",
    "images",
    "materials",
    "meshes",
    "nodes",
    "samplers",
    "scenes",
    "skins",
    "textures",
];

/// Where indices are, and into which list. `*` stands for all elements.
const REFERENCES: &[(&str, &str)] = &[
    ("accessors.*.bufferView", "bufferViews"),
    ("accessors.*.sparse.indices.bufferView", "bufferViews"),
    ("accessors.*.sparse.values.bufferView", "bufferViews"),
    ("animations.*.channels.*.target.node", "nodes"),
    ("animations.*.samplers.*.input", "accessors"),
    ("animations.*.samplers.*.output", "accessors"),
    ("bufferViews.*.buffer", "buffers"),
    ("images.*.bufferView", "bufferViews"),
    ("materials.*.emissiveTexture.index", "textures"),
    ("materials.*.normalTexture.index", "textures"),
    ("materials.*.occlusionTexture.index", "textures"),
    ("materials.*.pbrMetallicRoughness.baseColorTexture.index", "textures"),
    ("materials.*.pbrMetallicRoughness.metallicRoughnessTexture.index", "textures"),
    ("materials.*.extensions.*.*.index", "textures"),
    ("meshes.*.primitives.*.attributes.*", "accessors"),
    ("meshes.*.primitives.*.indices", "accessors"),
    ("meshes.*.primitives.*.material", "materials"),
    ("meshes.*.primitives.*.targets.*.*", "accessors"),
    ("nodes.*.camera", "cameras"),
    ("nodes.*.children.*", "nodes"),
    ("nodes.*.mesh", "meshes"),
    ("nodes.*.skin", "skins"),
    ("scene", "scenes"),
    ("scenes.*.nodes.*", "nodes"),
    ("skins.*.inverseBindMatrices", "accessors"),
    ("skins.*.joints.*", "nodes"),
    ("skins.*.skeleton", "nodes"),
    ("textures.*.extensions.EXT_texture_webp.source", "images"),
    ("textures.*.sampler", "samplers"),
    ("textures.*.source", "images"),
];

/// Properties that may not be absent.
const REQUIRED: &[&str] = &[
    "accessors.*.componentType",
    "accessors.*.count",
    "accessors.*.type",
    "animations.*.channels",
    "animations.*.samplers",
    "buffers.*.byteLength",
    "bufferViews.*.buffer",
    "bufferViews.*.byteLength",
    "cameras.*.type",
    "extensions.KHR_lights_punctual.lights",
    "meshes.*.primitives",
    "meshes.*.primitives.*.attributes",
    "nodes.*.extensions.KHR_lights_punctual.light",
    "skins.*.joints",
];

/// Lists that may not be empty where they are given.
const NOT_EMPTY: &[&str] = &[
    "animations.*.channels",
    "animations.*.samplers",
    "extensions.KHR_materials_variants.variants",
    "nodes.*.children",
    "scenes.*.nodes",
    "skins.*.joints",
];

/// Looks for lists that are none, indices that lead nowhere, missing properties, and extensions
/// that are not declared. All are warnings here: where the part is needed, loading makes an error of it.
pub(crate) fn references(doc: &Document, out: &mut Findings) {
    for list in LISTS {
        match doc.json.get(list) {
            None => {}
            Some(Value::Array(items)) if items.is_empty() => {
                out.push(Finding::warning(*list, "an empty list", "leave it out"));
            }
            Some(Value::Array(items)) => {
                for (i, item) in items.iter().enumerate().filter(|(_, v)| !v.is_object()) {
                    out.push(Finding::warning(
                        format!("{list}[{i}]"),
                        format!("{} is not an object", shown(item)),
                        FIX,
                    ));
                }
            }
            Some(other) => {
                out.push(Finding::error(
                    *list,
                    format!("{} is not a list", shown(other)),
                    "export the file again",
                ));
            }
        }
    }
    for (pattern, target) in REFERENCES {
        let count = doc.json.get(target).and_then(Value::as_array).map_or(0, Vec::len);
        visit(&doc.json, pattern, "", &mut |path, value| {
            let Some(value) = value else { return };
            match index_of(value) {
                Some(i) if i < count => {}
                Some(i) => out.push(Finding::warning(path, format!("there is no {target}[{i}]"), FIX)),
                None => out.push(Finding::warning(path, format!("{} is not an index", shown(value)), FIX)),
            }
        });
    }
    for pattern in REQUIRED {
        visit(&doc.json, pattern, "", &mut |path, value| {
            if value.is_none() {
                out.push(Finding::warning(path, "missing", FIX));
            }
        });
    }
    for pattern in NOT_EMPTY {
        visit(&doc.json, pattern, "", &mut |path, value| {
            if value.and_then(Value::as_array).is_some_and(Vec::is_empty) {
                out.push(Finding::warning(path, "an empty list", "leave it out"));
            }
        });
    }
    visit(&doc.json, "extensions.KHR_lights_punctual.lights.*.type", "", &mut |path, value| {
        if !value.and_then(Value::as_str).is_some_and(|t| matches!(t, "point" | "spot" | "directional")) {
            out.push(Finding::warning(path, "not a type of light", "use point, spot or directional"));
        }
    });
    accessors_and_views(doc, out);
    images(doc, out);
    extensions(&doc.json, out);
}

/// Looks at meshes that the scene does not show, given those that it does. What would be an error
/// in a mesh that is baked is a warning here.
pub(crate) fn unused_meshes(doc: &Document, used: &BTreeSet<usize>, budget: &mut Budget, out: &mut Findings) {
    let meshes = doc.json.get("meshes").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let mut scratch = Findings::default();
    for (m, mesh) in meshes.iter().enumerate().filter(|(m, _)| !used.contains(m)) {
        for p in 0..mesh["primitives"].as_array().map_or(0, Vec::len) {
            gltf_mesh::load(doc, m, p, budget, &mut scratch);
        }
    }
    let warn = |f: Finding| Finding { severity: f.severity.min(Severity::Warning), ..f };
    out.extend(scratch.finish().into_iter().map(warn));
}

fn accessors_and_views(doc: &Document, out: &mut Findings) {
    let count = |list: &str| doc.json.get(list).and_then(Value::as_array).map_or(0, Vec::len);
    for i in 0..count("bufferViews") {
        // Compressed views are checked where they are used, since that means decoding them.
        let json = &doc.json["bufferViews"][i];
        let broken_buffer =
            index_of(&json["buffer"]).and_then(|b| doc.buffers.get(b)).is_none_or(Result::is_err);
        if json.get("extensions").is_some() || broken_buffer {
            continue;
        }
        if let Err(f) = doc.view(i) {
            out.push(Finding { severity: Severity::Warning, ..f });
        }
    }
    for i in 0..count("accessors") {
        let json = &doc.json["accessors"][i];
        let normalized = json["normalized"] == Value::Bool(true);
        if normalized && matches!(index_of(&json["componentType"]), Some(5125 | 5126)) {
            let path = format!("accessors[{i}].normalized");
            out.push(Finding::warning(
                path,
                "only 8-bit and 16-bit integers can be normalised; ignored",
                FIX,
            ));
        }
        if json.get("byteOffset").is_some() && json.get("bufferView").is_none() {
            let path = format!("accessors[{i}].byteOffset");
            out.push(Finding::warning(path, "an offset without a bufferView means nothing", FIX));
        }
    }
}

/// Images must say where they are; whether they can be decoded shows where they are used.
fn images(doc: &Document, out: &mut Findings) {
    let list = doc.json.get("images").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    for (i, image) in list.iter().enumerate() {
        let path = format!("images[{i}]");
        let what = match (image.get("uri").map(|u| (u.as_str(), u)), image.get("bufferView")) {
            (None, Some(_)) => continue,
            (None, None) => "neither uri nor bufferView".to_owned(),
            (Some(_), Some(_)) => "both uri and bufferView; the uri is used".to_owned(),
            (Some((None, v)), None) => format!("{} is not a URI", shown(v)),
            (Some((Some(uri), _)), None) => match uri::resolve(uri) {
                Ok(Target::File(file)) if doc.base_dir().is_some_and(|d| !d.join(&file).is_file()) => {
                    format!("there is no file `{}` beside the document", file.display())
                }
                Ok(_) => continue,
                Err(what) => what,
            },
        };
        out.push(Finding::warning(path, what, "put the image there, or export again"));
    }
}

/// Calls `see` for every place that matches; with `None` where the last word of the pattern is absent.
fn visit(value: &Value, pattern: &str, path: &str, see: &mut dyn FnMut(&str, Option<&Value>)) {
    let (word, rest) = pattern.split_once('.').map_or((pattern, None), |(w, r)| (w, Some(r)));
    let mut next = |path: String, value: &Value| match rest {
        Some(rest) => visit(value, rest, &path, see),
        None => see(&path, Some(value)),
    };
    match (word, value) {
        ("*", Value::Array(list)) => {
            list.iter().enumerate().for_each(|(i, v)| next(format!("{path}[{i}]"), v))
        }
        ("*", Value::Object(map)) => map.iter().for_each(|(k, v)| next(format!("{path}.{k}"), v)),
        ("*", _) => {}
        (word, Value::Object(map)) => {
            let at = if path.is_empty() { word.to_owned() } else { format!("{path}.{word}") };
            match (map.get(word), rest) {
                (Some(v), _) => next(at, v),
                (None, None) => see(&at, None),
                (None, Some(_)) => {}
            }
        }
        _ => {}
    }
}

/// Every extension object has its name in `extensionsUsed`, as every required one has.
fn extensions(json: &Value, out: &mut Findings) {
    let names = |key: &str| -> Vec<&str> {
        json[key].as_array().into_iter().flatten().filter_map(Value::as_str).collect()
    };
    let declared: BTreeSet<&str> = names("extensionsUsed").into_iter().collect();
    let fix = "add the name to extensionsUsed";
    for name in names("extensionsRequired").into_iter().filter(|n| !declared.contains(n)) {
        out.push(Finding::warning(
            "extensionsRequired",
            format!("`{name}` is required but not in extensionsUsed"),
            fix,
        ));
    }
    let mut used = BTreeSet::new();
    let mut stack = vec![json];
    while let Some(value) = stack.pop() {
        match value {
            Value::Object(map) => {
                for (key, v) in map {
                    match (key.as_str(), v) {
                        ("extensions", Value::Object(inner)) => {
                            used.extend(inner.keys().map(String::as_str));
                            for (name, other) in inner.iter().filter(|(_, v)| !v.is_object()) {
                                let cut: String = name.chars().take(64).collect();
                                let what = format!("{} is not an object", shown(other));
                                out.push(Finding::warning(format!("extensions.{cut}"), what, FIX));
                            }
                        }
                        ("extensions", other) => {
                            let what = format!("{} is not an object of extensions", shown(other));
                            out.push(Finding::warning("extensions", what, FIX));
                        }
                        _ => {}
                    }
                    if key != "extras" {
                        stack.push(v);
                    }
                }
            }
            Value::Array(list) => stack.extend(list),
            _ => {}
        }
    }
    for name in used.difference(&declared) {
        let cut: String = name.chars().take(64).collect();
        out.push(Finding::warning(
            "extensionsUsed",
            format!("`{cut}` is used but not in extensionsUsed"),
            fix,
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn places_are_named() {
        let json = json!({
            "asset": {"version": "2.0"},
            "nodes": [{"camera": 3, "extensions": {"X": {}}}],
            "meshes": [{"primitives": [{}]}, {"primitives": [{"attributes": {"POSITION": 1}}]}],
            "skins": [],
            "samplers": [5]
        });
        let doc = Document::from_bytes("x.gltf", json.to_string().as_bytes(), None).expect("opens");
        let mut out = Findings::default();
        references(&doc, &mut out);
        let mut paths: Vec<String> = out.finish().into_iter().map(|f| f.path).collect();
        paths.sort();
        let want = [
            "extensionsUsed",
            "meshes[0].primitives[0].attributes",
            "meshes[1].primitives[0].attributes.POSITION",
            "nodes[0].camera",
            "samplers[0]",
            "skins",
        ];
        assert_eq!(paths, want);
    }
}
