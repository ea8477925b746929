//! Scenes and rays to measure with.

use bake::error::Severity;
use bake::geom::{Ray, World};
use bake::light::Direct;
use bake::plan::{MediaMode, Tracing};
use bake::sample::{Sequence, sequence::key};
use bake::scene::config::Config;
use bake::scene::document::Document;
use bake::scene::gltf::{self, LightUnits, LoadOptions};
use bake::scene::model::{LightmapMode, Material, Mesh, Scene, Surface};
use glam::{Affine3A, Quat, Vec3, Vec3A};
use std::path::Path;

/// Places the triangles of a file.
pub(crate) fn load(path: &Path) -> anyhow::Result<Tracing> {
    let document = Document::open(path)?;
    let options = LoadOptions { light_units: LightUnits::Gltf, ..LoadOptions::default() };
    let (scene, findings) = gltf::load(&document, &Config::default(), &options);
    if let Some(f) = findings.iter().find(|f| f.severity == Severity::Error) {
        anyhow::bail!("{f:?}");
    }
    Ok(Tracing::new(&scene, MediaMode::Off, Direct::Auto)?)
}

/// 64 rough stones of 16,384 triangles each in a box: a million.
pub(crate) fn stones() -> anyhow::Result<Tracing> {
    let mut scene =
        Scene { meshes: vec![stone(), wall()], materials: vec![Material::default()], ..Scene::default() };
    let mut add = |mesh, world_from_mesh| {
        scene.surfaces.push(Surface {
            path: String::new(),
            node: 0,
            gpu_instance: None,
            mesh,
            material: 0,
            world_from_mesh,
            lightmap: LightmapMode::On,
            casts_shadow: true,
            texels_per_metre: None,
        });
    };
    for i in 0..64u16 {
        let at = Vec3::new(f32::from(i % 4), f32::from(i / 4 % 4), f32::from(i / 16)) * 2.3;
        let turned = Affine3A::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 0.7 * f32::from(i));
        add(0, Affine3A::from_translation(at) * turned);
    }
    for i in 0..6u8 {
        let axis = [Vec3::X, Vec3::Y, Vec3::Z][usize::from(i % 3)] * if i < 3 { 1.0 } else { -1.0 };
        let turn = Affine3A::from_quat(Quat::from_rotation_arc(Vec3::Z, axis));
        add(1, Affine3A::from_translation(Vec3::splat(3.45)) * turn);
    }
    Ok(Tracing::new(&scene, MediaMode::Off, Direct::Auto)?)
}

fn stone() -> Mesh {
    sheet(128, 64, |u, v| {
        let (a, b) = (u * std::f32::consts::TAU, v * std::f32::consts::PI);
        let n = Vec3::new(b.sin() * a.cos(), b.cos(), b.sin() * a.sin());
        let rough = (n.x * 9.0).sin() * (n.y * 11.0).cos() + 0.5 * (n.z * 31.0 + n.x * 23.0).sin();
        n * (1.0 + 0.06 * rough)
    })
}

fn wall() -> Mesh {
    sheet(1, 1, |u, v| Vec3::new(10.0 * u - 5.0, 10.0 * v - 5.0, -5.0))
}

fn sheet(w: u16, h: u16, f: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    for y in 0..=h {
        for x in 0..=w {
            mesh.positions.push(f(f32::from(x) / f32::from(w), f32::from(y) / f32::from(h)));
        }
    }
    let (w, h) = (u32::from(w), u32::from(h));
    for y in 0..h {
        for x in 0..w {
            let a = y * (w + 1) + x;
            mesh.triangles.extend([[a, a + 1, a + w + 2], [a, a + w + 2, a + w + 1]]);
        }
    }
    mesh
}

/// Rays without coherence.
pub(crate) struct Rays {
    /// From points on the surfaces, by area, into the cosine lobe of either side.
    pub(crate) first: Vec<Ray>,
    /// From where those hit, into the cosine lobe there.
    pub(crate) second: Vec<Ray>,
    /// From one point on the surfaces almost to another, as to an area light.
    pub(crate) shadow: Vec<Ray>,
}

impl Rays {
    /// `n` of each kind, at most.
    pub(crate) fn new(tracing: &Tracing, n: u32) -> Self {
        let world = &tracing.world;
        let areas = Areas::new(world);
        let mut rays = Self { first: Vec::new(), second: Vec::new(), shadow: Vec::new() };
        for i in 0..n {
            let mut s = Sequence::new(key(11, 12, u64::from(i)), 0);
            let (a, b, c, d) = (s.next4(), s.next4(), s.next4(), s.next4());
            let (from, normal) = areas.point(world, [a[0], a[1], a[2]], a[3]);
            let first = Ray { origin: from, direction: lobe(normal, [b[0], b[1]]), t_max: f32::INFINITY };
            if let Some(hit) = tracing.bvh.closest(&first, |_| true) {
                let normal = world.geometric_normal(hit.triangle);
                let normal = if normal.dot(first.direction) < 0.0 { normal } else { -normal };
                let origin = first.origin + first.direction * hit.t + normal * (world.radius * 1e-5);
                rays.second.push(Ray { origin, direction: lobe(normal, [b[2], b[3]]), t_max: f32::INFINITY });
            }
            rays.first.push(first);
            let (to, _) = areas.point(world, [c[0], c[1], c[2]], d[0]);
            let way = to - from;
            rays.shadow.push(Ray {
                origin: from,
                direction: way.normalize_or(Vec3A::X),
                t_max: 0.999 * way.length(),
            });
        }
        rays
    }
}

/// Areas of triangles, summed up.
struct Areas(Vec<f64>);

impl Areas {
    fn new(world: &World) -> Self {
        let mut sum = 0.0;
        let n = u32::try_from(world.len()).unwrap_or(u32::MAX);
        Self(
            (0..n)
                .map(|t| {
                    sum += f64::from(world.area(t));
                    sum
                })
                .collect(),
        )
    }

    /// A point a little off the surface, and the normal of that side.
    fn point(&self, world: &World, u: [f32; 3], side: f32) -> (Vec3A, Vec3A) {
        let total = self.0.last().copied().unwrap_or(0.0);
        let t = self.0.partition_point(|&s| s < f64::from(u[0]) * total).min(self.0.len() - 1);
        let [a, b, c] = world.corners(u32::try_from(t).unwrap_or(u32::MAX)).map(Vec3A::from);
        let (r, v) = (u[1].sqrt(), u[2]);
        let normal = world.geometric_normal(u32::try_from(t).unwrap_or(0));
        let normal = if side < 0.5 { normal } else { -normal };
        let p = a * (1.0 - r) + b * (r * (1.0 - v)) + c * (r * v);
        (p + normal * (world.radius * 1e-5), normal)
    }
}

/// A direction around `normal` with a density in proportion to the cosine.
fn lobe(normal: Vec3A, u: [f32; 2]) -> Vec3A {
    let (z, phi) = (1.0 - 2.0 * u[0], std::f32::consts::TAU * u[1]);
    let r = (1.0 - z * z).max(0.0).sqrt();
    (normal + Vec3A::new(r * phi.cos(), r * phi.sin(), z)).normalize_or(normal)
}
