//! A market hall with as many coloured lamps and glowing triangles as one asks for.
//!
//! The closed hall is 60 x 30 x 7 m with the origin in the middle of its floor and ten bays along X. Stalls stand along
//! both long walls and back to back in the middle; over the northern ones runs a gallery. Walls face inwards and have no
//! outer shell. However many lamps and triangles there are, they share the same candela and lumen.

use std::f32::consts::PI;

use glam::{Vec2, Vec3};
use serde_json::json;

use crate::{
    gltf::{Glb, Id, Kind, Material, Node, looking},
    shape::{NO_BOTTOM, Shape, sin_cos},
};

/// Sum over all lamps, candela of the largest channel.
const CANDELA: f32 = 70_000.0;
/// Sum over all glowing triangles, lumen of the largest channel.
const LUMEN: f32 = 300_000.0;

/// From the middle of the hall to its walls along X and Z, and its height, metres.
const HALL: Vec3 = Vec3::new(30.0, 7.0, 15.0);
/// Edge of the gallery along Z, its underside and its floor, metres.
const GALLERY: [f32; 3] = [-9.0, 3.1, 3.3];
/// Distance between partitions, metres.
const BAY: f32 = 6.0;
/// Height of partitions and half of their thickness, metres.
const PARTITION: [f32; 2] = [2.2, 0.05];
/// Rows of stalls: back and front along Z, metres, and how many bays they leave free at each end.
const ROWS: [(f32, f32, u8); 4] =
    [(-15.0, -11.0, 0), (-PARTITION[1], -3.0, 1), (PARTITION[1], 3.0, 1), (15.0, 11.0, 0)];
/// Where rows of columns stand along Z; those of the first row carry the gallery.
const COLUMNS: [f32; 3] = [-9.4, -5.5, 5.5];
/// Radius of columns, metres.
const COLUMN: f32 = 0.22;
/// Where lamps hang under the ceiling along Z.
const STRINGS: [f32; 7] = [-12.5, -7.5, -3.8, 0.0, 3.8, 8.5, 12.5];
/// Luminances of glowing things, relative.
const LEVELS: [f32; 3] = [0.3, 1.0, 3.0];
/// Triangles of a neon tube: six sides and two lids.
const TUBE: usize = 24;

/// The scene's bytes. Two lamps of three are points, the others spots; nine triangles of ten belong to neon tubes, the
/// others to small panels.
#[must_use]
pub fn lamps(lamps: usize, triangles: usize) -> Vec<u8> {
    let mut glb = Glb::new();
    let stalls = stalls();
    for (name, shape, albedo) in building(&stalls) {
        let material = glb.material(&Material::matte(name, albedo));
        let mesh = glb.mesh(name, &[(&shape, material)]);
        glb.node(Node::new(name).mesh(mesh));
    }
    hang(&mut glb, &bulbs(&stalls, lamps));
    glow(&mut glb, &glowing(&stalls, triangles));
    glb.camera("camera", Vec3::new(-29.3, 1.7, -7.3), Vec3::new(0.0, 1.9, -6.0), 60f32.to_radians());
    glb.scene_extra("texels_per_metre", json!(4));
    glb.finish()
}

/// Space between two partitions; it is open towards an aisle.
struct Stall {
    /// Faces of the partitions along X, metres.
    x: [f32; 2],
    /// Face of the wall behind along Z.
    back: f32,
    /// Where the aisle begins.
    front: f32,
}

impl Stall {
    /// The sign of Z from the back to the aisle.
    fn out(&self) -> f32 {
        (self.front - self.back).signum()
    }

    /// A place `along` the stall (0 to 1, at least `margin` metres off the partitions), `inside` metres behind its front.
    fn place(&self, along: f32, margin: f32, y: f32, inside: f32) -> Vec3 {
        let x = self.x[0] + margin + along * (self.x[1] - self.x[0] - 2.0 * margin);
        Vec3::new(x, y, self.front - inside * self.out())
    }
}

fn stalls() -> Vec<Stall> {
    let row = |(back, front, free): (f32, f32, u8)| {
        (free..10 - free).map(move |i| {
            let x = BAY * f32::from(i) - HALL.x;
            Stall { x: [x + PARTITION[1], x + BAY - PARTITION[1]], back, front }
        })
    };
    ROWS.into_iter().flat_map(row).collect()
}

