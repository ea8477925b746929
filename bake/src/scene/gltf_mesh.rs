//! glTF primitives: attributes, indices and modes become triangles.

use glam::{DVec3, Vec2, Vec3, Vec4};
use serde_json::Value;

use super::{
    accessor::{AccessorData, Kind},
    document::Document,
    findings::Findings,
    gltf_material::UV_SETS,
    model::Mesh,
    read::{index_of, shown, single},
};
use crate::error::Finding;

const FIX: &str = "repair the mesh and export again";

/// What the meshes of a document may take together, bytes.
pub(crate) struct Budget {
    left: u64,
}

impl Budget {
    /// Four hundred megabytes are free; beyond that, memory follows the size of the input.
    pub(crate) fn new(doc: &Document) -> Self {
        Self { left: (400u64 << 20).saturating_add(doc.total_bytes().saturating_mul(64)) }
    }

    /// Takes a part; `false` where too little is left.
    pub(crate) fn take(&mut self, bytes: usize) -> bool {
        let left = self.left.checked_sub(bytes as u64);
        self.left = left.unwrap_or(0);
        left.is_some()
    }
}

/// Reads `meshes[mesh].primitives[primitive]`. `None` where nothing of it can be baked; the
/// findings say why.
pub(crate) fn load(
    doc: &Document,
    mesh: usize,
    primitive: usize,
    budget: &mut Budget,
    out: &mut Findings,
) -> Option<Mesh> {
    let path = format!("meshes[{mesh}].primitives[{primitive}]");
    let json = &doc.json["meshes"][mesh]["primitives"][primitive];
    let label = doc.json["meshes"][mesh]["name"].as_str().map(|n| n.chars().take(64).collect::<String>());
    let name = label.map_or_else(|| path.clone(), |n| format!("{path} ({n})"));
    let mut reader = Reader { doc, json, path, out, budget };
    reader.notes();
    let mode = reader.mode()?;
    let positions = reader.positions()?;
    let corners = reader.indices(positions.len())?;
    let triangles = triangles(mode, &corners);
    if triangles.is_empty() {
        reader.warn("", "there is not a single triangle".to_owned());
        return None;
    }
    if mode == Mode::List && corners.len() % 3 != 0 {
        reader.warn(
            "indices",
            format!("{} corners are not whole triangles; the rest is left out", corners.len()),
        );
    }
    let normals = reader.normals(&positions, &triangles)?;
    let uvs = reader.uvs(positions.len())?;
    let colors = reader.colors(positions.len())?;
    Some(Mesh { name, source: (mesh, primitive), positions, normals, uvs, colors, triangles })
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Mode {
    List,
    Strip,
    Fan,
}

/// Corners of triangles by mode; strips alternate so that all triangles keep their winding.
fn triangles(mode: Mode, corners: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::List => corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
        Mode::Strip => {
            let turn =
                |(i, c): (usize, &[u32])| if i % 2 == 0 { [c[0], c[1], c[2]] } else { [c[0], c[2], c[1]] };
            corners.windows(3).enumerate().map(turn).collect()
        }
        // glTF 2.0, 3.7.2.1: the fan's triangle i is (i + 1, i + 2, 0).
        Mode::Fan => match corners {
            [hub, rim @ ..] => rim.windows(2).map(|c| [c[0], c[1], *hub]).collect(),
            [] => Vec::new(),
        },
    }
}

struct Reader<'a> {
    doc: &'a Document,
    json: &'a Value,
    path: String,
    out: &'a mut Findings,
    budget: &'a mut Budget,
}

