//! Rooms that no light enters from outside.

use glam::Vec3;

use crate::{
    gltf::{Glb, Kind, Material, Node},
    shape::{ALL, NO_BOTTOM, NO_TOP, Shape},
};

/// A cube of 1 m, seen from inside, whose walls have albedo `rho` and emit `emission` nits: `E / pi` is
/// `emission / (1 - rho)` everywhere.
#[must_use]
pub fn furnace(rho: f32, emission: f32) -> Vec<u8> {
    let mut cube = Shape::default();
    cube.cuboid([-0.5; 3], [0.5; 3], ALL);
    furnace_of(&cube.inside_out(), rho, emission)
}

/// The same in an icosphere of radius 1 m, whose flat faces meet at angles no grid knows.
#[must_use]
pub fn round_furnace(rho: f32, emission: f32) -> Vec<u8> {
    let mut sphere = Shape::default();
    sphere.icosphere(1.0, 1, true);
    furnace_of(&sphere.flat(), rho, emission)
}

fn furnace_of(shape: &Shape, rho: f32, emission: f32) -> Vec<u8> {
    let mut glb = Glb::new();
    let wall = glb.material(&Material::matte("wall", [rho; 3]).emitting([emission; 3]));
    let mesh = glb.mesh("furnace", &[(shape, wall)]);
    glb.node(Node::new("furnace").mesh(mesh));
    glb.finish()
}

/// A cube of 2 m of albedo 0.9, seen from inside, with a sheet of 1 m that shines up and down 4 cm below the ceiling: most of the light in the
/// gap stays there.
#[must_use]
pub fn gap_below_the_ceiling() -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.9; 3]));
    let shining = glb.material(&Material::matte("lamp", [0.9; 3]).emitting([1.0; 3]));
    let (mut room, mut lamp) = (Shape::default(), Shape::default());
    room.cuboid([-1.0, 0.0, -1.0], [1.0, 2.0, 1.0], ALL);
    lamp.cuboid([-0.5, 1.955, -0.5], [0.5, 1.96, 0.5], ALL);
    for (name, shape, material) in [("room", room.inside_out(), white), ("lamp", lamp, shining)] {
        let mesh = glb.mesh(name, &[(&shape, material)]);
        glb.node(Node::new(name).mesh(mesh));
    }
    glb.finish()
}

/// What [`room`] varies without changing what should come out.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// Multiplies every length and position.
    pub length: f32,
    /// Multiplies the emission of the lamp panel and of the sky.
    pub radiance: f32,
    /// Multiplies the candela of the point light.
    pub candela: f32,
    /// Multiplies the lux of the sun.
    pub lux: f32,
    /// Mirrors along X.
    pub mirrored: bool,
    /// Moves everything, metres (after scaling).
    pub offset: Vec3,
}

impl Default for Room {
    fn default() -> Self {
        Self { length: 1.0, radiance: 1.0, candela: 1.0, lux: 1.0, mirrored: false, offset: Vec3::ZERO }
    }
}

/// A room of 4 x 3 x 3 m with a red and a green wall, a box, an emissive panel under the ceiling, a point light, and
/// a skylight that sun and sky enter by: every kind of light at once.
#[must_use]
pub fn room(r: Room) -> Vec<u8> {
    let mut glb = Glb::new();
    let materials = [
        glb.material(&Material::matte("white", [0.7, 0.7, 0.65])),
        glb.material(&Material::matte("red", [0.6, 0.1, 0.1])),
        glb.material(&Material::matte("green", [0.1, 0.5, 0.15])),
    ];
    let panel =
        glb.material(&Material::matte("panel", [0.5; 3]).emitting(Vec3::new(8.0, 7.0, 5.0) * r.radiance));
    walls(&mut glb, r, materials);
    let side = if r.mirrored { -1.0 } else { 1.0 };
    let mut lamp = Shape::default();
    let at = |x: f32, z: f32| Vec3::new(x, 2.75, z);
    lamp.quad([at(-1.25, -0.25), at(-0.75, -0.25), at(-0.75, 0.25), at(-1.25, 0.25)]);
    let lamp = lamp.transformed(r.fit());
    let mesh = glb.mesh("panel", &[(&lamp, panel)]);
    glb.node(Node::new("panel").mesh(mesh).at(r.offset));

    let place = Vec3::new(side * 1.5, 1.0, 0.75) * r.length + r.offset;
    let mut node = Node::new("lamp").at(place);
    node.light = Some(glb.light("lamp", Kind::Point, [1.0, 0.75, 0.5], 2.0 * r.candela));
    glb.node(node);
    let down = Vec3::new(-0.25 * side, -1.0, 0.125);
    let mut node = Node::new("sun").turned(crate::gltf::looking(down));
    node.light = Some(glb.light("sun", Kind::Directional, [1.0, 1.0, 0.75], 16.0 * r.lux));
    node.extras = serde_json::json!({"angular_diameter": 0.5});
    glb.node(node);
    let sky: Vec<f32> = [0.5, 0.75, 1.0].iter().map(|c| c * r.radiance).collect();
    glb.scene_extra("sky", serde_json::json!(sky));
    glb.finish()
}