/// Number of the stall whose middle is nearest to `at`, seen from above.
fn nearest(stalls: &[Stall], at: Vec3) -> usize {
    let distance = |s: &Stall| (s.place(0.5, 0.0, at.y, 0.0) - at).length_squared();
    (0..stalls.len()).min_by(|&a, &b| distance(&stalls[a]).total_cmp(&distance(&stalls[b]))).unwrap_or(0)
}

/// A reproducible number in [0, 1) for thing number `i`; `salt` tells its uses apart.
fn noise(i: usize, salt: u32) -> f32 {
    let i = u32::try_from(i).expect("fewer than 2^32 things");
    let mut h = i.wrapping_mul(0x9E37_79B1) ^ salt.wrapping_mul(0x85EB_CA77);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h = (h ^ (h >> 12)).wrapping_mul(0x297A_2D39);
    f32::from(u16::try_from((h ^ (h >> 15)) >> 16).unwrap_or(0)) / 65536.0
}

/// Spreads `n` things evenly over `places` laid end to end: the place of thing `i`, and how far along it is (0 to 1).
fn spread(i: usize, n: usize, places: usize) -> (usize, f32) {
    let at = (2 * i + 1) * places;
    (at / (2 * n), (at % (2 * n)) as f32 / (2 * n) as f32)
}

/// A saturated colour, largest channel 1; each stall has its hue, from which `shift` leads away (1 is all around).
fn tint(stall: usize, shift: f32, saturation: f32) -> Vec3 {
    let hue = 6.0 * (0.618_034 * stall as f32 + shift);
    let ramp = |from: f32| (((hue + from).rem_euclid(6.0) - 3.0).abs() - 1.0).clamp(0.0, 1.0);
    Vec3::ONE - saturation * (Vec3::ONE - Vec3::new(ramp(0.0), ramp(4.0), ramp(2.0)))
}

/// Everything that does not glow: name, shape, albedo.
fn building(stalls: &[Stall]) -> Vec<(&'static str, Shape, [f32; 3])> {
    let [edge, under, over] = GALLERY;
    let Vec3 { x, y, z } = HALL;
    // No texel is buried in the gallery: walls leave out what it covers.
    let mut walls = Shape::default();
    walls.cuboid([-x, 0.0, -z], [x, under, edge], [true, true, false, false, true, false]);
    walls.cuboid([-x, over, -z], [x, y, edge], [true, true, false, false, true, false]);
    walls.cuboid([-x, 0.0, edge], [x, y, z], [true, true, false, false, false, true]);
    let [mut floor, mut ceiling] = [Shape::default(), Shape::default()];
    floor.cuboid([-x, 0.0, -z], [x, y, z], [false, false, true, false, false, false]);
    ceiling.cuboid([-x, 0.0, -z], [x, y, z], [false, false, false, true, false, false]);

    let mut gallery = Shape::default();
    gallery.cuboid([-x, under, -z], [x, over, edge], [false, false, true, true, false, true]);
    let rail = [false, false, false, true, true, true];
    gallery.cuboid([-x, over - 0.01, edge - 0.15], [x, over + 1.0, edge - 0.05], rail);

    let mut columns = Shape::default();
    for at in feet() {
        let heights: &[[f32; 2]] = if at.z < edge { &[[0.0, under], [over, y]] } else { &[[0.0, y]] };
        for height in heights {
            let mut column = Shape::default();
            column.lathe(&height.map(|y| Vec2::new(COLUMN, y)), 12);
            columns.append(&column.moved(at));
        }
    }

    let [top, half] = PARTITION;
    let mut painted: [Shape; 3] = Default::default();
    for i in 0..9u8 {
        let x = BAY * (f32::from(i) + 1.0) - HALL.x;
        let paint = &mut painted[usize::from(i % 3)];
        for (z0, z1) in [(-15.0, -11.0), (-3.0, 3.0), (11.0, 15.0)] {
            let sides = [true, true, false, true, -z < z0, z1 < z];
            paint.cuboid([x - half, -0.01, z0], [x + half, top, z1], sides);
        }
    }
    let [mut counters, mut spine] = [Shape::default(), Shape::default()];
    for stall in stalls {
        let [a, b] = [stall.place(0.0, 0.95, -0.01, 1.2), stall.place(1.0, 0.95, 0.95, 0.5)];
        counters.cuboid(a.min(b), a.max(b), NO_BOTTOM);
    }
    for [x0, x1] in stalls.iter().filter(|s| s.back == half).map(|s| s.x) {
        spine.cuboid([x0, -0.01, -half], [x1, top, half], [false, false, false, true, true, true]);
    }
    let [red, blue, yellow] = painted;
    vec![
        ("floor", floor.inside_out(), [0.35, 0.32, 0.29]),
        ("ceiling", ceiling.inside_out(), [0.4, 0.42, 0.45]),
        ("walls", walls.inside_out(), [0.66, 0.63, 0.56]),
        ("gallery", gallery, [0.5, 0.47, 0.43]),
        ("columns", columns, [0.55, 0.52, 0.48]),
        ("red partitions", red, [0.6, 0.27, 0.22]),
        ("blue partitions", blue, [0.22, 0.4, 0.6]),
        ("yellow partitions", yellow, [0.68, 0.58, 0.25]),
        ("white partitions", spine, [0.66, 0.63, 0.56]),
        ("counters", counters, [0.45, 0.3, 0.2]),
    ]
}

