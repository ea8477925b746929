//! Which surfaces show the same shape, and so can share a layout.

use glam::{DMat3, DVec2, DVec3, Mat3};

use crate::{
    error::Finding,
    scene::model::{Mesh, Scene},
};

/// Relative difference of squared lengths up to which two surfaces count as similar.
const SIMILAR: f64 = 1e-4;

/// One shape: a mesh under one linear map, up to rotation, mirroring and uniform scale.
pub(super) struct Class {
    /// Index into [`Scene::meshes`].
    pub(super) mesh: usize,
    /// Vertex positions of the shape, scaled by a power of two so that the largest coordinate is
    /// in [1, 2).
    pub(super) positions: Vec<[f32; 3]>,
    /// Area of the shape in units of `positions`, above 0.
    pub(super) area: f64,
    /// Mesh units per unit of `positions`, a power of two.
    unit: f64,
    /// Who shows it, in scene order.
    pub(super) members: Vec<Member>,
}

/// A surface that shows a class.
pub(super) struct Member {
    /// Index into [`Scene::surfaces`].
    pub(super) surface: usize,
    /// Metres per unit of [`Class::positions`].
    pub(super) metres: f64,
}

impl Class {
    /// Area of triangle `t` in units of `positions`.
    pub(super) fn triangle_area(&self, t: [u32; 3]) -> f64 {
        let [a, b, c] = self.corners(t);
        (b - a).cross(c - a).length() * 0.5
    }

    /// Whether at least one triangle is wide enough to be unwrapped: more than [`NARROW`] of the mesh's extent.
    fn has_charts(&self, mesh: &Mesh) -> bool {
        let all = || self.positions.iter().map(|p| DVec3::from(p.map(f64::from)));
        let lo = all().fold(DVec3::INFINITY, DVec3::min);
        let hi = all().fold(DVec3::NEG_INFINITY, DVec3::max);
        let narrow = NARROW * (hi - lo).length();
        mesh.triangles.iter().any(|&t| {
            let [a, b, c] = self.corners(t);
            let longest = (b - a).length().max((c - b).length()).max((a - c).length());
            narrow * longest < 2.0 * self.triangle_area(t)
        })
    }

    /// Corner positions of triangle `t`.
    pub(super) fn corners(&self, t: [u32; 3]) -> [DVec3; 3] {
        t.map(|v| DVec3::from(self.positions[v as usize].map(f64::from)))
    }
}

/// A triangle of less height than this part of its mesh's extent gets no chart. The unwrapper stops at a tenth of it.
const NARROW: f64 = 1e-5;

/// Sorts the `wanted` surfaces into classes, in order of first appearance. Surfaces without area
/// or with positions that are not finite are left out, with a finding.
pub(super) fn classes(scene: &Scene, wanted: &[usize], findings: &mut Vec<Finding>) -> Vec<Class> {
    let mut classes: Vec<Class> = Vec::new();
    let mut shapes: Vec<DMat3> = Vec::new();
    let mut of_mesh: Vec<Vec<usize>> = vec![Vec::new(); scene.meshes.len()];
    for &surface in wanted {
        let s = &scene.surfaces[surface];
        let mesh = &scene.meshes[s.mesh];
        let linear = Mat3::from(s.world_from_mesh.matrix3).as_dmat3();
        let gram = linear.transpose() * linear;
        let squared = (gram.x_axis.x + gram.y_axis.y + gram.z_axis.z) / 3.0;
        if mesh.triangles.is_empty() {
            continue;
        }
        let scale = squared.sqrt();
        if !(scale.is_finite() && 0.0 < scale) {
            findings.push(no_area(&s.path, &format!("its scale is {scale}")));
            continue;
        }
        let shape = gram * (1.0 / squared);
        let known = of_mesh[s.mesh]
            .iter()
            .copied()
            .find(|&c| (shapes[c] - shape).to_cols_array().iter().all(|d| d.abs() < SIMILAR));
        let class = match known {
            Some(c) => c,
            None => {
                let uniform = (DMat3::IDENTITY - shape).to_cols_array().iter().all(|d| d.abs() < SIMILAR);
                let map = if uniform { DMat3::IDENTITY } else { linear * (1.0 / scale) };
                shapes.push(if uniform { DMat3::IDENTITY } else { shape });
                of_mesh[s.mesh].push(classes.len());
                classes.push(class(s.mesh, mesh, &map));
                classes.len() - 1
            }
        };
        let c = &mut classes[class];
        if !(c.area.is_finite() && 0.0 < c.area) {
            findings.push(no_area(&s.path, &format!("the triangles of {} have no area", mesh.name)));
            continue;
        }
        c.members.push(Member { surface, metres: scale * c.unit });
    }
    classes.retain(|c| !c.members.is_empty());
    classes
}

/// The class, without members.
fn class(index: usize, mesh: &Mesh, map: &DMat3) -> Class {
    let mapped: Vec<DVec3> = mesh.positions.iter().map(|p| *map * p.as_dvec3()).collect();
    let largest = mapped.iter().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    let finite = mapped.iter().all(|p| p.is_finite());
    let unit = if finite && 0.0 < largest { power_of_two(largest) } else { 1.0 };
    let mut class = Class {
        mesh: index,
        positions: mapped.iter().map(|p| (*p / unit).as_vec3().to_array()).collect(),
        area: 0.0,
        unit,
        members: Vec::new(),
    };
    if finite && class.has_charts(mesh) {
        class.area = mesh.triangles.iter().map(|&t| class.triangle_area(t)).sum();
    }
    class
}

/// The power of two at or below a positive finite number.
pub(super) fn power_of_two(x: f64) -> f64 {
    let p = f64::from_bits(x.to_bits() & 0x7ff0_0000_0000_0000);
    if 0.0 < p { p } else { f64::MIN_POSITIVE }
}

fn no_area(path: &str, why: &str) -> Finding {
    Finding::warning(
        path,
        format!("gets no texels: {why}"),
        "give the node a scale other than 0 and its mesh triangles with area, or set its lightmap to off",
    )
}

/// Twice the signed area of a triangle in the plane.
pub(crate) fn cross(t: [DVec2; 3]) -> f64 {
    (t[1] - t[0]).perp_dot(t[2] - t[0])
}