impl Reader<'_> {
    fn at(&self, place: &str) -> String {
        if place.is_empty() { self.path.clone() } else { format!("{}.{place}", self.path) }
    }

    fn error(&mut self, place: &str, what: String) {
        let path = self.at(place);
        self.out.push(Finding::error(path, what, FIX));
    }

    fn warn(&mut self, place: &str, what: String) {
        let path = self.at(place);
        self.out.push(Finding::warning(path, what, FIX));
    }

    fn mode(&mut self) -> Option<Mode> {
        match self.json.get("mode").map(|m| (index_of(m), m)) {
            None | Some((Some(4), _)) => Some(Mode::List),
            Some((Some(5), _)) => Some(Mode::Strip),
            Some((Some(6), _)) => Some(Mode::Fan),
            Some((Some(0..=3), _)) => {
                let path = self.at("mode");
                self.out.push(Finding::info(path, "points and lines cast and receive no light", "nothing"));
                None
            }
            Some((_, m)) => {
                self.error("mode", format!("`{}` is not a primitive mode", shown(m)));
                None
            }
        }
    }

    /// The accessor of an attribute; `Err` where there is one but it is unusable.
    fn attribute(
        &mut self,
        name: &str,
        kinds: &[Kind],
        count: Option<usize>,
    ) -> Result<Option<AccessorData>, ()> {
        let Some(value) = self.json["attributes"].get(name) else { return Ok(None) };
        let place = format!("attributes.{name}");
        let Some(index) = index_of(value) else {
            self.error(&place, format!("`{}` is not an index", shown(value)));
            return Err(());
        };
        let data = self.doc.accessor(index).map_err(|f| {
            let path = self.at(&place);
            self.out.push(Finding { what: format!("{} (used by {path})", f.what), ..f });
        })?;
        if !kinds.contains(&data.kind) || data.component_type == 5125 {
            let (kind, component) = (data.kind.name(), data.component_type);
            self.error(
                &place,
                format!("accessor {index} is {kind} of component type {component}, which {name} cannot be"),
            );
            return Err(());
        }
        if let Some(count) = count.filter(|c| *c != data.count) {
            self.error(&place, format!("accessor {index} has {} elements, POSITION has {count}", data.count));
            return Err(());
        }
        if !self.budget.take(data.count.saturating_mul(16)) {
            self.error(
                &place,
                "the meshes together take more memory than the size of the file justifies".to_owned(),
            );
            return Err(());
        }
        Ok(Some(data))
    }

    fn positions(&mut self) -> Option<Vec<Vec3>> {
        if !self.json["attributes"].is_object() {
            self.error("attributes", "missing, or not an object".to_owned());
            return None;
        }
        let Some(data) = self.attribute("POSITION", &[Kind::Vec3], None).ok()? else {
            self.warn("attributes", "there is no POSITION; the primitive is left out".to_owned());
            return None;
        };
        let index = &self.json["attributes"]["POSITION"];
        let required = self.doc.json["extensionsRequired"].as_array();
        let quantized = required.is_some_and(|r| r.iter().any(|e| e == "KHR_mesh_quantization"));
        if data.component_type != 5126 && !quantized {
            let what = format!(
                "accessor {index} holds integers, for which extensionsRequired must name KHR_mesh_quantization"
            );
            self.warn("attributes.POSITION", what);
        }
        if u32::try_from(data.count).is_err() {
            self.error(
                "attributes.POSITION",
                format!("{} vertices are more than 32 bits can index", data.count),
            );
            return None;
        }
        let positions = vec3s(&data.floats());
        if let Some(vertex) = positions.iter().position(|p| !p.is_finite()) {
            let bad = positions.iter().filter(|p| !p.is_finite()).count();
            let what =
                format!("accessor {index} vertex {vertex} is {} ({bad} such vertices)", positions[vertex]);
            self.error("attributes.POSITION", what);
            return None;
        }
        if positions.is_empty() {
            self.warn("attributes.POSITION", format!("accessor {index} has no vertices"));
            return None;
        }
        Some(positions)
    }

    /// One index a corner, in range.
    fn indices(&mut self, vertices: usize) -> Option<Vec<u32>> {
        let Some(value) = self.json.get("indices") else {
            return Some((0..u32::try_from(vertices).ok()?).collect());
        };
        let Some(index) = index_of(value) else {
            self.error("indices", format!("`{}` is not an index", shown(value)));
            return None;
        };
        let data = self.out.keep(self.doc.accessor(index))?;
        let values = (data.kind == Kind::Scalar).then(|| data.unsigned()).flatten();
        let Some(values) = values else {
            let what =
                format!("accessor {index} is {} of component type {}", data.kind.name(), data.component_type);
            self.error("indices", format!("{what}; indices are unsigned integers"));
            return None;
        };
        if !self.budget.take(values.len().saturating_mul(16)) {
            self.error(
                "indices",
                "the meshes together take more memory than the size of the file justifies".to_owned(),
            );
            return None;
        }
        if let Some(at) = values.iter().position(|v| vertices <= *v as usize) {
            let what = format!("accessor {index} entry {at} names vertex {} of {vertices}", values[at]);
            self.error("indices", what);
            return None;
        }
        let restart = match data.component_type {
            5121 => u32::from(u8::MAX),
            5123 => u32::from(u16::MAX),
            _ => u32::MAX,
        };
        if let Some(at) = values.iter().position(|v| *v == restart) {
            let what = format!(
                "accessor {index} entry {at} is {restart}, which graphics hardware takes for a restart"
            );
            self.warn("indices", what);
        }
        Some(values)
    }

    fn normals(&mut self, positions: &[Vec3], triangles: &[[u32; 3]]) -> Option<Vec<Vec3>> {
        let Some(data) = self.attribute("NORMAL", &[Kind::Vec3], Some(positions.len())).ok()? else {
            return Some(Vec::new());
        };
        let mut normals = vec3s(&data.floats());
        let mut bad = Vec::new();
        let mut long = 0;
        for (i, n) in normals.iter_mut().enumerate() {
            // Integer normals need not be normalised to have a direction.
            let length = n.as_dvec3().length();
            if data.component_type == 5126 && 0.01 < (length - 1.0).abs() {
                long += 1;
            }
            match n.as_dvec3().try_normalize() {
                Some(unit) => *n = single(unit),
                None => bad.push(i),
            }
        }
        if !bad.is_empty() {
            let what = format!(
                "{} of {} normals are zero or not finite; face normals replace them",
                bad.len(),
                normals.len()
            );
            self.warn("attributes.NORMAL", what);
            let faces = face_normals(positions, triangles);
            for i in &bad {
                normals[*i] = faces[*i];
            }
        }
        if bad.len() < long {
            let what = format!(
                "{} of {} normals are not of unit length; they are normalised",
                long - bad.len(),
                normals.len()
            );
            self.warn("attributes.NORMAL", what);
        }
        Some(normals)
    }

    fn uvs(&mut self, count: usize) -> Option<Vec<Vec<Vec2>>> {
        let mut sets = Vec::new();
        for n in 0..UV_SETS {
            let name = format!("TEXCOORD_{n}");
            let Some(data) = self.attribute(&name, &[Kind::Vec2], Some(count)).ok()? else { continue };
            let mut uvs: Vec<Vec2> = data.floats().chunks_exact(2).map(|c| Vec2::new(c[0], c[1])).collect();
            let bad = uvs.iter().filter(|uv| !uv.is_finite()).count();
            if 0 < bad {
                self.warn(
                    &format!("attributes.{name}"),
                    format!("{bad} of {count} coordinates are not finite; they become 0"),
                );
                uvs.iter_mut().filter(|uv| !uv.is_finite()).for_each(|uv| *uv = Vec2::ZERO);
            }
            sets.resize(n, Vec::new());
            sets.push(uvs);
        }
        Some(sets)
    }

    fn colors(&mut self, count: usize) -> Option<Vec<Vec4>> {
        let Some(mut data) = self.attribute("COLOR_0", &[Kind::Vec3, Kind::Vec4], Some(count)).ok()? else {
            return Some(Vec::new());
        };
        // Integer colours are fractions whether the file says so or not.
        data.normalized = data.component_type != 5126;
        let width = data.kind.components();
        let color = |c: &[f32]| Vec4::new(c[0], c[1], c[2], c.get(3).copied().unwrap_or(1.0));
        let mut colors: Vec<Vec4> = data.floats().chunks_exact(width).map(color).collect();
        let mut bad = 0;
        for c in &mut colors {
            let good = Vec4::from(c.to_array().map(|v| if v.is_nan() { 1.0 } else { v.clamp(0.0, 1.0) }));
            bad += usize::from(good != *c);
            *c = good;
        }
        if 0 < bad {
            self.warn(
                "attributes.COLOR_0",
                format!("{bad} of {count} colours are not from 0 to 1; they are clamped"),
            );
        }
        Some(colors)
    }

    /// What is in the primitive and takes no part.
    fn notes(&mut self) {
        let names = self.json["attributes"].as_object().into_iter().flat_map(|a| a.keys());
        let numbered = ["TEXCOORD_", "COLOR_", "JOINTS_", "WEIGHTS_"];
        let known = |name: &str| {
            let number = numbered.iter().find_map(|p| name.strip_prefix(p));
            // Names that start with an underscore belong to applications.
            matches!(name, "POSITION" | "NORMAL" | "TANGENT")
                || name.starts_with('_')
                || number.is_some_and(is_number)
        };
        for name in names.filter(|n| !known(n)) {
            let cut: String = name.chars().take(48).collect();
            let path = self.at("attributes");
            self.out.push(Finding::warning(
                path,
                format!("`{cut}` is not an attribute that glTF has; it is ignored"),
                FIX,
            ));
        }
        if self.json.get("targets").and_then(Value::as_array).is_some_and(|t| !t.is_empty()) {
            let path = self.at("targets");
            self.out.push(Finding::info(path, "morph targets are baked in their base pose", "nothing"));
        }
    }
}

