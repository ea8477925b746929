//! A fireball in its own smoke, and the room that it lights.

use crate::gltf::{Glb, Material, Node};
use crate::shape::{ALL, Shape};
use glam::Vec3;
use std::path::Path;

/// Grids of one frame, x fastest, then y, then z.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Voxels along each axis.
    pub size: u32,
    /// How dense the smoke is, up to about 1.
    pub smoke: Vec<f32>,
    /// How bright the fire is, up to 1.
    pub heat: Vec<f32>,
}

fn hash(x: i32, y: i32, z: i32, seed: u32) -> f32 {
    let mut h = seed.wrapping_mul(0x9e37_79b9);
    for v in [x, y, z] {
        h = (h ^ v.cast_unsigned()).wrapping_mul(0x85eb_ca6b);
        h ^= h >> 13;
    }
    h = h.wrapping_mul(0xc2b2_ae35);
    ((h ^ (h >> 16)) >> 8) as f32 / 16_777_216.0
}

/// Smooth noise between 0 and 1, with features as large as 1.
fn noise(p: Vec3, seed: u32) -> f32 {
    let (low, t) = (p.floor().as_ivec3(), p - p.floor());
    let t = t * t * (3.0 - 2.0 * t);
    let corner = |dx, dy, dz| hash(low.x + dx, low.y + dy, low.z + dz, seed);
    let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let along = |dy, dz| lerp(corner(0, dy, dz), corner(1, dy, dz), t.x);
    lerp(lerp(along(0, 0), along(1, 0), t.y), lerp(along(0, 1), along(1, 1), t.y), t.z)
}

/// Octaves of it.
fn clouds(p: Vec3, seed: u32) -> f32 {
    (0..4u8)
        .map(|k| noise(p * 2f32.powi(i32::from(k)), seed + u32::from(k)) * 0.5f32.powi(i32::from(k) + 1))
        .sum()
}

/// How the gas moves: out of the middle, upwards, and in eddies, which have no sources.
fn velocity(p: Vec3, t: f32) -> Vec3 {
    const STEP: f32 = 0.02;
    let potential = |p: Vec3| {
        let q = p * 5.0 - Vec3::Y * t;
        Vec3::new(clouds(q, 11), clouds(q, 23), clouds(q, 37))
    };
    let d = |axis: Vec3| (potential(p + axis * STEP) - potential(p - axis * STEP)) / (2.0 * STEP);
    let (dx, dy, dz) = (d(Vec3::X), d(Vec3::Y), d(Vec3::Z));
    let eddies = Vec3::new(dy.z - dz.y, dz.x - dx.z, dx.y - dy.x);
    let out = p - Vec3::new(0.5, 0.4, 0.5);
    eddies * 0.06 + out * (0.9 / (1.0 + 3.0 * t)) + Vec3::Y * 0.12
}

/// The fireball at a time from 0 to 1: smoke and fire of the first moment, carried along by the gas.
#[must_use]
pub fn explosion(size: u32, time: f32) -> Frame {
    const STEPS: u8 = 8;
    let n = size.pow(3);
    let (mut smoke, mut heat) = (Vec::with_capacity(n as usize), Vec::with_capacity(n as usize));
    for i in 0..n {
        let cell = Vec3::new((i % size) as f32, (i / size % size) as f32, (i / (size * size)) as f32);
        let mut p = (cell + 0.5) / size as f32;
        let dt = time / f32::from(STEPS);
        for k in 0..STEPS {
            p -= velocity(p, time - dt * f32::from(k)) * dt;
        }
        let r = p.distance(Vec3::new(0.5, 0.4, 0.5)) / 0.2 - 0.5 * (clouds(p * 8.0, 5) - 0.5);
        let ball = (4.0 * (1.0 - r)).clamp(0.0, 1.0);
        let texture = clouds(p * 14.0, 71);
        smoke.push(ball * (2.0 * texture - 0.35).clamp(0.0, 1.0));
        // The middle is hot, and cools from outside in patches.
        let core = (1.6 * (1.0 - r) - 1.2 * time * texture).clamp(0.0, 1.0);
        heat.push(core * core * (2.0 * clouds(p * 10.0, 93) - 0.5).clamp(0.0, 1.0));
    }
    Frame { size, smoke, heat }
}

impl Frame {
    /// Writes both grids, as those of a frame of a sequence where it has a number, and returns the configuration that fills a box with them. `strength` in nits per metre,
    /// `sigma` per metre.
    ///
    /// # Panics
    /// If the folder cannot be written.
    #[must_use]
    pub fn write(&self, folder: &Path, (strength, sigma): (f32, f32), number: Option<u32>) -> String {
        let bytes = |list: &[f32]| list.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
        let part = number.map(|n| format!(".{n:04}")).unwrap_or_default();
        std::fs::write(folder.join(format!("smoke{part}.raw")), bytes(&self.smoke)).expect("a file");
        std::fs::write(folder.join(format!("heat{part}.raw")), bytes(&self.heat)).expect("a file");
        let part = if number.is_some() { ".####" } else { "" };
        let n = self.size;
        let grid = |file: &str| format!("raw = \"{file}\", size = [{n}, {n}, {n}], format = \"f32\"");
        format!(
            "[[media]]\nname = \"explosion\"\nsigma_s = {sigma}\nsigma_a = {sigma}\ndensity = {{ {} }}\n\
             emission = {{ color = [1, 0.45, 0.12], strength = {strength}, {} }}\n\
             box = {{ min = [-1.5, 0.3, -1.5], max = [1.5, 3.3, 1.5] }}\n",
            grid(&format!("smoke{part}.raw")),
            grid(&format!("heat{part}.raw"))
        )
    }
}

/// A room of 6 x 4 x 6 m with two blocks and a shelf, without any light.
#[must_use]
pub fn dark_room() -> Vec<u8> {
    let mut glb = Glb::new();
    let wall = glb.material(&Material::matte("wall", [0.6, 0.58, 0.55]));
    let wood = glb.material(&Material::matte("wood", [0.4, 0.3, 0.22]));
    let mut s = Shape::default();
    s.cuboid([-3.0, 0.0, -3.0], [3.0, 4.0, 3.0], ALL);
    let mesh = glb.mesh("room", &[(&s.inside_out(), wall)]);
    glb.node(Node::new("room").mesh(mesh));
    let mut s = Shape::default();
    s.cuboid([-2.6, 0.0, -1.0], [-1.8, 1.2, -0.2], ALL);
    s.cuboid([1.7, 0.0, 0.9], [2.5, 0.7, 2.3], ALL);
    s.cuboid([-0.8, 1.9, -3.0], [1.4, 2.0, -2.4], ALL);
    let mesh = glb.mesh("blocks", &[(&s, wood)]);
    glb.node(Node::new("blocks").mesh(mesh));
    glb.camera("view", Vec3::new(2.6, 1.7, 2.7), Vec3::new(-0.6, 1.4, -0.8), 1.1);
    glb.finish()
}
