//! The default scene: a columned hall in the evening sun, full of haze, with a dark room next door.
//!
//! The hall is 12 x 8 x 5 m with the origin in the middle of its floor and the nave along X. Walls are 0.3 m thick and
//! have an outer shell without texels. Inner faces end exactly where they meet, so that no texel is buried; furniture
//! and columns are sunk a little into what they stand on.

use glam::{Affine3A, Quat, Vec2, Vec3};
use serde_json::json;

use crate::{
    gltf::{Glb, Id, Kind, Material, Node, looking, png},
    shape::{ALL, ArchedWall, NO_BOTTOM, NO_TOP, Shape, sin_cos},
};

/// Linear colour of a 2700 K lamp, largest channel 1.
pub const WARM: [f32; 3] = [1.0, 0.4, 0.1];

/// Where the columns of a row stand along X, metres.
const COLUMNS: [f32; 4] = [-4.0, -4.0 / 3.0, 4.0 / 3.0, 4.0];
/// Distance of the rows from the middle of the nave, metres.
const ROW: f32 = 2.2;
/// Where arches start, metres.
const SPRING: f32 = 3.2;

struct Materials {
    plaster: Id,
    stone: Id,
    floor: Id,
    wood: Id,
    iron: Id,
    soot: Id,
    velvet: Id,
    carpet: Id,
    blue: Id,
    ochre: Id,
    linen: Id,
    clay: Id,
    wax: Id,
    flame: Id,
    bulb: Id,
}

/// The scene's bytes.
#[must_use]
pub fn hall() -> Vec<u8> {
    let mut glb = Glb::new();
    let m = materials(&mut glb);
    shell(&mut glb, &m);
    columns(&mut glb, &m);
    ceiling(&mut glb, &m);
    windows(&mut glb, &m);
    furniture(&mut glb, &m);
    cloth(&mut glb, &m);
    side_room(&mut glb, &m);
    lamps(&mut glb, &m);
    glb.camera("camera", Vec3::new(-5.8, 1.7, 0.75), Vec3::new(1.5, 1.72, -0.6), 55f32.to_radians());
    glb.scene_extra("sky", json!({"zenith": [9, 13, 24], "horizon": [33, 28, 25], "ground": [5, 4, 3]}));
    glb.scene_extra("texels_per_metre", json!(12));
    // It ends inside the walls, so that no surface coincides with its sides.
    glb.scene_extra(
        "media",
        json!([{
            "name": "haze",
            "sigma_s": 0.14,
            "sigma_a": 0.004,
            "g": 0.3,
            "box": {"min": [-6.1, -0.1, -4.1], "max": [6.1, 5.1, 4.1]},
        }]),
    );
    glb.finish()
}

/// A reproducible number in [0, 1) for a cell of a texture.
fn noise(x: u32, y: u32) -> f32 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    f32::from(u16::try_from((h ^ (h >> 15)) >> 16).unwrap_or(0)) / 65536.0
}

/// An sRGB texel of `tint` (0 to 255), scaled.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0 to 255")]
fn texel(tint: [f32; 3], scale: f32) -> [u8; 4] {
    let [r, g, b] = tint.map(|c| (c * scale).clamp(0.0, 255.0) as u8);
    [r, g, b, 255]
}

