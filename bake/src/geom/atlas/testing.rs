//! Generated scenes for tests.

use std::f32::consts::{PI, TAU};

use glam::{Affine3A, Vec2, Vec3};

use crate::scene::model::{LightmapMode, Material, Mesh, Scene, Surface};

/// A mesh from a grid of points, `f` of both parameters in [0, 1].
pub(crate) fn sheet(columns: u32, rows: u32, f: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let mut mesh = Mesh { name: "sheet".into(), uvs: vec![Vec::new(); 2], ..Mesh::default() };
    for y in 0..=rows {
        for x in 0..=columns {
            let (u, v) = (x as f32 / columns as f32, y as f32 / rows as f32);
            mesh.positions.push(f(u, v));
            mesh.uvs[1].push(Vec2::new(u, v));
        }
    }
    for y in 0..rows {
        for x in 0..columns {
            let a = y * (columns + 1) + x;
            let b = a + columns + 1;
            mesh.triangles.extend([[a, a + 1, b + 1], [a, b + 1, b]]);
        }
    }
    mesh
}

/// The mesh without its second texture coordinates.
pub(crate) fn bare(mut mesh: Mesh) -> Mesh {
    mesh.uvs.clear();
    mesh
}

pub(crate) fn quad(width: f32, height: f32) -> Mesh {
    sheet(1, 1, |u, v| Vec3::new(u * width, 0.0, v * height))
}

pub(crate) fn bumpy(columns: u32, rows: u32) -> Mesh {
    sheet(columns, rows, |u, v| {
        let height = 0.05 * (u * 40.0).sin() * (v * 31.0).cos() + 0.02 * (u * 131.0 + v * 77.0).sin();
        Vec3::new(u * 5.0, height, v * 5.0)
    })
}

pub(crate) fn sphere(n: u32) -> Mesh {
    bare(sheet(2 * n, n, |u, v| {
        let (a, b) = (u * TAU, v * PI);
        Vec3::new(b.sin() * a.cos(), b.cos(), b.sin() * a.sin())
    }))
}

pub(crate) fn torus(n: u32) -> Mesh {
    bare(sheet(2 * n, n, |u, v| {
        let (a, b) = (u * TAU, v * TAU);
        let r = 1.0 + 0.4 * b.cos();
        Vec3::new(r * a.cos(), 0.4 * b.sin(), r * a.sin())
    }))
}

/// A cube of side 2 with its own corners on every face, and texture coordinates that stack faces.
pub(crate) fn cube() -> Mesh {
    let mut mesh = Mesh { name: "cube".into(), uvs: vec![Vec::new(); 2], ..Mesh::default() };
    for axis in 0..3 {
        for side in [-1.0_f32, 1.0] {
            let first = mesh.positions.len() as u32;
            for (u, v) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let mut p = Vec3::ZERO;
                p[axis] = side;
                p[(axis + 1) % 3] = u * side;
                p[(axis + 2) % 3] = v;
                mesh.positions.push(p);
                mesh.uvs[1].push(Vec2::new(u, v) * 0.5 + 0.5);
            }
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    mesh
}

/// A scene with one surface for each mesh and place.
pub(crate) fn scene(parts: Vec<(Mesh, Vec<Affine3A>)>) -> Scene {
    let mut scene = Scene { materials: vec![Material::default()], ..Scene::default() };
    for (mesh, places) in parts {
        for world_from_mesh in places {
            scene.surfaces.push(Surface {
                path: format!("node {}", scene.surfaces.len()),
                node: scene.surfaces.len(),
                gpu_instance: None,
                mesh: scene.meshes.len(),
                material: 0,
                world_from_mesh,
                lightmap: LightmapMode::On,
                casts_shadow: true,
                texels_per_metre: None,
            });
        }
        scene.meshes.push(mesh);
    }
    scene
}

/// Cube, sphere, torus, a bumpy floor and twenty small spheres at three sizes, one mirrored and
/// one stretched.
pub(crate) fn mixed() -> Scene {
    let at = |i: u32, s: f32| {
        Affine3A::from_translation(Vec3::X * i as f32) * Affine3A::from_scale(Vec3::splat(s))
    };
    let mut small: Vec<Affine3A> = (0..20).map(|i| at(i, [0.3, 0.33, 0.9][i as usize % 3])).collect();
    small.push(at(21, 0.3) * Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0)));
    small.push(at(22, 0.3) * Affine3A::from_scale(Vec3::new(1.0, 5.0, 0.5)));
    scene(vec![
        (cube(), vec![Affine3A::IDENTITY, at(3, 0.25)]),
        (sphere(12), vec![Affine3A::IDENTITY]),
        (torus(16), vec![Affine3A::IDENTITY, at(9, 1.7)]),
        (bare(bumpy(24, 24)), vec![Affine3A::IDENTITY]),
        (sphere(5), small),
    ])
}