/// Where columns stand.
fn feet() -> impl Iterator<Item = Vec3> {
    let at = |z: f32| (1..10u8).map(move |i| Vec3::new(BAY * f32::from(i) - HALL.x, 0.0, z));
    COLUMNS.into_iter().flat_map(at)
}

/// One lamp.
struct Bulb {
    at: Vec3,
    /// Direction and outer half angle, radians, of a spot.
    aim: Option<(Vec3, f32)>,
    /// The stall that it takes its hue from.
    stall: usize,
}

/// A third are spots over the counters; of the others half hang under the ceiling and half along the stalls' fronts.
fn bulbs(stalls: &[Stall], lamps: usize) -> Vec<Bulb> {
    let spots = lamps / 3;
    let high = (lamps - spots).div_ceil(2);
    let low = lamps - spots - high;
    let sag = |along: f32| 4.0 * along * (1.0 - along);
    let ceiling = (0..high).map(|i| {
        let (place, along) = spread(i, high, 10 * STRINGS.len());
        let x = BAY * (place % 10) as f32 - HALL.x + 0.2 + along * (BAY - 0.4);
        let at = Vec3::new(x, 6.6 - 0.4 * sag(along), STRINGS[place / 10]);
        Bulb { at, aim: None, stall: nearest(stalls, at) }
    });
    let fronts = (0..low).map(|i| {
        let (stall, along) = spread(i, low, stalls.len());
        let at = stalls[stall].place(along, 0.1, 2.55 - 0.2 * sag(along), -0.1);
        Bulb { at, aim: None, stall }
    });
    let counters = (0..spots).map(|i| {
        let (number, along) = spread(i, spots, stalls.len());
        let stall = &stalls[number];
        let [a, b, c, d] = [0, 1, 2, 3].map(|salt| noise(i, salt));
        let at = stall.place(along, 0.8, 2.4 + 0.4 * c, 0.4 + 0.9 * d);
        // Every other one lights goods on the counter, the rest what hangs behind it.
        let down = Vec3::new(0.5 * (a - 0.5), -1.0, 0.5 * (b - 0.5));
        let back = Vec3::new(1.6 * (a - 0.5), -0.3 - 0.4 * b, -stall.out());
        let aim = if i % 2 == 0 { down } else { back };
        Bulb { at, aim: Some((aim, 0.3 + 0.5 * noise(i, 4))), stall: number }
    });
    ceiling.chain(fronts).chain(counters).collect()
}