fn materials(glb: &mut Glb) -> Materials {
    // Four by four tiles, dark and light, with a joint one texel wide.
    let tiles = glb.texture(&png(64, false, |x, y| {
        let (i, j) = (x / 16, y / 16);
        if x % 16 == 0 || y % 16 == 0 {
            return texel([118.0, 112.0, 104.0], 1.0);
        }
        let tint = if (i + j) % 2 == 0 { [196.0, 184.0, 166.0] } else { [142.0, 122.0, 106.0] };
        texel(tint, 0.92 + 0.1 * noise(i + 7, j + 3) + 0.04 * noise(x + 99, y))
    }));
    // Four courses of blocks in running bond.
    let blocks = glb.texture(&png(64, false, |x, y| {
        let course = y / 16;
        let shifted = (x + 16 * (course % 2)) % 64;
        if y % 16 == 0 || shifted % 32 == 0 {
            return texel([186.0, 176.0, 160.0], 1.0);
        }
        texel([212.0, 203.0, 186.0], 0.95 + 0.06 * noise(shifted / 32, course) + 0.03 * noise(x, y + 500))
    }));
    let mut matte = |name: &str, albedo: [f32; 3]| glb.material(&Material::matte(name, albedo));
    let stone = matte("stone", [0.58, 0.54, 0.47]);
    let wood = matte("wood", [0.3, 0.19, 0.11]);
    let iron = matte("iron", [0.2, 0.2, 0.21]);
    // Next to a lamp even grey metal would outshine the room, and rays find it by chance only.
    let soot = matte("black iron", [0.04; 3]);
    let velvet = matte("black velvet", [0.001; 3]);
    let carpet = matte("carpet", [0.5, 0.06, 0.05]);
    let clay = matte("clay", [0.52, 0.26, 0.15]);
    let wax = matte("wax", [0.72, 0.68, 0.58]);
    let mut cloth =
        |name: &str, albedo: [f32; 3]| glb.material(&Material::matte(name, albedo).double_sided());
    let blue = cloth("blue cloth", [0.07, 0.13, 0.45]);
    let ochre = cloth("ochre cloth", [0.6, 0.36, 0.08]);
    let linen = cloth("linen", [0.7, 0.66, 0.58]);
    let warm = Vec3::from(WARM);
    Materials {
        plaster: glb.material(&Material::matte("blocks", Vec3::ONE).textured(blocks)),
        floor: glb.material(&Material::matte("tiles", Vec3::ONE).textured(tiles)),
        flame: glb.material(&Material::matte("flame", [0.5; 3]).emitting(warm * 9000.0)),
        bulb: glb.material(&Material::matte("bulb", [0.5; 3]).emitting(warm * 2500.0)),
        stone,
        wood,
        iron,
        soot,
        velvet,
        carpet,
        blue,
        ochre,
        linen,
        clay,
        wax,
    }
}

fn place(glb: &mut Glb, name: &str, shape: &Shape, material: Id) {
    let mesh = glb.mesh(name, &[(shape, material)]);
    glb.node(Node::new(name).mesh(mesh));
}

