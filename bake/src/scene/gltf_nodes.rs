//! glTF nodes: the hierarchy in world space, GPU instances, cameras and lights.

use std::collections::BTreeMap;

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3, Mat4, Vec3};
use serde_json::Value;

use super::{
    accessor::Kind,
    config::NodeWords,
    document::Document,
    findings::Findings,
    model::{Camera, Light, LightKind, Projection, Rgb},
    read::{doubles, float, floats, index_of, shown, single},
};
use crate::error::Finding;

const FIX: &str = "correct the node and export again";
/// Names of a path beyond this are left out in its middle: deep chains of long names would take
/// quadratic memory.
const PATH_NAMES: usize = 32;

/// How intensities are to be understood.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightUnits {
    /// `KHR_lights_punctual`: candela and lux.
    #[default]
    Gltf,
    /// Blender's numbers as they are: watts for point and spot lights, W/m² for suns. A watt is
    /// 683 lumen, and a lamp spreads it over 4 pi steradians whatever its cone:
    /// candela = W * 683 / (4 pi), lux = W/m² * 683.
    BlenderRaw,
    /// Blender's `unitless` export: W/sr for point and spot lights (already divided by 4 pi),
    /// W/m² for suns; times 683 gives candela and lux.
    BlenderUnitless,
}

impl LightUnits {
    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Gltf => "gltf",
            Self::BlenderRaw => "blender-raw",
            Self::BlenderUnitless => "blender-unitless",
        }
    }

    const LUMENS_PER_WATT: f32 = 683.0;

    /// What an intensity of a point or spot light is multiplied by to give candela.
    pub fn candela(self) -> f32 {
        match self {
            Self::Gltf => 1.0,
            Self::BlenderRaw => Self::LUMENS_PER_WATT / (4.0 * std::f32::consts::PI),
            Self::BlenderUnitless => Self::LUMENS_PER_WATT,
        }
    }

    /// What an intensity of a directional light is multiplied by to give lux.
    pub fn lux(self) -> f32 {
        match self {
            Self::Gltf => 1.0,
            Self::BlenderRaw | Self::BlenderUnitless => Self::LUMENS_PER_WATT,
        }
    }
}

/// A node of the scene in world space.
pub(crate) struct Placed {
    pub(crate) node: usize,
    pub(crate) world: DAffine3,
    /// Product of the rotations alone, for directions where a scale of zero leaves none.
    rotation: DQuat,
}

/// Parents of all nodes, and whether the graph is a forest.
pub(crate) struct Hierarchy<'a> {
    doc: &'a Document,
    nodes: &'a [Value],
    parents: Vec<Option<usize>>,
}

impl<'a> Hierarchy<'a> {
    /// Checks the graph. `None`, with findings, where it is no forest.
    pub(crate) fn new(doc: &'a Document, out: &mut Findings) -> Option<Self> {
        let nodes = match doc.json.get("nodes") {
            None => &[][..],
            Some(Value::Array(list)) => list.as_slice(),
            Some(_) => {
                out.push(Finding::error("nodes", "not a list", FIX));
                return None;
            }
        };
        let mut parents = vec![None; nodes.len()];
        let mut good = true;
        for (i, node) in nodes.iter().enumerate() {
            for child in children(node, i, out) {
                let path = format!("nodes[{i}].children");
                let Some(slot) = parents.get_mut(child) else {
                    out.push(Finding::error(path, format!("there is no node {child}"), FIX));
                    good = false;
                    continue;
                };
                if let Some(other) = slot {
                    let what = format!("node {child} is a child of node {other} as well as of node {i}");
                    out.push(Finding::error(path, what, "a node may have one parent only"));
                    good = false;
                } else {
                    *slot = Some(i);
                }
            }
        }
        // With one parent each, a cycle is a walk upwards that comes back.
        let mut state = vec![0u32; nodes.len()];
        for start in 0..nodes.len() {
            let mark = u32::try_from(start).unwrap_or(u32::MAX - 1).saturating_add(1);
            let mut at = Some(start);
            while let Some(node) = at.filter(|n| state[*n] == 0) {
                state[node] = mark;
                at = parents[node];
            }
            if let Some(node) = at.filter(|n| state[*n] == mark) {
                let path = format!("nodes[{node}].children");
                out.push(Finding::error(
                    path,
                    format!("node {node} is its own ancestor"),
                    "break the cycle of children",
                ));
                good = false;
            }
        }
        good.then_some(Self { doc, nodes, parents })
    }

