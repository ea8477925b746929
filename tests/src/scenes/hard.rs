//! Scenes with geometry that breaks careless code.

use glam::{Quat, Vec3};
use serde_json::json;

use crate::{
    gltf::{Glb, Kind, Material, Node},
    shape::{ALL, Shape},
};

/// One mesh placed many times: turned, scaled evenly, unevenly, with negative determinant, and three times by
/// `EXT_mesh_gpu_instancing`, over a floor, under a sky of 1 nit.
#[must_use]
pub fn instances() -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.6; 3]));
    let mut wedge = Shape::default();
    let [a, b, c] = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let back = Vec3::NEG_Z * 0.5;
    wedge.polygon(&[a, b, c]);
    wedge.polygon(&[a + back, c + back, b + back]);
    wedge.quad([b, b + back, c + back, c]);
    wedge.quad([c, c + back, a + back, a]);
    let mesh = glb.mesh("wedge", &[(&wedge, white)]);
    let turn = Quat::from_rotation_y(0.7) * Quat::from_rotation_x(0.2);
    glb.node(Node::new("plain").mesh(mesh).at([0.0, 0.5, 0.0]));
    glb.node(Node::new("turned").mesh(mesh).at([2.0, 0.5, 0.0]).turned(turn));
    glb.node(Node::new("scaled").mesh(mesh).at([4.0, 0.5, 0.0]).scaled([1.5; 3]));
    glb.node(Node::new("stretched").mesh(mesh).at([0.0, 0.5, -3.0]).turned(turn).scaled([2.0, 0.5, 1.0]));
    glb.node(Node::new("mirrored").mesh(mesh).at([3.0, 0.5, -3.0]).turned(turn).scaled([-1.0, 1.0, 1.0]));
    glb.node(Node::new("flat").mesh(mesh).at([5.0, 0.5, -3.0]).scaled([1.0, 1.0, 0.0]));
    let mut many = Node::new("instanced").mesh(mesh).at([0.0, 0.5, -6.0]);
    many.instances = vec![
        (Vec3::ZERO, Quat::IDENTITY, Vec3::ONE),
        (Vec3::new(2.0, 0.0, 0.0), turn, Vec3::splat(0.75)),
        (Vec3::new(4.0, 0.0, 0.0), Quat::IDENTITY, Vec3::new(1.0, -1.0, 1.0)),
    ];
    glb.node(many);
    let mut floor = Shape::default();
    floor.grid(Vec3::new(-2.0, -1.0, 2.0), Vec3::X * 10.0, Vec3::NEG_Z * 10.0, 1, 1);
    let mesh = glb.mesh("floor", &[(&floor, white)]);
    glb.node(Node::new("floor").mesh(mesh));
    glb.scene_extra("sky", json!([1, 1, 1]));
    glb.finish()
}

/// A quad of 1 m with empty, repeated and needle-thin triangles beside it, under a sky of 1 nit.
#[must_use]
pub fn degenerate() -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.5; 3]));
    let mut s = Shape::default();
    s.quad([Vec3::ZERO, Vec3::X, Vec3::X + Vec3::NEG_Z, Vec3::NEG_Z]);
    s.triangles.extend([[0, 0, 0], [0, 1, 1], [0, 2, 0], [0, 1, 2], [1, 0, 1]]);
    s.positions.extend([Vec3::X * 0.5, Vec3::new(0.5, 0.0, 1e-12), Vec3::new(0.5, 0.0, -1e-12)]);
    s.normals.extend([Vec3::Y; 3]);
    s.triangles.extend([[0, 1, 4], [0, 1, 5], [0, 6, 1]]);
    let mesh = glb.mesh("degenerate", &[(&s, white)]);
    glb.node(Node::new("degenerate").mesh(mesh));
    glb.scene_extra("sky", json!([1, 1, 1]));
    glb.finish()
}

/// Two equal quads of 1 m in the same place, 1 m below a lamp of 1 candela.
#[must_use]
pub fn duplicates() -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.5; 3]));
    let mut s = Shape::default();
    s.grid(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z, 1, 1);
    let mesh = glb.mesh("quad", &[(&s, white)]);
    glb.node(Node::new("first").mesh(mesh));
    glb.node(Node::new("second").mesh(mesh));
    let mut node = Node::new("lamp").at([0.0, 1.0, 0.0]);
    node.light = Some(glb.light("lamp", Kind::Point, [1.0; 3], 1.0));
    glb.node(node);
    glb.finish()
}

/// A box over a floor under a sky of 1 nit, `size` metres wide and moved by `offset` metres.
#[must_use]
pub fn sized(size: f32, offset: Vec3) -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.5; 3]));
    let mut floor = Shape::default();
    floor.grid(Vec3::new(-0.5, 0.0, 0.5) * size, Vec3::X * size, Vec3::NEG_Z * size, 1, 1);
    let mut block = Shape::default();
    block.cuboid(Vec3::new(-0.125, 0.25, -0.125) * size, Vec3::new(0.125, 0.5, 0.125) * size, ALL);
    for (name, shape) in [("floor", &floor), ("block", &block)] {
        let mesh = glb.mesh(name, &[(shape, white)]);
        glb.node(Node::new(name).mesh(mesh).at(offset));
    }
    glb.scene_extra("sky", json!([1, 1, 1]));
    glb.finish()
}

/// A double-sided box of 1 m that reflects everything, in nothing but the light of a lamp above it: four of its sides and its bottom
/// are dark, and inside it no path ends by itself.
#[must_use]
pub fn white_box() -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [1.0; 3]).double_sided());
    let mut s = Shape::default();
    s.cuboid([-0.5; 3], [0.5; 3], ALL);
    let mesh = glb.mesh("box", &[(&s, white)]);
    glb.node(Node::new("box").mesh(mesh));
    let lamp = glb.light("lamp", Kind::Point, [1.0; 3], 10.0);
    glb.node(Node { light: Some(lamp), ..Node::new("lamp").at([0.0, 2.0, 0.0]) });
    glb.finish()
}