/// Walls, floor and the outer shell of hall and side room.
fn shell(glb: &mut Glb, m: &Materials) {
    let window = |x: [f32; 2], centre: f32| ArchedWall {
        x,
        y: [0.0, 5.0],
        opening: [centre - 0.65, centre + 0.65],
        sill: 1.4,
        spring: 2.9,
        thickness: 0.3,
        pieces: 14,
    };
    let (mut inside, mut outside) = (Shape::default(), Shape::default());
    for pair in COLUMNS.windows(2) {
        let [front, back] = window([pair[0], pair[1]], 0.5 * (pair[0] + pair[1])).shapes();
        inside.append(&front);
        outside.append(&back);
    }
    for (x0, x1) in [(-6.0, -4.0), (4.0, 6.0)] {
        let at = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
        inside.quad([at(x0, 0.0, 0.0), at(x1, 0.0, 0.0), at(x1, 5.0, 0.0), at(x0, 5.0, 0.0)]);
        outside.quad([at(x1, 0.0, -0.3), at(x0, 0.0, -0.3), at(x0, 5.0, -0.3), at(x1, 5.0, -0.3)]);
    }
    place(glb, "wall north", &inside.moved([0.0, 0.0, -4.0]).planar_uvs(2.0), m.plaster);
    let mut shell = outside.moved([0.0, 0.0, -4.0]);

    let door = ArchedWall {
        x: [-4.0, 4.0],
        y: [0.0, 5.0],
        opening: [-1.95, -0.75],
        sill: 0.0,
        spring: 1.9,
        thickness: 0.3,
        pieces: 14,
    };
    let east = Affine3A::from_translation(Vec3::new(6.0, 0.0, 0.0))
        * Affine3A::from_quat(Quat::from_rotation_y(-std::f32::consts::FRAC_PI_2));
    let [front, _] = door.shapes();
    place(glb, "wall east", &front.transformed(east).planar_uvs(2.0), m.plaster);
    // Only what the side room shows of the back gets texels.
    let [_, back] = ArchedWall { x: [-3.2, 1.2], y: [0.0, 3.0], ..door }.shapes();
    place(glb, "wall east, back", &back.transformed(east).planar_uvs(2.0), m.plaster);
    for (z0, z1, y0) in [(-4.0, -3.2, 0.0), (1.2, 4.0, 0.0), (-3.2, 1.2, 3.0)] {
        let at = |y: f32, z: f32| Vec3::new(6.3, y, z);
        shell.quad([at(y0, z1), at(y0, z0), at(5.0, z0), at(5.0, z1)]);
    }

    // The other two walls have no openings: the inside of a box without its other sides.
    let sides = [true, false, false, false, false, true];
    let mut plain = Shape::default();
    plain.cuboid([-6.0, 0.0, -4.0], [6.0, 5.0, 4.0], sides);
    place(glb, "walls west and south", &plain.inside_out().planar_uvs(2.0), m.plaster);
    shell.cuboid([-6.3, 0.0, -4.0], [6.0, 5.0, 4.3], sides);
    // Corner posts close the shell where two walls meet.
    shell.cuboid([-6.3, 0.0, -4.3], [-6.0, 5.0, -4.0], [true, false, false, false, true, false]);
    shell.cuboid([6.0, 0.0, -4.3], [6.3, 5.0, -4.0], [false, true, false, false, true, false]);
    shell.cuboid([6.0, 0.0, 4.0], [6.3, 5.0, 4.3], [false, true, false, false, false, true]);
    shell.cuboid([-6.3, 5.0, -4.3], [6.3, 5.3, 4.3], NO_BOTTOM);
    shell.cuboid([-6.3, -0.3, -4.3], [6.3, 0.0, 4.3], NO_TOP);
    shell.cuboid([6.3, -0.3, -3.5], [10.1, 3.3, 1.5], [false, true, true, true, true, true]);
    let mesh = glb.mesh("outer shell", &[(&shell, m.stone)]);
    glb.node(Node::new("outer shell").mesh(mesh).extras(json!({"lightmap": "off"})));

    let mut floor = Shape::default();
    for (x, z) in [([-6.0, 6.0], [-4.0, 4.0]), ([6.0, 6.3], [-1.95, -0.75]), ([6.3, 9.8], [-3.2, 1.2])] {
        let at = |x: f32, z: f32| Vec3::new(x, 0.0, z);
        floor.quad([at(x[0], z[1]), at(x[1], z[1]), at(x[1], z[0]), at(x[0], z[0])]);
    }
    place(glb, "floor", &floor.planar_uvs(2.0), m.floor);
}

