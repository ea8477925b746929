//! The words of participating media.

use glam::{Affine3A, Vec3};
use serde_json::{Map, Value};

use super::{
    density::{Files, Place, Source, density, settle},
    emission_words::{Glow, emission},
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

/// A medium whose place is not known yet.
pub(super) struct Unplaced {
    pub(super) medium: Medium,
    pub(super) source: Source,
    /// Where its density stands in the file.
    pub(super) path: String,
    /// What it emits elsewhere than by its own density.
    pub(super) glows: Vec<Glow>,
}

/// The medium that a node's extras put in place of its mesh, and whether it fills the mesh's bounds instead of the mesh; the
/// region is not set.
pub(super) fn node_medium(
    extras: &Value,
    path: &str,
    files: &mut Files<'_>,
    out: &mut Findings,
) -> Option<(Unplaced, bool)> {
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
    let bounds = match words.remove("shape") {
        None => false,
        Some(Value::String(word)) if word == "mesh" => false,
        Some(Value::String(word)) if word == "box" => true,
        Some(other) => {
            let what = format!("{} is not a shape", shown(&other));
            let fix = "write \"mesh\" for the closed mesh, or \"box\" for its bounds";
            out.push(Finding::error(format!("{at}.shape"), what, fix));
            return None;
        }
    };
    if words.contains_key("box") {
        let what = "the medium of a node is where the node is";
        out.push(Finding::error(
            format!("{at}.box"),
            what,
            "remove `box`, or move the medium to the scene's extras",
        ));
        return None;
    }
    Some((medium(&Value::Object(words), &at, files, out)?, bounds))
}

/// Reads `media`, and the flat words that some exporters write.
pub(super) fn media(t: &mut Table<'_>, files: &mut Files<'_>, out: &mut Findings) -> Vec<Medium> {
    let at = t.at("media");
    let mut read = |value: &Value, path: &str, out: &mut Findings| {
        let Some(unplaced) = medium(value, path, files, out) else { return Vec::new() };
        let world_from_unit = match &unplaced.medium.region {
            Region::Box { min, max } => {
                Some(Affine3A::from_translation(*min) * Affine3A::from_scale(*max - *min))
            }
            _ => None,
        };
        settle(unplaced, Place { world_from_space: Affine3A::IDENTITY, world_from_unit }, out)
    };
    let mut list = match t.get("media") {
        None => Vec::new(),
        Some(Value::Array(list)) => {
            list.iter().enumerate().flat_map(|(i, v)| read(v, &format!("{at}[{i}]"), out)).collect()
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
        list.extend(read(&Value::Object(words), &t.at(first), out));
    }
    list
}

/// Reads one entry of `media`.
fn medium(value: &Value, path: &str, files: &mut Files<'_>, out: &mut Findings) -> Option<Unplaced> {
    let mut t = Table::new(value, path, out)?;
    let name = t.text("name", out);
    let sigma_s = t.colour("sigma_s", out);
    let sigma_a = t.colour("sigma_a", out);
    let typed = t.get("sigma_s").is_some() || t.get("sigma_a").is_some();
    let g = t.number("g", "a number between -1 and 1", out, |v| -1.0 < v && v < 1.0).unwrap_or(0.0);
    let place = t.at("density");
    let (factor, source) = match t.get("density") {
        Some(value @ Value::Object(_)) => (1.0, density(value, &place, files, out)?),
        _ => {
            let factor = t.number("density", "a number that is not negative", out, |v| 0.0 <= v);
            (factor.unwrap_or(1.0), Source::Known(Density::Constant))
        }
    };
    let mut glows = emission(&mut t, files, out);
    let emits = t.get("emission").is_some();
    let own: Vec3 = glows.iter().filter(|g| g.source.is_none()).map(|g| g.color).sum();
    glows.retain(|g| g.source.is_some() && g.color != Vec3::ZERO);
    let bounds = t.read("box", "a table with min and max, three numbers each", out, |v| {
        let corner = |key: &str, i: usize| floats::<3>(v.get(key).or_else(|| v.get(i))?).map(Vec3::from);
        corner("min", 0).zip(corner("max", 1))
    });
    let boxed = t.get("box").is_some();
    let at = t.at("box");
    t.finish(false, "", out);
    if !typed && !emits {
        let what = "a medium has at least one of `sigma_s`, `sigma_a` and `emission`";
        out.push(Finding::error(path, what, "give them per metre"));
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
    let (sigma_s, sigma_a) = (sigma_s.unwrap_or_default() * factor, sigma_a.unwrap_or_default() * factor);
    if !((sigma_s + sigma_a).is_finite() && (own * factor).is_finite()) {
        let what =
            format!("sigma or emission times a density of {factor} is beyond what single precision holds");
        out.push(Finding::error(place, what, "give both per metre, and a density near 1"));
        return None;
    }
    let medium = Medium {
        path: name.unwrap_or_else(|| path.to_owned()),
        sigma_s,
        sigma_a,
        emission: own * factor,
        density: Density::Constant,
        g,
        region,
    };
    Some(Unplaced { medium, source, path: place, glows })
}
