//! The words of light probes: boxes that are filled with them.

use glam::{DVec3, Vec3};
use serde_json::Value;

use super::{
    findings::Findings,
    model::ProbeBox,
    read::{Table, floats, scalar},
};
use crate::error::Finding;

/// Most probes of one box.
const MOST: f64 = (1u32 << 22) as f64;

/// Reads `probes`, a list of boxes; `None` where there is no such word.
pub(super) fn probes(t: &mut Table<'_>, out: &mut Findings) -> Option<Vec<ProbeBox>> {
    let at = t.at("probes");
    match t.get("probes")? {
        Value::Array(list) => Some(
            list.iter().enumerate().filter_map(|(i, v)| probe_box(v, &format!("{at}[{i}]"), out)).collect(),
        ),
        one @ Value::Object(_) => Some(probe_box(one, &at, out).into_iter().collect()),
        _ => {
            let fix = "write [{\"box\": {\"min\": [x, y, z], \"max\": [x, y, z]}, \"spacing\": metres}]";
            out.push(Finding::error(at, "not a list of boxes", fix));
            None
        }
    }
}

/// Reads `probes` of a node: the distance of probes in the bounds of its mesh, metres, alone or as `spacing`.
pub(super) fn spacing(t: &mut Table<'_>, out: &mut Findings) -> Option<f32> {
    let expected = "a distance above 0 metres such as 0.5 or {\"spacing\": 0.5}";
    t.read("probes", expected, out, |v| scalar(v.get("spacing").unwrap_or(v)).filter(|s| 0.0 < *s))
}

fn probe_box(value: &Value, path: &str, out: &mut Findings) -> Option<ProbeBox> {
    let mut t = Table::new(value, path, out)?;
    let bounds = t.read("box", "a table with min and max, three numbers each", out, |v| {
        let corner = |key: &str, i: usize| floats::<3>(v.get(key).or_else(|| v.get(i))?).map(Vec3::from);
        corner("min", 0).zip(corner("max", 1))
    });
    let spacing = t.number("spacing", "a number of metres above 0", out, |v| 0.0 < v);
    let (boxed, spaced) = (t.get("box").is_some(), t.get("spacing").is_some());
    t.finish(false, "", out);
    let mut needs = |what: &str, fix: &str| out.push(Finding::error(path, what, fix));
    if !boxed {
        needs("a box of probes has a `box`", "add \"box\": {\"min\": [x, y, z], \"max\": [x, y, z]}");
    }
    if !spaced {
        needs("a box of probes has a `spacing`", "add the distance of probes, metres");
    }
    let ((min, max), spacing) = bounds.zip(spacing)?;
    checked(ProbeBox { path: path.to_owned(), min, max, spacing }, out)
}

/// The box if it is one, and not of too many probes.
pub(super) fn checked(probes: ProbeBox, out: &mut Findings) -> Option<ProbeBox> {
    let ProbeBox { min, max, spacing, .. } = probes;
    let mut needs = |what: &str, fix: &str| out.push(Finding::error(&probes.path, what, fix));
    if !min.cmplt(max).all() {
        needs("the box is empty", "make every number of max greater than that of min");
        return None;
    }
    // Whole bricks of four cells.
    let bricks = ((max - min).as_dvec3() / (4.0 * f64::from(spacing))).ceil().max(DVec3::ONE);
    let n = (bricks * 4.0 + 1.0).element_product();
    if MOST < n || n.is_nan() {
        let what = format!("{n:.0} probes, and {MOST:.0} are possible");
        needs(&what, "make spacing greater, or the box smaller");
        return None;
    }
    Some(probes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn read(value: &Value) -> (Option<Vec<ProbeBox>>, Vec<Finding>) {
        let mut out = Findings::default();
        let boxes = {
            let mut t = Table::new(value, "extras", &mut out).expect("a table");
            probes(&mut t, &mut out)
        };
        (boxes, out.finish())
    }

    #[test]
    fn boxes_are_read() {
        let corner = json!({"box": {"min": [0, 0, 0], "max": [4, 2, 4]}, "spacing": 0.5});
        let (boxes, findings) = read(&json!({"probes": [corner]}));
        assert_eq!(findings, []);
        let boxes = boxes.expect("a list");
        assert_eq!((boxes[0].max, boxes[0].spacing), (Vec3::new(4.0, 2.0, 4.0), 0.5));
        assert_eq!(boxes[0].path, "extras.probes[0]");
        assert_eq!(read(&json!({"probes": corner})).0.map(|b| b.len()), Some(1));
        assert_eq!(read(&json!({})), (None, vec![]));
        assert_eq!(read(&json!({"probes": []})), (Some(vec![]), vec![]));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let bounds = json!({"min": [0, 0, 0], "max": [4, 2, 4]});
        for (bad, at) in [
            (json!(3), "extras.probes"),
            (json!([{"box": bounds}]), "extras.probes[0]"),
            (json!([{"spacing": 1}]), "extras.probes[0]"),
            (json!([{"box": bounds, "spacing": 0}]), "extras.probes[0].spacing"),
            (json!([{"box": bounds, "spacing": 0.001}]), "extras.probes[0]"),
            (json!([{"box": {"min": [0, 0, 0], "max": [4, 0, 4]}, "spacing": 1}]), "extras.probes[0]"),
            (json!([{"box": 7, "spacing": 1}]), "extras.probes[0].box"),
        ] {
            let (boxes, findings) = read(&json!({"probes": bad}));
            assert!(boxes.is_none_or(|b| b.is_empty()), "{bad}");
            assert!(findings.iter().any(|f| f.path == at), "{bad}: {findings:?}");
        }
    }
}