/// Two rows of four columns and the arcades they carry.
fn columns(glb: &mut Glb, m: &Materials) {
    let mut column = Shape::default();
    column.cuboid([-0.34, -0.02, -0.34], [0.34, 0.12, 0.34], NO_BOTTOM);
    column.cuboid([-0.33, 3.07, -0.33], [0.33, 3.21, 0.33], ALL);
    let ring = |centre: Vec2, radius: f32, points: u8| -> Vec<Vec2> {
        (0..=points)
            .map(|i| {
                let (sin, cos) = sin_cos(0.5 * f64::from(i) / f64::from(points) - 0.25);
                centre + radius * Vec2::new(cos, sin)
            })
            .collect()
    };
    column.lathe(&ring(Vec2::new(0.255, 0.18), 0.07, 6), 20);
    column
        .lathe(&[[0.235, 0.22], [0.24, 0.9], [0.235, 1.6], [0.222, 2.3], [0.205, 2.86]].map(Vec2::from), 20);
    column.lathe(&ring(Vec2::new(0.2, 2.82), 0.035, 4), 20);
    column.lathe(&[[0.205, 2.85], [0.212, 2.93], [0.245, 3.01], [0.315, 3.09]].map(Vec2::from), 20);
    let mesh = glb.mesh("column", &[(&column, m.stone)]);
    for (row, z) in [("north", -ROW), ("south", ROW)] {
        for (i, x) in COLUMNS.into_iter().enumerate() {
            glb.node(Node::new(&format!("column {row} {}", i + 1)).mesh(mesh).at([x, 0.0, z]));
        }
    }

    // Where a bay meets a column the arch stands on its capital; at the end walls it starts at the wall.
    let mut arcade = Shape::default();
    let ends = [-6.0, COLUMNS[0], COLUMNS[1], COLUMNS[2], COLUMNS[3], 6.0];
    for (i, pair) in ends.windows(2).enumerate() {
        let [a, b] = [pair[0], pair[1]];
        let l = if i == 0 { a } else { a + 0.25 };
        let r = if i == 4 { b } else { b - 0.25 };
        let bay = ArchedWall {
            x: [a, b],
            y: [SPRING, 5.0],
            opening: [l, r],
            sill: SPRING,
            spring: SPRING,
            thickness: 0.4,
            pieces: 14,
        };
        let [front, back] = bay.shapes();
        arcade.append(&front);
        arcade.append(&back);
    }
    for (name, z) in [("arcade north", -ROW), ("arcade south", ROW)] {
        place(glb, name, &arcade.clone().moved([0.0, 0.0, z + 0.2]).planar_uvs(2.0), m.plaster);
    }
}

/// A flat ceiling with beams over the columns.
fn ceiling(glb: &mut Glb, m: &Materials) {
    let mut ceiling = Shape::default();
    ceiling.cuboid([-6.0, 0.0, -4.0], [6.0, 5.0, 4.0], [false, false, false, true, false, false]);
    place(glb, "ceiling", &ceiling.inside_out().planar_uvs(2.0), m.wood);
    let mut beams = Shape::default();
    for x in [-5.3, -4.0, -8.0 / 3.0, -4.0 / 3.0, 0.0, 4.0 / 3.0, 8.0 / 3.0, 4.0, 5.3] {
        for (z0, z1) in [(-4.0, -2.4), (-2.0, 2.0), (2.4, 4.0)] {
            let sides = [true, true, true, false, false, false];
            beams.cuboid([x - 0.1, 4.72, z0], [x + 0.1, 5.0, z1], sides);
        }
    }
    place(glb, "beams", &beams, m.wood);
}

/// Bars in the window openings.
fn windows(glb: &mut Glb, m: &Materials) {
    let mut bars = Shape::default();
    for pair in COLUMNS.windows(2) {
        let x = 0.5 * (pair[0] + pair[1]);
        bars.cuboid(
            [x - 0.025, 1.39, -4.2],
            [x + 0.025, 3.56, -4.15],
            [true, true, false, false, true, true],
        );
        for y in [1.9, 2.4, 2.9] {
            for (x0, x1) in [(x - 0.66, x - 0.025), (x + 0.025, x + 0.66)] {
                bars.cuboid(
                    [x0, y - 0.02, -4.195],
                    [x1, y + 0.02, -4.155],
                    [false, false, true, true, true, true],
                );
            }
        }
    }
    place(glb, "window bars", &bars, m.iron);
}

fn table(width: f32, depth: f32, height: f32, leg: f32) -> Shape {
    let (x, z) = (0.5 * width, 0.5 * depth);
    let mut s = Shape::default();
    s.cuboid([-x, height - 0.06, -z], [x, height, z], ALL);
    for (sx, sz) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let (cx, cz) = (sx * (x - leg), sz * (z - leg));
        let half = 0.5 * leg;
        let sides = [true, true, false, false, true, true];
        s.cuboid([cx - half, -0.01, cz - half], [cx + half, height - 0.05, cz + half], sides);
    }
    s
}