fn is_number(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit()) && (text == "0" || !text.starts_with('0'))
}

fn vec3s(values: &[f32]) -> Vec<Vec3> {
    values.chunks_exact(3).map(Vec3::from_slice).collect()
}

/// Per vertex, the area-weighted normal of its faces; +Y where all of them are degenerate.
fn face_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|i| positions[i as usize].as_dvec3());
        let normal = (b - a).cross(c - a);
        t.iter().for_each(|i| sums[*i as usize] += normal);
    }
    sums.into_iter().map(|s| s.try_normalize().map_or(Vec3::Y, single)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_and_fans_keep_their_winding() {
        assert_eq!(triangles(Mode::Strip, &[0, 1, 2, 3]), [[0, 1, 2], [1, 3, 2]]);
        assert_eq!(triangles(Mode::Fan, &[0, 1, 2, 3]), [[1, 2, 0], [2, 3, 0]]);
        assert_eq!(triangles(Mode::List, &[0, 1, 2, 3]), [[0, 1, 2]]);
        assert!(triangles(Mode::Fan, &[]).is_empty() && triangles(Mode::Strip, &[1]).is_empty());
    }

    #[test]
    fn face_normals_survive_tiny_and_huge_triangles() {
        for scale in [1e-30f32, 1.0, 1e30] {
            let p = [Vec3::ZERO, Vec3::X * scale, Vec3::Y * scale];
            assert_eq!(face_normals(&p, &[[0, 1, 2]]), [Vec3::Z; 3], "{scale}");
        }
        assert_eq!(face_normals(&[Vec3::ZERO], &[[0, 0, 0]]), [Vec3::Y]);
    }
}