    pub(crate) fn node(&self, index: usize) -> &'a Value {
        &self.nodes[index]
    }

    /// The nodes of the scene to bake, parents first, and the scene's index.
    pub(crate) fn place(&self, out: &mut Findings) -> (Vec<Placed>, Option<usize>) {
        let (roots, scene) = self.roots(out);
        let mut seen = vec![false; self.nodes.len()];
        let mut placed = Vec::new();
        let mut stack: Vec<(usize, DAffine3, DQuat)> =
            roots.into_iter().rev().map(|r| (r, DAffine3::IDENTITY, DQuat::IDENTITY)).collect();
        while let Some((node, parent, turn)) = stack.pop() {
            if std::mem::replace(&mut seen[node], true) {
                continue;
            }
            let json = &self.nodes[node];
            let visible = &json["extensions"]["KHR_node_visibility"]["visible"];
            if *visible == Value::Bool(false) {
                out.push(Finding::info(
                    format!("nodes[{node}]"),
                    "invisible (KHR_node_visibility); left out",
                    "nothing",
                ));
                continue;
            }
            let (local, rotation) = transform(json, node, out);
            let (world, rotation) = (parent * local, turn * rotation);
            if !single_affine(world).is_finite() {
                let what = "the node's place in the world is beyond what 32-bit numbers hold";
                out.push(Finding::error(
                    format!("nodes[{node}]"),
                    what,
                    "make translations and scales smaller",
                ));
                continue;
            }
            stack.extend(
                children(json, node, &mut Findings::default())
                    .into_iter()
                    .rev()
                    .map(|c| (c, world, rotation)),
            );
            placed.push(Placed { node, world, rotation });
        }
        (placed, scene)
    }

    fn roots(&self, out: &mut Findings) -> (Vec<usize>, Option<usize>) {
        let orphans = || (0..self.nodes.len()).filter(|i| self.parents[*i].is_none()).collect::<Vec<_>>();
        let scenes = self.doc.json.get("scenes").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        let chosen = match self.doc.json.get("scene") {
            Some(value) => match index_of(value).filter(|i| *i < scenes.len()) {
                Some(i) => i,
                None => {
                    let what = format!("`{}` is none of the {} scenes", shown(value), scenes.len());
                    out.push(Finding::error("scene", what, "name a scene that exists"));
                    return (Vec::new(), None);
                }
            },
            None if scenes.is_empty() => {
                if !self.nodes.is_empty() {
                    out.push(Finding::info("scenes", "there is no scene; all nodes are baked", "nothing"));
                }
                return (orphans(), None);
            }
            None => {
                if 1 < scenes.len() {
                    out.push(Finding::info(
                        "scene",
                        "no default scene is named; the first one is baked",
                        "nothing",
                    ));
                }
                0
            }
        };
        let path = format!("scenes[{chosen}].nodes");
        let list = match scenes[chosen].get("nodes") {
            None => &[][..],
            Some(Value::Array(list)) => list.as_slice(),
            Some(_) => {
                out.push(Finding::error(path, "not a list", FIX));
                return (Vec::new(), Some(chosen));
            }
        };
        let mut roots = Vec::new();
        for value in list {
            match index_of(value).filter(|i| *i < self.nodes.len()) {
                Some(node) if self.parents[node].is_some() => {
                    let what = format!(
                        "node {node} is a child of another node, so it cannot be a root of the scene"
                    );
                    out.push(Finding::error(&path, what, FIX));
                }
                Some(node) => roots.push(node),
                None => out.push(Finding::error(&path, format!("there is no node {}", shown(value)), FIX)),
            }
        }
        (roots, Some(chosen))
    }

    /// Name of a node, `node.7` where it has none.
    pub(crate) fn name(&self, node: usize) -> String {
        match self.nodes[node]["name"].as_str() {
            Some(name) if !name.is_empty() => name.chars().take(64).collect(),
            _ => format!("node.{node}"),
        }
    }

    /// Names from the root down, joined by `/`.
    pub(crate) fn path(&self, node: usize) -> String {
        let mut chain = Vec::new();
        let mut at = Some(node);
        while let Some(n) = at {
            if PATH_NAMES <= chain.len() {
                chain.push("…".to_owned());
                break;
            }
            chain.push(self.name(n));
            at = self.parents[n];
        }
        chain.reverse();
        chain.join("/")
    }
}

