//! Checks of the document as a whole, whether a part takes part in the bake or not.

use std::collections::BTreeSet;

use serde_json::Value;

use super::{
    document::Document,
    findings::Findings,
    read::{index_of, shown},
};
use crate::error::Finding;

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
    "meshes.*.primitives",
    "meshes.*.primitives.*.attributes",
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
    extensions(&doc.json, out);
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
                    if let ("extensions", Some(inner)) = (key.as_str(), v.as_object()) {
                        used.extend(inner.keys().map(String::as_str));
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
