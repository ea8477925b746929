//! A plane with lamps, a sky, or things between them.

use glam::{Quat, Vec3};
use serde_json::{Value, json};

use crate::{
    gltf::{Glb, Id, Kind, Material, Node, looking, png},
    shape::{NO_BOTTOM, Shape},
};

fn floor(glb: &mut Glb, edge: f32, cells: u16, albedo: f32) {
    let mut s = Shape::default();
    s.grid(Vec3::new(-0.5, 0.0, 0.5) * edge, Vec3::X * edge, Vec3::NEG_Z * edge, cells, cells);
    let material = glb.material(&Material::matte("floor", [albedo; 3]));
    let mesh = glb.mesh("floor", &[(&s, material)]);
    glb.node(Node::new("floor").mesh(mesh));
}

fn lamp(glb: &mut Glb, kind: Kind, color: [f32; 3], intensity: f32, node: Node) {
    let light = glb.light("lamp", kind, color, intensity);
    glb.node(Node { light: Some(light), ..node });
}

/// A plane of `edge` metres in `cells` x `cells` quads under a sky of `sky` nits: `E / pi` is the sky everywhere.
#[must_use]
pub fn under_sky(edge: f32, cells: u16, sky: [f32; 3]) -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, edge, cells, 0.5);
    glb.scene_extra("sky", json!(sky));
    glb.finish()
}

/// The same under a gradient that is black at the horizon and `zenith` nits straight up: `E / pi` is `2/3 zenith`.
#[must_use]
pub fn under_gradient(edge: f32, zenith: [f32; 3]) -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, edge, 1, 0.5);
    glb.scene_extra("sky", json!({"zenith": zenith, "horizon": [0, 0, 0], "ground": [0, 0, 0]}));
    glb.finish()
}

/// A plane of 4 m with a point light of `candela` at `height` metres above its middle.
#[must_use]
pub fn under_point(height: f32, candela: [f32; 3]) -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, 4.0, 1, 0.5);
    let most = candela.into_iter().fold(f32::MIN_POSITIVE, f32::max);
    lamp(&mut glb, Kind::Point, candela.map(|c| c / most), most, Node::new("lamp").at([0.0, height, 0.0]));
    glb.finish()
}

/// The same with a spot that looks straight down; half angles in radians.
#[must_use]
pub fn under_spot(height: f32, candela: f32, inner: f32, outer: f32) -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, 4.0, 1, 0.5);
    let node = Node::new("lamp").at([0.0, height, 0.0]).turned(looking(Vec3::NEG_Y));
    lamp(&mut glb, Kind::Spot { inner, outer }, [1.0; 3], candela, node);
    glb.finish()
}

/// The same under a sun of `lux` that shines along `direction`, `angular_diameter` in degrees.
#[must_use]
pub fn under_sun(lux: f32, direction: Vec3, angular_diameter: f32) -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, 4.0, 1, 0.5);
    let node = Node::new("sun").turned(looking(direction));
    let node = node.extras(json!({"angular_diameter": angular_diameter}));
    lamp(&mut glb, Kind::Directional, [1.0; 3], lux, node);
    glb.finish()
}

/// A box of 1 m that stands on a plane of 4 m, under a uniform sky of 1 nit.
#[must_use]
pub fn box_on_floor() -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, 4.0, 1, 0.5);
    let white = glb.material(&Material::matte("box", [0.5; 3]));
    let mut s = Shape::default();
    s.cuboid([-0.5, 0.0, -0.5], [0.5, 1.0, 0.5], NO_BOTTOM);
    let mesh = glb.mesh("box", &[(&s, white)]);
    glb.node(Node::new("box").mesh(mesh).turned(Quat::from_rotation_y(0.3)));
    glb.scene_extra("sky", json!([1, 1, 1]));
    glb.finish()
}

fn pane(glb: &mut Glb, material: Id) {
    let mut s = Shape::default();
    let at = |x: f32, z: f32| Vec3::new(x, 1.0, z);
    s.quad([at(-1.0, 1.0), at(1.0, 1.0), at(1.0, -1.0), at(-1.0, -1.0)]);
    let mesh = glb.mesh("pane", &[(&s.corner_uvs(), material)]);
    glb.node(Node::new("pane").mesh(mesh).extras(json!({"lightmap": "off"})));
}

/// A sun of pi lux straight above a black plane of 4 m, and 1 m over its middle a pane of 2 m with a checker of
/// `cells` x `cells` (up to 64), opaque and cut out: below the holes `E / pi` is 1, below the rest 0.
#[must_use]
pub fn masked_pane(cells: u32) -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, 4.0, 1, 0.0);
    // Many texels a cell, so that interpolation moves no edge.
    let size = cells * 16;
    let checker =
        png(size, true, |x, y| if (x / 16 + y / 16).is_multiple_of(2) { [0, 0, 0, 255] } else { [0; 4] });
    let texture = glb.texture(&checker);
    let mut material = Material::matte("pane", Vec3::ONE).textured(texture).double_sided();
    material.mask = Some(0.5);
    let material = glb.material(&material);
    pane(&mut glb, material);
    lamp(
        &mut glb,
        Kind::Directional,
        [1.0; 3],
        std::f32::consts::PI,
        Node::new("sun").turned(looking(Vec3::NEG_Y)),
    );
    glb.finish()
}