/// Adds the lamps; the brightest are a hundred times as bright as the faintest of their kind.
fn hang(glb: &mut Glb, bulbs: &[Bulb]) {
    let weight = |i: usize| {
        let squared = noise(i, 5) * noise(i, 5);
        // A spot's cone holds little of the light that a point would give.
        (0.1 + 9.9 * squared * squared) * if bulbs[i].aim.is_some() { 4.0 } else { 1.0 }
    };
    let sum: f32 = (0..bulbs.len()).map(weight).sum();
    for (i, bulb) in bulbs.iter().enumerate() {
        let name = format!("lamp {}", i + 1);
        let mut node = Node::new(&name).at(bulb.at);
        let mut kind = Kind::Point;
        if let Some((aim, outer)) = bulb.aim {
            kind = Kind::Spot { inner: 0.6 * outer, outer };
            node = node.turned(looking(aim));
        }
        let color = tint(bulb.stall, 0.08 * (noise(i, 6) - 0.5), 0.7 + 0.25 * noise(i, 7));
        node.light = Some(glb.light(&name, kind, color, CANDELA * weight(i) / sum));
        glb.node(node);
    }
}

/// Shapes that glow, by stall and level.
fn glowing(stalls: &[Stall], triangles: usize) -> Vec<[Shape; 3]> {
    let mut groups: Vec<_> = stalls.iter().map(|_| Default::default()).collect();
    let mut add = |stall: usize, dice: f32, shape: &Shape| {
        let group: &mut [Shape; 3] = &mut groups[stall];
        group[usize::from(0.4 < dice) + usize::from(0.85 < dice)].append(shape);
    };
    let tubes = (triangles - triangles / 10) / TUBE;
    // One tube of twelve is on a column.
    let feet: Vec<Vec3> = feet().collect();
    let on_columns = tubes / 12;
    for i in 0..tubes {
        let (at, stall) = if i < on_columns {
            let (column, along) = spread(i, on_columns, feet.len());
            let (sin, cos) = sin_cos(along.into());
            let height = 0.7 + 0.9 * (i % 3) as f32;
            let at = feet[column] + Vec3::new(cos, 0.0, sin) * (COLUMN + 0.04) + Vec3::Y * height;
            (at, nearest(stalls, at))
        } else {
            let (number, along) = spread(i - on_columns, tubes - on_columns, stalls.len());
            (on_walls(&stalls[number], along, if i % 2 == 0 { 0.7 } else { 1.65 }), number)
        };
        let (radius, half) = (0.01 + 0.006 * noise(i, 8), 0.28 + 0.16 * noise(i, 9));
        let mut tube = Shape::default();
        tube.lathe(&[[0.0, -half], [radius, -half], [radius, half], [0.0, half]].map(Vec2::from), 6);
        add(stall, noise(i, 10), &tube.moved(at).flat());
    }
    let rest = triangles - TUBE * tubes;
    let panels = rest.div_ceil(2);
    for i in 0..panels {
        let (number, along) = spread(i, panels, stalls.len());
        let stall = &stalls[number];
        // Four rows on the front of the counter, less than its 4 m wide.
        let size = (10.0 * stalls.len() as f32 / panels as f32).min(0.12);
        let at = stall.place(along, 1.1, 0.2 + 0.2 * (i % 4) as f32, 0.48);
        let (u, v) = (Vec3::X * (0.5 * size * stall.out()), Vec3::Y * (0.5 * size));
        let corners = [at - u - v, at + u - v, at + u + v, at - u + v];
        let odd = i + 1 == panels && rest % 2 == 1;
        let mut panel = Shape::default();
        panel.polygon(if odd { &corners[..3] } else { &corners });
        add(number, noise(i, 11), &panel.flat());
    }
    groups
}

/// Where a tube is on the stall's walls, `along` from the front of one partition over the back to that of the other.
fn on_walls(stall: &Stall, along: f32, y: f32) -> Vec3 {
    let (gap, margin) = (0.04, 0.15);
    let [wide, deep] = [stall.x[1] - stall.x[0], (stall.front - stall.back).abs()].map(|d| d - 2.0 * margin);
    let at = along * (wide + 2.0 * deep);
    let (x, inside) = if at < deep {
        (stall.x[0] + gap, margin + at)
    } else if at < deep + wide {
        (stall.x[0] + margin + at - deep, deep + 2.0 * margin - gap)
    } else {
        (stall.x[1] - gap, margin + 2.0 * deep + wide - at)
    };
    Vec3::new(x, y, stall.front - inside * stall.out())
}