/// The room's walls and the box in it.
fn walls(glb: &mut Glb, r: Room, [white, red, green]: [usize; 3]) {
    let [w, h, d] = [2.0, 3.0, 1.5];
    let mut add = |name: &str, shape: Shape, material: usize| {
        let mesh = glb.mesh(name, &[(&shape.transformed(r.fit()), material)]);
        glb.node(Node::new(name).mesh(mesh).at(r.offset));
    };
    let wall = |sides: [bool; 6]| {
        let mut s = Shape::default();
        s.cuboid([-w, 0.0, -d], [w, h, d], sides);
        s.inside_out()
    };
    add("left", wall([true, false, false, false, false, false]), red);
    add("right", wall([false, true, false, false, false, false]), green);
    add("floor", wall([false, false, true, false, false, false]), white);
    add("back", wall([false, false, false, false, true, false]), white);
    add("front", wall([false, false, false, false, false, true]), white);
    // The ceiling leaves a hole of 1 x 1 m.
    let mut ceiling = Shape::default();
    for [x0, x1, z0, z1] in [[-w, 0.5, -d, d], [1.5, w, -d, d], [0.5, 1.5, -d, -0.5], [0.5, 1.5, 0.5, d]] {
        let at = |x: f32, z: f32| Vec3::new(x, h, z);
        ceiling.quad([at(x0, z0), at(x1, z0), at(x1, z1), at(x0, z1)]);
    }
    add("ceiling", ceiling, white);
    let mut block = Shape::default();
    block.cuboid([-1.0, 0.0, -0.75], [-0.25, 1.0, 0.0], NO_BOTTOM);
    add("block", block, white);
}

impl Room {
    fn fit(self) -> glam::Affine3A {
        let side = if self.mirrored { -1.0 } else { 1.0 };
        glam::Affine3A::from_scale(Vec3::new(side, 1.0, 1.0) * self.length)
    }
}

/// The same room without any light and all white.
#[must_use]
pub fn bare_room() -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.7, 0.7, 0.65]));
    walls(&mut glb, Room::default(), [white; 3]);
    glb.finish()
}

/// Two rooms of 2 x 2 x 2 m side by side along X; a lamp of 10 nits fills the ceiling of the left one. A wall of
/// `thickness` metres parts them (0: one double-sided sheet); outer walls are solid and 0.2 m thick.
#[must_use]
pub fn two_rooms(thickness: f32) -> Vec<u8> {
    rooms(thickness, None)
}

/// The same beside a black speck at `speck`, which moves the middle of the scene and with it every lattice.
#[must_use]
pub fn rooms_beside(thickness: f32, speck: Vec3) -> Vec<u8> {
    rooms(thickness, Some(speck))
}

fn rooms(thickness: f32, speck: Option<Vec3>) -> Vec<u8> {
    let mut glb = Glb::new();
    if let Some(at) = speck {
        let mut s = Shape::default();
        s.polygon(&[Vec3::X, Vec3::Y, Vec3::Z].map(|v| 0.01 * v + at));
        let black = glb.material(&Material::matte("speck", [0.0; 3]));
        let mesh = glb.mesh("speck", &[(&s, black)]);
        glb.node(Node::new("speck").mesh(mesh));
    }
    let white = glb.material(&Material::matte("white", [0.8; 3]));
    let sheet = glb.material(&Material::matte("sheet", [0.8; 3]).double_sided());
    let lamp = glb.material(&Material::matte("lamp", [0.5; 3]).emitting([10.0; 3]));
    let mut add = |name: &str, shape: &Shape, material: usize| {
        let mesh = glb.mesh(name, &[(shape, material)]);
        glb.node(Node::new(name).mesh(mesh));
    };
    let half = 0.5 * thickness;
    for (name, x0, x1, sides) in [
        ("lit room", -2.0 - half, -half, [true, 0.0 < thickness, true, true, true, true]),
        ("dark room", half, 2.0 + half, [0.0 < thickness, true, true, true, true, true]),
    ] {
        let mut s = Shape::default();
        s.cuboid([x0, 0.0, -1.0], [x1, 2.0, 1.0], sides);
        add(name, &s.inside_out(), white);
    }
    if thickness <= 0.0 {
        let mut s = Shape::default();
        let at = |y: f32, z: f32| Vec3::new(0.0, y, z);
        s.quad([at(0.0, 1.0), at(0.0, -1.0), at(2.0, -1.0), at(2.0, 1.0)]);
        add("partition", &s, sheet);
    }
    let mut s = Shape::default();
    s.cuboid([-2.2 - half, -0.2, -1.2], [2.2 + half, 2.2, 1.2], ALL);
    add("outside", &s, white);
    let mut s = Shape::default();
    let at = |x: f32, z: f32| Vec3::new(x - half, 1.9, z);
    s.quad([at(-1.75, -0.75), at(-0.25, -0.75), at(-0.25, 0.75), at(-1.75, 0.75)]);
    add("lamp", &s, lamp);
    glb.finish()
}