fn children(node: &Value, index: usize, out: &mut Findings) -> Vec<usize> {
    let path = || format!("nodes[{index}].children");
    match node.get("children") {
        None => Vec::new(),
        Some(Value::Array(list)) => list
            .iter()
            .filter_map(|v| {
                let child = index_of(v);
                if child.is_none() {
                    out.push(Finding::error(path(), format!("`{}` is not an index", shown(v)), FIX));
                }
                child
            })
            .collect(),
        Some(_) => {
            out.push(Finding::error(path(), "not a list", FIX));
            Vec::new()
        }
    }
}

fn transform(json: &Value, node: usize, out: &mut Findings) -> (DAffine3, DQuat) {
    let path = |key: &str| format!("nodes[{node}].{key}");
    if let Some(value) = json.get("matrix") {
        let Some(m) = doubles::<16>(value) else {
            out.push(Finding::error(path("matrix"), format!("`{}` is not 16 numbers", shown(value)), FIX));
            return Default::default();
        };
        if [m[3], m[7], m[11], m[15]] != [0.0, 0.0, 0.0, 1.0] {
            out.push(Finding::warning(path("matrix"), "the last row is not 0 0 0 1; it is ignored", FIX));
        }
        let affine = DAffine3::from_mat4(DMat4::from_cols_array(&m));
        let (_, rotation, _) = affine.to_scale_rotation_translation();
        return (affine, if rotation.is_finite() { rotation } else { DQuat::IDENTITY });
    }
    let mut vector = |key: &str, default: DVec3| match json.get(key).map(|v| (doubles::<3>(v), v)) {
        None => default,
        Some((Some(v), _)) => DVec3::from(v),
        Some((None, v)) => {
            out.push(Finding::error(path(key), format!("`{}` is not three numbers", shown(v)), FIX));
            default
        }
    };
    let translation = vector("translation", DVec3::ZERO);
    let scale = vector("scale", DVec3::ONE);
    let rotation = match json.get("rotation").map(|v| (doubles::<4>(v), v)) {
        None => DQuat::IDENTITY,
        Some((Some(v), _)) => unit(DQuat::from_array(v), &path("rotation"), out),
        Some((None, v)) => {
            out.push(Finding::error(path("rotation"), format!("`{}` is not four numbers", shown(v)), FIX));
            DQuat::IDENTITY
        }
    };
    (DAffine3::from_scale_rotation_translation(scale, rotation, translation), rotation)
}

fn unit(q: DQuat, path: &str, out: &mut Findings) -> DQuat {
    let length = q.length();
    if !(1e-100..=1e100).contains(&length) {
        out.push(Finding::warning(
            path,
            format!("the quaternion {q} has no direction; no rotation is used"),
            FIX,
        ));
        return DQuat::IDENTITY;
    }
    if 1e-2 < (length - 1.0).abs() {
        out.push(Finding::warning(
            path,
            format!("the quaternion has length {length}; it is normalised"),
            FIX,
        ));
    }
    q.normalize()
}