/// Adds what glows, without texels of its own.
fn glow(glb: &mut Glb, groups: &[[Shape; 3]]) {
    let area = |s: &Shape| -> f32 {
        let corners = s.triangles.iter().map(|t| t.map(|i| s.positions[i as usize]));
        corners.map(|[a, b, c]| 0.5 * (b - a).cross(c - a).length()).sum()
    };
    let sum: f32 = groups.iter().flatten().zip(LEVELS.iter().cycle()).map(|(s, level)| level * area(s)).sum();
    for (stall, group) in groups.iter().enumerate() {
        let name = format!("neon {}", stall + 1);
        let lit = group.iter().zip(LEVELS).filter(|(shape, _)| !shape.triangles.is_empty());
        let mut material = |level: f32| {
            let emission = tint(stall, 0.0, 0.9) * (LUMEN / (PI * sum) * level);
            glb.material(&Material::matte(&name, [0.5; 3]).emitting(emission))
        };
        let parts: Vec<(&Shape, Id)> = lit.map(|(shape, level)| (shape, material(level))).collect();
        if !parts.is_empty() {
            let mesh = glb.mesh(&name, &parts);
            glb.node(Node::new(&name).mesh(mesh).extras(json!({"lightmap": "off"})));
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "a test may panic")]
mod tests {
    use super::*;
    use serde_json::Value;

    /// Lights, emissive triangles and candela of a file.
    fn counts(bytes: &[u8]) -> (usize, u64, f64) {
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let root: Value = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        let list = |v: &Value| v.as_array().cloned().unwrap_or_default();
        let light = "KHR_lights_punctual";
        let nodes = list(&root["nodes"]).iter().filter(|n| !n["extensions"][light].is_null()).count();
        let lights = list(&root["extensions"][light]["lights"]);
        assert_eq!(nodes, lights.len());
        let index = |v: &Value| usize::try_from(v.as_u64().unwrap()).unwrap();
        let primitives = list(&root["meshes"]).into_iter().flat_map(|m| list(&m["primitives"]));
        let indices = primitives
            .filter(|p| !root["materials"][index(&p["material"])]["emissiveFactor"].is_null())
            .map(|p| root["accessors"][index(&p["indices"])]["count"].as_u64().unwrap());
        (nodes, indices.sum::<u64>() / 3, lights.iter().map(|l| l["intensity"].as_f64().unwrap()).sum())
    }

    #[test]
    fn there_are_as_many_as_asked_for() {
        for (n, triangles) in [(0, 0), (1, 0), (2, 1), (10, 24), (100, 999), (1000, 10_003), (5000, 50_000)] {
            let (lights, emissive, candela) = counts(&lamps(n, triangles));
            assert_eq!((lights, emissive), (n, triangles as u64));
            let wanted = if n == 0 { 0.0 } else { f64::from(CANDELA) };
            assert!((candela - wanted).abs() < 1e-3 * wanted.max(1.0), "{n}: {candela} cd");
        }
    }

    #[test]
    fn lamps_hang_free() {
        let stalls = stalls();
        let glowing = glowing(&stalls, 20_000).into_iter().flatten();
        let shapes: Vec<Shape> = building(&stalls).into_iter().map(|b| b.1).chain(glowing).collect();
        // Boxes of triangles are enough, since almost all of them are parallel to the axes.
        let boxes: Vec<(Vec3, Vec3)> = shapes
            .iter()
            .flat_map(|s| s.triangles.iter().map(|t| t.map(|i| s.positions[i as usize])))
            .map(|[a, b, c]| (a.min(b).min(c), a.max(b).max(c)))
            .collect();
        for bulb in bulbs(&stalls, 1500) {
            let p = bulb.at;
            assert!(2.3 < p.y, "{p} may be in a counter");
            let near = boxes.iter().map(|(a, b)| (p - p.clamp(*a, *b)).length());
            assert!(0.1 <= near.fold(f32::INFINITY, f32::min), "{p}");
        }
    }
}