/// What stands in the hall.
fn furniture(glb: &mut Glb, m: &Materials) {
    let mut carpet = Shape::default();
    carpet.cuboid([-4.7, -0.01, -0.75], [4.1, 0.015, 0.75], NO_BOTTOM);
    place(glb, "carpet", &carpet, m.carpet);

    let mut dais = Shape::default();
    dais.cuboid([4.3, -0.02, 0.0], [6.0, 0.16, 1.8], [true, false, false, true, true, true]);
    dais.cuboid([4.65, 0.14, 0.3], [6.0, 0.32, 1.5], [true, false, false, true, true, true]);
    place(glb, "dais", &dais, m.stone);
    let mut altar = Shape::default();
    altar.cuboid([5.05, 0.3, 0.5], [5.55, 1.2, 1.3], [true, true, false, false, true, true]);
    altar.cuboid([4.95, 1.18, 0.4], [5.65, 1.3, 1.4], ALL);
    place(glb, "altar", &altar, m.stone);

    let bench = table(1.7, 0.38, 0.45, 0.08);
    let mesh = glb.mesh("bench", &[(&bench, m.wood)]);
    for (i, (x, z, turn)) in [(-2.7, -1.45, 0.02), (2.7, -1.5, 0.0), (2.75, 1.5, 0.0)].into_iter().enumerate()
    {
        let node = Node::new(&format!("bench {}", i + 1)).mesh(mesh);
        glb.node(node.at([x, 0.0, z]).turned(Quat::from_rotation_y(turn)));
    }
    let mesh = glb.mesh("table", &[(&table(1.5, 0.75, 0.78, 0.1), m.wood)]);
    let at = Vec3::new(-0.9, 0.0, 1.55);
    glb.node(Node::new("table").mesh(mesh).at(at).turned(Quat::from_rotation_y(0.08)));
    let mut jug = Shape::default();
    let profile = [[0.0, 0.0], [0.07, 0.0]].map(Vec2::from);
    jug.lathe(&profile, 16);
    let body =
        [[0.07, 0.0], [0.1, 0.06], [0.11, 0.12], [0.09, 0.19], [0.05, 0.24], [0.045, 0.28], [0.06, 0.32]];
    jug.lathe(&body.map(Vec2::from), 16);
    let lining = [[0.06, 0.32], [0.035, 0.28], [0.04, 0.23], [0.0, 0.2]];
    jug.lathe(&lining.map(Vec2::from), 16);
    let mesh = glb.mesh("jug", &[(&jug, m.clay)]);
    glb.node(Node::new("jug").mesh(mesh).at(at + Vec3::new(0.3, 0.775, 0.05)));
    glb.node(Node::new("jug on the floor").mesh(mesh).at([-3.35, 0.0, -2.75]).scaled([1.7; 3]));
}

/// A hanging sheet with folds: `width` along X, from `bottom` to `top`, folds `depth` deep.
fn sheet(width: f32, bottom: f32, top: f32, depth: f32, folds: f32) -> Shape {
    let (n, rows) = (24u8, 6u8);
    let mut s = Shape::default();
    s.grid(Vec3::ZERO, Vec3::X, Vec3::Y, n.into(), rows.into());
    for (p, normal) in s.positions.iter_mut().zip(&mut s.normals) {
        let (u, v) = (p.x, p.y);
        // Folds are flat at the rod and deepest at the hem.
        let fall = depth * (1.0 - 0.6 * v);
        let (sin, cos) = sin_cos(f64::from(folds * u));
        *p = Vec3::new((u - 0.5) * width, bottom + v * (top - bottom), fall * sin);
        let slope = Vec2::new(
            fall * cos * std::f32::consts::TAU * folds / width,
            -0.6 * depth * sin / (top - bottom),
        );
        *normal = Vec3::new(-slope.x, -slope.y, 1.0).normalize();
    }
    s
}

/// Banners over the altar and in the southern arcade, and a curtain at the last window.
fn cloth(glb: &mut Glb, m: &Materials) {
    let mesh = glb.mesh("banner", &[(&sheet(1.0, 1.75, 4.3, 0.05, 2.5), m.blue)]);
    let east = Quat::from_rotation_y(-std::f32::consts::FRAC_PI_2);
    glb.node(Node::new("banner east").mesh(mesh).at([5.9, 0.0, 0.9]).turned(east));
    let mesh = glb.mesh("banner", &[(&sheet(0.95, 1.5, 4.05, 0.05, 2.5), m.ochre)]);
    glb.node(Node::new("banner south").mesh(mesh).at([8.0 / 3.0, 0.0, ROW]));
    let mesh = glb.mesh("curtain", &[(&sheet(0.6, 0.9, 3.6, 0.06, 4.0), m.linen)]);
    glb.node(Node::new("curtain").mesh(mesh).at([8.0 / 3.0 + 0.55, 0.0, -3.86]));
}