/// Rounds a transform to single precision.
pub(crate) fn single_affine(a: DAffine3) -> glam::Affine3A {
    let DMat3 { x_axis, y_axis, z_axis } = a.matrix3;
    glam::Affine3A::from_cols(
        single(x_axis).into(),
        single(y_axis).into(),
        single(z_axis).into(),
        single(a.translation).into(),
    )
}

/// Transforms of `EXT_mesh_gpu_instancing`, relative to the node; `None` where the node has no
/// such extension, empty where it is broken.
pub(crate) fn instances(
    doc: &Document,
    json: &Value,
    node: usize,
    most: usize,
    out: &mut Findings,
) -> Option<Vec<DAffine3>> {
    let extension = json.get("extensions")?.get("EXT_mesh_gpu_instancing")?;
    let path = format!("nodes[{node}].extensions.EXT_mesh_gpu_instancing.attributes");
    let attributes = &extension["attributes"];
    let mut count = None;
    let mut read = |name: &str, kind: Kind| -> Result<Option<Vec<f64>>, Finding> {
        let Some(value) = attributes.get(name) else { return Ok(None) };
        let bad = |what: String| {
            Finding::error(format!("{path}.{name}"), what, "repair the instances and export again")
        };
        let index = index_of(value).ok_or_else(|| bad(format!("`{}` is not an index", shown(value))))?;
        // The count is checked before anything is decoded.
        let claimed = doc.json["accessors"][index]["count"].as_u64().unwrap_or(0);
        if (most as u64) < claimed {
            return Err(bad(format!("{claimed} instances; at most {most} more surfaces fit into the bake")));
        }
        let data = doc.accessor(index)?;
        if data.kind != kind || data.component_type == 5125 {
            return Err(bad(format!("accessor {index} is {}, not {}", data.kind.name(), kind.name())));
        }
        if *count.get_or_insert(data.count) != data.count {
            return Err(bad(format!(
                "accessor {index} has {} elements, another attribute has {count:?}",
                data.count
            )));
        }
        let values: Vec<f64> = data.floats().into_iter().map(f64::from).collect();
        match values.iter().position(|v| !v.is_finite()) {
            Some(at) => Err(bad(format!("instance {} is not finite", at / kind.components()))),
            None => Ok(Some(values)),
        }
    };
    let all = read("TRANSLATION", Kind::Vec3)
        .and_then(|t| Ok((t, read("ROTATION", Kind::Vec4)?, read("SCALE", Kind::Vec3)?)));
    let Some((translation, rotation, scale)) = out.keep(all) else { return Some(Vec::new()) };
    let Some(count) = count else {
        out.push(Finding::warning(
            path,
            "no instance attribute that moves anything; one instance is used",
            FIX,
        ));
        return Some(vec![DAffine3::IDENTITY]);
    };
    let vector = |list: &Option<Vec<f64>>, i: usize, default: DVec3| {
        list.as_ref().map_or(default, |l| DVec3::from_slice(&l[3 * i..]))
    };
    let list = (0..count).map(|i| {
        let q = rotation.as_ref().map_or(DQuat::IDENTITY, |l| DQuat::from_slice(&l[4 * i..]));
        let q = unit(q, &format!("{path}.ROTATION"), out);
        DAffine3::from_scale_rotation_translation(
            vector(&scale, i, DVec3::ONE),
            q,
            vector(&translation, i, DVec3::ZERO),
        )
    });
    Some(list.collect())
}