/// The same with a pane of glass that lets `transmission * tint` through.
#[must_use]
pub fn glass_pane(transmission: f32, tint: [f32; 3]) -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, 4.0, 1, 0.0);
    let glass = Material { transmission, ..Material::matte("glass", tint).double_sided() };
    let material = glb.material(&glass);
    pane(&mut glb, material);
    lamp(
        &mut glb,
        Kind::Directional,
        [1.0; 3],
        std::f32::consts::PI,
        Node::new("sun").turned(looking(Vec3::NEG_Y)),
    );
    glb.finish()
}

/// A plane of 20 m with a wall 3 m high and 6 m long, under a low sun, a sky and a lamp behind the wall.
#[must_use]
pub fn wall_outdoors() -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, 20.0, 4, 0.5);
    let material = glb.material(&Material::matte("wall", [0.6, 0.5, 0.4]));
    let mut wall = Shape::default();
    wall.cuboid([-3.0, 0.0, -0.2], [3.0, 3.0, 0.2], NO_BOTTOM);
    let mesh = glb.mesh("wall", &[(&wall, material)]);
    glb.node(Node::new("wall").mesh(mesh));
    lamp(&mut glb, Kind::Point, [1.0, 0.8, 0.6], 20.0, Node::new("lamp").at([0.0, 1.5, -1.5]));
    let down = Node::new("sun").turned(looking(Vec3::new(0.3, -0.5, -0.8)));
    lamp(&mut glb, Kind::Directional, [1.0, 0.9, 0.7], 30.0, down);
    glb.scene_extra("sky", json!([1.0, 1.5, 2.5]));
    glb.finish()
}

/// A lamp of `candela` at a height of `height` metres in fog without end, and nothing else but a black speck 30 m away.
#[must_use]
pub fn lamp_in_fog(height: f32, candela: f32, fog: &Value) -> Vec<u8> {
    let mut glb = Glb::new();
    let mut s = Shape::default();
    s.polygon(&[Vec3::X, Vec3::Y, Vec3::Z].map(|v| 0.01 * v + 30.0 * Vec3::X));
    let black = glb.material(&Material::matte("speck", [0.0; 3]));
    let mesh = glb.mesh("speck", &[(&s, black)]);
    glb.node(Node::new("speck").mesh(mesh));
    lamp(&mut glb, Kind::Point, [1.0; 3], candela, Node::new("lamp").at([0.0, height, 0.0]));
    glb.scene_extra("media", json!([fog]));
    glb.finish()
}

/// A ball of radius 1 m around (0, 2, 0).
#[must_use]
pub fn ball() -> Shape {
    let mut s = Shape::default();
    s.icosphere(1.0, 1, false);
    s.moved([0.0, 2.0, 0.0])
}

/// A plane of 4 m under a point, a spot and a sun, in every kind of medium: haze that falls with height, a grid in a box, and [`ball`].
#[must_use]
pub fn all_media() -> Vec<u8> {
    let mut glb = Glb::new();
    floor(&mut glb, 4.0, 1, 0.5);
    let white = glb.material(&Material::matte("white", [0.5; 3]));
    let mesh = glb.mesh("ball", &[(&ball(), white)]);
    let cloud = json!({"medium": {"sigma_s": [0.5, 0.25, 0.125], "sigma_a": 0.0625, "g": 0.5}});
    glb.node(Node::new("cloud").mesh(mesh).extras(cloud));
    lamp(&mut glb, Kind::Point, [1.0, 0.5, 0.25], 8.0, Node::new("point").at([1.0, 1.5, -0.5]));
    let node = Node::new("spot").at([-1.0, 2.0, 0.0]).turned(looking(Vec3::NEG_Y));
    lamp(&mut glb, Kind::Spot { inner: 0.25, outer: 0.5 }, [1.0; 3], 4.0, node);
    lamp(&mut glb, Kind::Directional, [1.0; 3], 2.0, Node::new("sun").turned(looking(Vec3::NEG_Y)));
    let values: Vec<u8> = (0..24).map(|i| i % 5).collect();
    glb.scene_extra(
        "media",
        json!([
            {"sigma_s": 0.01, "density": {"height": {"base": 0.5, "falloff": 2.0}}},
            {
                "sigma_a": 0.5,
                "density": {"stencil": {"size": [2, 3, 4], "values": values}},
                "box": {"min": [-2, 0, -2], "max": [-1, 1, 2]},
            },
        ]),
    );
    glb.finish()
}

/// A square of 1 m in the plane y = 0, that shines with `emission` nits or reflects half of the light of a lamp of `candela` 1 m above its
/// middle, in fog without end.
#[must_use]
pub fn square_in_fog(emission: f32, candela: f32, fog: &Value) -> Vec<u8> {
    let mut glb = Glb::new();
    let mut s = Shape::default();
    s.grid(Vec3::new(-0.5, 0.0, 0.5), Vec3::X, Vec3::NEG_Z, 1, 1);
    let material = Material::matte("square", [if 0.0 < emission { 0.0 } else { 0.5 }; 3]);
    let material = glb.material(&material.emitting([emission; 3]));
    let mesh = glb.mesh("square", &[(&s, material)]);
    glb.node(Node::new("square").mesh(mesh));
    if 0.0 < candela {
        lamp(&mut glb, Kind::Point, [1.0; 3], candela, Node::new("lamp").at([0.0, 1.0, 0.0]));
    }
    glb.scene_extra("media", json!([fog]));
    glb.finish()
}