/// The room behind the door: no lamp of its own.
fn side_room(glb: &mut Glb, m: &Materials) {
    let mut room = Shape::default();
    room.cuboid([6.3, 0.0, -3.2], [9.8, 3.0, 1.2], [false, true, false, true, true, true]);
    place(glb, "side room", &room.inside_out().planar_uvs(2.0), m.plaster);

    let mut crate_box = Shape::default();
    crate_box.cuboid([-0.4, -0.01, -0.4], [0.4, 0.8, 0.4], NO_BOTTOM);
    let mesh = glb.mesh("crate", &[(&crate_box, m.wood)]);
    for (i, (at, size, turn)) in
        [([8.6, 0.0, -1.5], 1.0, 0.3), ([9.2, 0.0, -0.4], 1.1, -0.1), ([8.62, 0.79, -1.45], 0.7, -0.25)]
            .into_iter()
            .enumerate()
    {
        let node = Node::new(&format!("crate {}", i + 1)).mesh(mesh);
        glb.node(node.at(at).turned(Quat::from_rotation_y(turn)).scaled([size; 3]));
    }
    let mut barrel = Shape::default();
    barrel.lathe(&[[0.26, -0.01], [0.33, 0.22], [0.35, 0.45], [0.33, 0.68], [0.26, 0.9]].map(Vec2::from), 20);
    barrel.lathe(&[[0.26, 0.9], [0.24, 0.9]].map(Vec2::from), 20);
    barrel.lathe(&[[0.24, 0.9], [0.24, 0.86]].map(Vec2::from), 20);
    barrel.lathe(&[[0.24, 0.86], [0.0, 0.86]].map(Vec2::from), 20);
    let mesh = glb.mesh("barrel", &[(&barrel, m.wood)]);
    glb.node(Node::new("barrel 1").mesh(mesh).at([7.4, 0.0, -2.7]));
    glb.node(Node::new("barrel 2").mesh(mesh).at([8.2, 0.0, -2.75]));

    let mut shelf = Shape::default();
    for z in [-1.2, 0.35] {
        shelf.cuboid([9.45, -0.01, z], [9.8, 1.9, z + 0.05], [true, false, false, true, true, true]);
    }
    for y in [1.1, 1.85] {
        shelf.cuboid([9.46, y - 0.04, -1.16], [9.8, y, 0.36], [true, false, true, true, false, false]);
    }
    place(glb, "shelf", &shelf, m.wood);
}