/// A white room with a lamp and in it a hollow double-sided panel, 0.1 m thick, whose lid leaves a slit of 5 mm.
/// `inward`: its triangles are wound so that their fronts look into the cavity.
#[must_use]
pub fn panel(inward: bool) -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.7; 3]));
    let sheet = glb.material(&Material::matte("sheet", [0.7; 3]).double_sided());
    let lamp = glb.material(&Material::matte("lamp", [0.0; 3]).emitting([10.0; 3]));
    let mut add = |name: &str, shape: &Shape, material: usize| {
        let mesh = glb.mesh(name, &[(shape, material)]);
        glb.node(Node::new(name).mesh(mesh));
    };
    let mut walls = Shape::default();
    walls.cuboid([-2.0, 0.0, -2.0], [2.0, 3.0, 2.0], ALL);
    add("walls", &walls.inside_out(), white);
    let mut quad = Shape::default();
    let at = |x: f32, z: f32| Vec3::new(x, 2.9, z);
    quad.quad([at(-0.5, -0.5), at(0.5, -0.5), at(0.5, 0.5), at(-0.5, 0.5)]);
    add("lamp", &quad, lamp);
    let mut body = Shape::default();
    body.cuboid([-0.75, 0.5, -0.05], [0.75, 1.5, 0.05], NO_TOP);
    let at = |x: f32, z: f32| Vec3::new(x, 1.5, z);
    body.quad([at(-0.75, 0.045), at(0.75, 0.045), at(0.75, -0.05), at(-0.75, -0.05)]);
    add("panel", &if inward { body.inside_out() } else { body }, sheet);
    glb.finish()
}

/// A closed black box of 2 m around the origin with a lamp inside, and a quad outside that nothing else lights.
#[must_use]
pub fn lamp_in_a_box() -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.7; 3]));
    let mut box_ = Shape::default();
    box_.cuboid([-1.0; 3], [1.0; 3], ALL);
    let mesh = glb.mesh("box", &[(&box_, white)]);
    glb.node(Node::new("box").mesh(mesh));
    let mut floor = Shape::default();
    floor.grid(Vec3::new(-3.0, -1.5, 3.0), Vec3::X * 6.0, Vec3::Z * -6.0, 2, 2);
    let mesh = glb.mesh("floor", &[(&floor, white)]);
    glb.node(Node::new("floor").mesh(mesh));
    let mut node = Node::new("lamp").at([0.25, 0.5, 0.125]);
    node.light = Some(glb.light("lamp", Kind::Point, [1.0; 3], 1000.0));
    glb.node(node);
    glb.finish()
}

/// An open room lit by a quad of `edge` metres under the ceiling that emits `emission` nits, optionally with a texture
/// that is white on its left half and black on its right.
#[must_use]
pub fn quad_lamp(edge: f32, emission: f32, textured: bool) -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.7; 3]));
    let mut walls = Shape::default();
    walls.cuboid([-1.5, 0.0, -1.5], [1.5, 2.0, 1.5], NO_TOP);
    let mesh = glb.mesh("walls", &[(&walls.inside_out(), white)]);
    glb.node(Node::new("walls").mesh(mesh));
    let mut material = Material::matte("lamp", [0.0; 3]).emitting([emission; 3]);
    if textured {
        let half = crate::gltf::png(2, false, |x, _| if x == 0 { [255; 4] } else { [0, 0, 0, 255] });
        material.emission_texture = Some(glb.texture(&half));
    }
    let lamp = glb.material(&material);
    let h = 0.5 * edge;
    let mut quad = Shape::default();
    let at = |x: f32, z: f32| Vec3::new(x, 1.9, z);
    quad.quad([at(-h, -h), at(h, -h), at(h, h), at(-h, h)]);
    let mesh = glb.mesh("lamp", &[(&quad.corner_uvs(), lamp)]);
    glb.node(Node::new("lamp").mesh(mesh));
    glb.finish()
}

/// A closed white corridor, 2 m wide and 2.5 m high, of two arms of 4 m around a corner; the lamp at the end of one is not seen from the end of the other.
#[must_use]
pub fn corner() -> Vec<u8> {
    let mut glb = Glb::new();
    let white = glb.material(&Material::matte("white", [0.6, 0.6, 0.5]));
    let mut add = |name: &str, shape: &Shape| {
        let mesh = glb.mesh(name, &[(shape, white)]);
        glb.node(Node::new(name).mesh(mesh));
    };
    let mut walls = Shape::default();
    walls.cuboid([-2.0, 0.0, -2.0], [2.0, 2.5, 2.0], ALL);
    add("walls", &walls.inside_out());
    let mut block = Shape::default();
    block.cuboid([0.0, -0.1, 0.0], [2.1, 2.6, 2.1], ALL);
    add("block", &block);
    let mut node = Node::new("lamp").at([-1.0, 2.0, 1.7]);
    node.light = Some(glb.light("lamp", Kind::Point, [1.0; 3], 100.0));
    glb.node(node);
    glb.finish()
}