/// The camera of a node.
pub(crate) fn camera(
    doc: &Document,
    tree: &Hierarchy<'_>,
    at: &Placed,
    out: &mut Findings,
) -> Option<Camera> {
    let value = tree.node(at.node).get("camera")?;
    let place = format!("nodes[{}].camera", at.node);
    let Some((index, json)) = index_of(value).and_then(|i| Some((i, doc.json["cameras"].get(i)?))) else {
        out.push(Finding::warning(place, "there is no such camera", FIX));
        return None;
    };
    let path = format!("cameras[{index}]");
    let positive = |v: &Value| float(v).filter(|f| 0.0 < *f);
    let projection = match json["type"].as_str() {
        Some("perspective") => {
            let p = &json["perspective"];
            let yfov = positive(&p["yfov"]).filter(|f| *f < std::f32::consts::PI);
            yfov.map(|yfov| Projection::Perspective { yfov, aspect: positive(&p["aspectRatio"]) })
        }
        Some("orthographic") => {
            let o = &json["orthographic"];
            positive(&o["xmag"])
                .zip(positive(&o["ymag"]))
                .map(|(xmag, ymag)| Projection::Orthographic { xmag, ymag })
        }
        _ => None,
    };
    if projection.is_none() {
        out.push(Finding::warning(path, "the camera's type or extent makes no sense; it is left out", FIX));
    }
    let name = json["name"].as_str().map_or_else(|| tree.name(at.node), |n| n.chars().take(64).collect());
    // A camera sees the same at any scale.
    let axes = at.world.matrix3;
    let axis = |v: DVec3, fallback: DVec3| single(v.try_normalize().unwrap_or(at.rotation * fallback));
    let matrix = Mat4::from_cols(
        axis(axes.x_axis, DVec3::X).extend(0.0),
        axis(axes.y_axis, DVec3::Y).extend(0.0),
        axis(axes.z_axis, DVec3::Z).extend(0.0),
        single(at.world.translation).extend(1.0),
    );
    Some(Camera { name, world_from_camera: matrix, projection: projection? })
}

/// The light of a node (`KHR_lights_punctual`).
pub(crate) fn light(
    doc: &Document,
    tree: &Hierarchy<'_>,
    at: &Placed,
    units: LightUnits,
    words: NodeWords,
    out: &mut Findings,
) -> Option<Light> {
    let extension = tree.node(at.node).get("extensions")?.get("KHR_lights_punctual")?;
    let place = format!("nodes[{}].extensions.KHR_lights_punctual.light", at.node);
    let lights = &doc.json["extensions"]["KHR_lights_punctual"]["lights"];
    let found = extension.get("light").and_then(index_of).and_then(|i| Some((i, lights.get(i)?)));
    let Some((index, json)) = found else {
        out.push(Finding::error(place, "there is no such light", FIX));
        return None;
    };
    let path = format!("extensions.KHR_lights_punctual.lights[{index}]");
    // Tools may put our words on the light instead of on its node.
    let words = match json.get("extras") {
        Some(extras) => words.over(NodeWords::read(extras, &format!("{path}.extras"), true, out)),
        None => words,
    };
    let kind = json["type"].as_str().unwrap_or_default();
    if !matches!(kind, "point" | "spot" | "directional") {
        let what = format!("`{}` is not a type of light", shown(&json["type"]));
        out.push(Finding::error(format!("{path}.type"), what, "use point, spot or directional"));
        return None;
    }
    let strength = strength(json, &path, kind, units, out)?;
    let range = match json.get("range").map(|v| (float(v).filter(|r| 0.0 < *r), v)) {
        None => None,
        Some((Some(r), _)) => Some(r),
        Some((None, v)) => {
            let what = format!("`{}` is not above 0 m; the light reaches everywhere", shown(v));
            out.push(Finding::warning(format!("{path}.range"), what, "give a range above 0 m, or none"));
            None
        }
    };
    let position = single(at.world.translation);
    let direction =
        at.world.transform_vector3(DVec3::NEG_Z).try_normalize().unwrap_or(at.rotation * DVec3::NEG_Z);
    let direction = single(direction);
    let kind = match kind {
        "point" => LightKind::Point { position, intensity: strength, range },
        "spot" => {
            let (inner_cone, outer_cone) = cones(json, &path, out);
            LightKind::Spot { position, direction, intensity: strength, range, inner_cone, outer_cone }
        }
        _ => {
            let angular_diameter = words.angular_diameter.unwrap_or(0.0);
            LightKind::Directional { direction, illuminance: strength, angular_diameter }
        }
    };
    Some(Light { path: tree.path(at.node), node: Some(at.node), mode: words.mode.unwrap_or_default(), kind })
}