/// A hanging lantern, two candles, two shaded lamps and the sun.
fn lamps(glb: &mut Glb, m: &Materials) {
    let at = Vec3::new(3.3, 2.75, 0.0);
    let mut cage = Shape::default();
    cage.lathe(&[[0.2, 0.2], [0.02, 0.36]].map(Vec2::from), 12);
    // A profile that runs outwards faces down, one that runs inwards up.
    cage.lathe(&[[0.0, 0.2], [0.2, 0.2]].map(Vec2::from), 12);
    cage.lathe(&[[0.0, -0.22], [0.16, -0.22]].map(Vec2::from), 12);
    cage.lathe(&[[0.16, -0.22], [0.16, -0.2]].map(Vec2::from), 12);
    cage.lathe(&[[0.16, -0.2], [0.0, -0.2]].map(Vec2::from), 12);
    for (x, z) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
        let (x, z) = (0.1 * x, 0.1 * z);
        let sides = [true, true, false, false, true, true];
        cage.cuboid([x - 0.008, -0.21, z - 0.008], [x + 0.008, 0.21, z + 0.008], sides);
    }
    cage.cuboid([-0.01, 0.34, -0.01], [0.01, 1.98, 0.01], [true, true, false, false, true, true]);
    cage.cuboid([-0.1, 1.96, -0.1], [0.1, 2.01, 0.1], NO_TOP);
    let mesh = glb.mesh("lantern", &[(&cage, m.soot)]);
    glb.node(Node::new("lantern").mesh(mesh).at(at));
    // The bulb is what one sees; the light inside it is what lights the hall.
    let mut bulb = Shape::default();
    bulb.icosphere(0.06, 2, false);
    let mesh = glb.mesh("lantern bulb", &[(&bulb, m.bulb)]);
    let unseen = json!({"lightmap": "off", "casts_shadow": false});
    glb.node(Node::new("lantern bulb").mesh(mesh).at(at).extras(unseen));
    let light = glb.light("lantern light", Kind::Point, WARM, 260.0);
    let mut node = Node::new("lantern light").at(at);
    node.light = Some(light);
    glb.node(node);

    let mut candle = Shape::default();
    candle.lathe(&[[0.028, -0.01], [0.028, 0.24]].map(Vec2::from), 10);
    candle.lathe(&[[0.028, 0.24], [0.0, 0.24]].map(Vec2::from), 10);
    let mut flame = Shape::default();
    flame.icosphere(0.03, 1, false);
    let flame = flame.moved([0.0, 0.28, 0.0]);
    let mesh = glb.mesh("candle", &[(&candle, m.wax), (&flame, m.flame)]);
    for (i, z) in [0.62, 1.18].into_iter().enumerate() {
        glb.node(Node::new(&format!("candle {}", i + 1)).mesh(mesh).at([5.3, 1.3, z]));
    }

    shaded_lamps(glb, m);

    let sun = glb.light("sun", Kind::Directional, [1.0, 0.72, 0.45], 200.0);
    let node = Node::new("sun").at([0.0, 12.0, -15.0]).turned(looking(Vec3::new(0.28, -0.62, 0.85)));
    let mut node = node.extras(json!({"angular_diameter": 0.53}));
    node.light = Some(sun);
    glb.node(node);
}

/// Lamps on stands in the southern aisle that shine out of deep bowls at black plates under the ceiling: what they light
/// reflects next to nothing, so their light reaches walls by way of the haze alone.
fn shaded_lamps(glb: &mut Glb, m: &Materials) {
    let mut stand = Shape::default();
    stand.lathe(&[[0.17, -0.01], [0.16, 0.03], [0.02, 0.06], [0.015, 1.38]].map(Vec2::from), 10);
    stand.lathe(&[[0.015, 1.38], [0.08, 1.42], [0.13, 1.55], [0.14, 1.72]].map(Vec2::from), 14);
    stand.lathe(&[[0.14, 1.72], [0.13, 1.72]].map(Vec2::from), 14);
    stand.lathe(&[[0.13, 1.72], [0.12, 1.56], [0.07, 1.44], [0.0, 1.44]].map(Vec2::from), 14);
    let mut plate = Shape::default();
    plate.lathe(&[[0.0, 4.68], [0.85, 4.68]].map(Vec2::from), 20);
    plate.lathe(&[[0.85, 4.68], [0.85, 4.7]].map(Vec2::from), 20);
    plate.lathe(&[[0.85, 4.7], [0.0, 4.7]].map(Vec2::from), 20);
    let mesh = glb.mesh("shaded lamp", &[(&stand, m.soot), (&plate, m.velvet)]);
    let light = glb.light("shaded light", Kind::Spot { inner: 0.17, outer: 0.26 }, WARM, 25_000.0);
    for (i, x) in [0.0, 3.4].into_iter().enumerate() {
        let name = format!("shaded lamp {}", i + 1);
        // The plate would be by far the brightest thing of the map.
        let node = Node::new(&name).mesh(mesh).at([x, 0.0, 3.1]);
        glb.node(node.extras(json!({"lightmap": "off"})));
        let up = Node::new(&format!("{name} light")).at([x, 1.6, 3.1]).turned(looking(Vec3::Y));
        glb.node(Node { light: Some(light), ..up });
    }
}
