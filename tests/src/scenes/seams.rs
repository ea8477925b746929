//! Smooth surfaces that an atlas has to cut, and objects that touch.

use glam::{Vec2, Vec3};

use crate::{
    gltf::{Glb, Kind, Material, Node},
    shape::{Shape, Sides},
};

/// What [`surface`] shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Smooth {
    /// A round column of 48 facets.
    Column,
    /// A sphere of 1,280 triangles.
    Sphere,
}

/// A smooth body of 2 m across over a floor, under a sky that is brighter above, beside a lamp. Lengths are
/// multiplied by `length`.
#[must_use]
pub fn surface(smooth: Smooth, length: f32) -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.7, 0.6, 0.5]));
    let mut body = Shape::default();
    match smooth {
        Smooth::Column => body.lathe(&[Vec2::new(1.0, 0.0), Vec2::new(1.0, 3.0)], 48),
        Smooth::Sphere => body.icosphere(1.0, 3, false),
    }
    let height = if smooth == Smooth::Sphere { 1.5 } else { 0.0 };
    let mut floor = Shape::default();
    floor.grid(Vec3::new(-3.0, 0.0, 3.0), 6.0 * Vec3::X, -6.0 * Vec3::Z, 1, 1);
    for (name, shape, y) in [("body", body, height), ("floor", floor, 0.0)] {
        let shape = shape.moved([0.0, y, 0.0]);
        let scaled = shape.transformed(glam::Affine3A::from_scale(Vec3::splat(length)));
        let mesh = glb.mesh(name, &[(&scaled, white)]);
        glb.node(Node::new(name).mesh(mesh));
    }
    let mut node = Node::new("lamp").at(Vec3::new(2.5, 2.75, 1.5) * length);
    node.light = Some(glb.light("lamp", Kind::Point, [1.0, 0.75, 0.5], 8.0 * length * length));
    glb.node(node);
    let sky = serde_json::json!({"zenith": [1.0, 1.25, 1.5], "horizon": 0.5, "ground": 0.125});
    glb.scene_extra("sky", sky);
    glb.finish()
}

/// A corridor that turns a corner, of separate objects that touch: five pieces, each with its own floor, walls and
/// ceiling. A luminous panel lies under the ceiling at one end; the other is lit around the corner. The floor beyond
/// the corner consists of two boards side by side, so that their short edges share a long one. Lengths are multiplied
/// by `length`.
#[must_use]
pub fn corridor(length: f32) -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.75, 0.7, 0.6]));
    let lamp = glb.material(&Material::matte("lamp", [0.5; 3]).emitting([10.0, 9.0, 7.0]));
    let mut add = |name: &str, shape: Shape, material: usize| {
        let scaled = shape.transformed(glam::Affine3A::from_scale(Vec3::splat(length)));
        let mesh = glb.mesh(name, &[(&scaled, material)]);
        glb.node(Node::new(name).mesh(mesh));
    };
    let piece = |min: [f32; 3], max: [f32; 3], sides: Sides| {
        let mut s = Shape::default();
        s.cuboid(min, max, sides);
        s.inside_out()
    };
    // Sides in the order -X, +X, -Y, +Y, -Z, +Z; open where pieces meet.
    add("start", piece([0.0, 0.0, 0.0], [2.0, 2.5, 2.0], [true, false, true, true, true, true]), white);
    add("middle", piece([2.0, 0.0, 0.0], [4.0, 2.5, 2.0], [false, false, true, true, true, true]), white);
    add("corner", piece([4.0, 0.0, 0.0], [6.0, 2.5, 2.0], [false, true, true, true, true, false]), white);
    add("beyond", piece([4.0, 0.0, 2.0], [6.0, 2.5, 4.0], [true, true, false, true, false, false]), white);
    add("end", piece([4.0, 0.0, 4.0], [6.0, 2.5, 6.0], [true, true, true, true, false, true]), white);
    for (name, x0, x1) in [("left board", 4.0, 4.75), ("right board", 4.75, 6.0)] {
        add(name, piece([x0, 0.0, 2.0], [x1, 2.5, 4.0], [false, false, true, false, false, false]), white);
    }
    let mut panel = Shape::default();
    let at = |x: f32, z: f32| Vec3::new(x, 2.25, z);
    panel.quad([at(0.5, 0.5), at(1.5, 0.5), at(1.5, 1.5), at(0.5, 1.5)]);
    add("panel", panel, lamp);
    glb.finish()
}
