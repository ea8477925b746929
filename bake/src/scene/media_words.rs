//! The words of participating media.

use glam::Vec3;
use serde_json::{Map, Value};

use super::{
    findings::Findings,
    model::{Density, Medium, Region},
    read::{Table, floats, shown},
};
use crate::error::Finding;

/// Flat words begin with it.
pub(super) const MEDIUM_PREFIX: &str = "medium_";

/// Whether words of a node speak of a medium; its region is the node's own, which only the file's extras can name.
pub(super) fn has_medium(t: &mut Table<'_>) -> Option<String> {
    let named = t.get("medium").is_some().then(|| t.at("medium"));
    named.or_else(|| t.starting_with(MEDIUM_PREFIX).first().map(|k| t.at(k)))
}

/// The medium that a node's extras put in place of its mesh; the region is not set.
pub(super) fn node_medium(extras: &Value, path: &str, out: &mut Findings) -> Option<Medium> {
    let map = extras.as_object()?;
    let flat: Map<String, Value> = map
        .iter()
        .filter_map(|(k, v)| Some((k.strip_prefix(MEDIUM_PREFIX)?.to_owned(), v.clone())))
        .collect();
    let (mut words, at) = match map.get("medium") {
        Some(Value::Object(words)) => (words.clone(), format!("{path}.medium")),
        Some(other) if !other.is_null() => {
            let what = format!("{} is not a table of words", shown(other));
            out.push(Finding::error(format!("{path}.medium"), what, "write {\"sigma_s\": 0.1, ...}"));
            return None;
        }
        _ if flat.is_empty() => return None,
        _ => (flat, path.to_owned()),
    };
    let shape = words.remove("shape");
    if shape.as_ref().and_then(Value::as_str) != Some("box") {
        let what = "media in the shape of a mesh are not simulated by this version";
        out.push(Finding::error(
            format!("{at}.shape"),
            what,
            "write \"shape\": \"box\" for the mesh's bounds",
        ));
        return None;
    }
    if words.contains_key("box") {
        let what = "the medium of a node is where the node is";
        out.push(Finding::error(
            format!("{at}.box"),
            what,
            "remove `box`, or move the medium to the scene's extras",
        ));
        return None;
    }
    medium(&Value::Object(words), &at, out)
}

/// Reads `media`, and the flat words that some exporters write.
pub(super) fn media(t: &mut Table<'_>, out: &mut Findings) -> Vec<Medium> {
    let at = t.at("media");
    let mut list = match t.get("media") {
        None => Vec::new(),
        Some(Value::Array(list)) => {
            list.iter().enumerate().filter_map(|(i, v)| medium(v, &format!("{at}[{i}]"), out)).collect()
        }
        Some(_) => {
            out.push(Finding::error(at, "not a list", "write a list of media"));
            Vec::new()
        }
    };
    let flat = t.starting_with(MEDIUM_PREFIX);
    if let Some(first) = flat.first() {
        let words: Map<String, Value> =
            flat.iter().map(|k| (k[MEDIUM_PREFIX.len()..].to_owned(), t.value(k))).collect();
        list.extend(medium(&Value::Object(words), &t.at(first), out));
    }
    list
}

/// Reads a density that is not the same everywhere.
fn varying(value: &Value, path: &str, out: &mut Findings) -> Option<Density> {
    let mut t = Table::new(value, path, out)?;
    let Some(height) = t.get("height") else {
        let what = "of the densities that vary, this version simulates `height` alone";
        out.push(Finding::error(path, what, "write a number or {\"height\": {\"base\": 0, \"falloff\": 5}}"));
        return None;
    };
    let at = t.at("height");
    t.finish(false, "", out);
    let mut t = Table::new(height, at, out)?;
    let base = t.number("base", "a number of metres", out, |_| true).unwrap_or(0.0);
    let falloff = t.number("falloff", "a number of metres above 0", out, |v| 0.0 < v);
    let at = t.at("falloff");
    let given = t.get("falloff").is_some();
    t.finish(false, "", out);
    if falloff.is_none() && !given {
        out.push(Finding::error(
            at,
            "is missing",
            "give the metres over which the density falls by a factor of e",
        ));
    }
    Some(Density::Height { base, falloff: falloff? })
}

/// Reads one entry of `media`.
fn medium(value: &Value, path: &str, out: &mut Findings) -> Option<Medium> {
    let mut t = Table::new(value, path, out)?;
    let name = t.text("name", out);
    let sigma_s = t.colour("sigma_s", out);
    let sigma_a = t.colour("sigma_a", out);
    let typed = t.get("sigma_s").is_some() || t.get("sigma_a").is_some();
    let g = t.number("g", "a number between -1 and 1", out, |v| -1.0 < v && v < 1.0).unwrap_or(0.0);
    let (factor, density) = match t.get("density") {
        Some(value @ Value::Object(_)) => (1.0, varying(value, &t.at("density"), out)?),
        _ => {
            let factor = t.number("density", "a number that is not negative", out, |v| 0.0 <= v);
            (factor.unwrap_or(1.0), Density::Constant)
        }
    };
    if t.get("emission").is_some() {
        let what = "emission of media is not simulated by this version; ignored";
        out.push(Finding::warning(t.at("emission"), what, "remove it, or use an emissive surface"));
    }
    let bounds = t.read("box", "a table with min and max, three numbers each", out, |v| {
        let corner = |key: &str, i: usize| floats::<3>(v.get(key).or_else(|| v.get(i))?).map(Vec3::from);
        corner("min", 0).zip(corner("max", 1))
    });
    let boxed = t.get("box").is_some();
    let at = t.at("box");
    t.finish(false, "", out);
    if !typed {
        out.push(Finding::error(path, "a medium has `sigma_s`, `sigma_a` or both", "give them per metre"));
        return None;
    }
    let region = match bounds {
        Some((min, max)) if min.cmplt(max).all() => Region::Box { min, max },
        Some(_) => {
            out.push(Finding::error(
                at,
                "the box has no volume",
                "make every number of min less than that of max",
            ));
            return None;
        }
        None if boxed => return None,
        None => Region::Everywhere,
    };
    Some(Medium {
        path: name.unwrap_or_else(|| path.to_owned()),
        sigma_s: sigma_s.unwrap_or_default() * factor,
        sigma_a: sigma_a.unwrap_or_default() * factor,
        density,
        g,
        region,
    })
}