fn strength(json: &Value, path: &str, kind: &str, units: LightUnits, out: &mut Findings) -> Option<Rgb> {
    let mut read =
        |key: &str, fallback: Rgb, get: fn(&Value) -> Option<Rgb>| match json.get(key).map(|v| (get(v), v)) {
            None => Some(fallback),
            Some((Some(c), _)) if 0.0 <= c.min_element() => Some(c),
            Some((_, v)) => {
                let what = format!("`{}` is negative or not a number; the light is left out", shown(v));
                out.push(Finding::warning(format!("{path}.{key}"), what, "use numbers of at least 0"));
                None
            }
        };
    let color = read("color", Vec3::ONE, |v| floats::<3>(v).map(Vec3::from))?;
    let intensity = read("intensity", Vec3::ONE, |v| float(v).map(Vec3::splat))?;
    let strength = color * intensity * if kind == "directional" { units.lux() } else { units.candela() };
    if !strength.is_finite() {
        out.push(Finding::error(path, "the light's strength overflows", "make its intensity smaller"));
        return None;
    }
    Some(strength)
}

fn cones(json: &Value, path: &str, out: &mut Findings) -> (f32, f32) {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
    let spot = json.get("spot");
    let mut read = |key: &str, default: f32, ok: fn(f32) -> bool| {
        let Some(v) = spot.and_then(|s| s.get(key)) else { return default };
        float(v).filter(|f| ok(*f)).unwrap_or_else(|| {
            let what = format!("`{}` is not an angle from 0 to pi/2; {default} is used", shown(v));
            out.push(Finding::warning(format!("{path}.spot.{key}"), what, "correct the cone"));
            default
        })
    };
    // Exporters round pi/2 either way.
    let outer = read("outerConeAngle", FRAC_PI_4, |f| 0.0 < f && f < FRAC_PI_2 + 1e-3).min(FRAC_PI_2);
    let inner = read("innerConeAngle", 0.0, |f| (0.0..FRAC_PI_2 + 1e-3).contains(&f));
    if spot.is_none() {
        out.push(Finding::warning(
            path,
            "a spot light needs `spot`; the default cone is used",
            "correct the cone",
        ));
    }
    if outer < inner {
        let what = format!("the inner cone {inner} is wider than the outer one {outer}; both are {outer}");
        out.push(Finding::warning(format!("{path}.spot"), what, "correct the cones"));
    }
    (inner.min(outer), outer)
}

/// Words about nodes from the configuration, by node name or path.
pub(crate) struct NodeIndex<'c> {
    words: BTreeMap<&'c str, (NodeWords, bool)>,
}

impl<'c> NodeIndex<'c> {
    pub(crate) fn new(list: &'c [(String, NodeWords)]) -> Self {
        Self { words: list.iter().map(|(name, words)| (name.as_str(), (*words, false))).collect() }
    }

    /// Words for a node; those by path win over those by name.
    pub(crate) fn find(&mut self, tree: &Hierarchy<'_>, node: usize) -> NodeWords {
        if self.words.is_empty() {
            return NodeWords::default();
        }
        let mut get = |key: &str| {
            self.words.get_mut(key).map(|entry| {
                entry.1 = true;
                entry.0
            })
        };
        let by_path = get(&tree.path(node)).unwrap_or_default();
        by_path.over(get(&tree.name(node)).unwrap_or_default())
    }

    /// Reports names that no node has.
    pub(crate) fn finish(self, names: &[String], out: &mut Findings) {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        for (key, _) in self.words.iter().filter(|(_, (_, used))| !used) {
            let fix = match super::read::nearest(key, &names) {
                (Some(name), s) if 0.7 <= s => format!("the nearest name is `{name}`"),
                _ => "use a node's name, or its path such as hall/column".to_owned(),
            };
            out.push(Finding::warning(
                format!("nodes.\"{key}\""),
                "no node of the scene has this name or path",
                fix,
            ));
        }
    }
}
