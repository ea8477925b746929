//! Measures the unwrapper: time, charts, stretch and utilisation for generated meshes of growing
//! size, and for xatlas beside it where that feature is on.
//!
//! ```text
//! cargo run --release --example charts --features xatlas -- [SECONDS]
//! ```
#![expect(clippy::print_stdout, reason = "the table is what the program is for")]

use std::{process::ExitCode, time::Instant};

use bake::{
    geom::atlas::{self, Atlas, AtlasOptions, Density, Engine, Unwrap},
    scene::model::{LightmapMode, Material, Mesh, Scene, Surface},
};
use glam::{Affine3A, DVec2, Vec3};

fn main() -> ExitCode {
    #[cfg(feature = "xatlas")]
    let seconds = std::env::args().nth(1).and_then(|s| s.parse().ok()).unwrap_or(60);
    println!("| mesh | triangles | engine | s | charts | stretch | utilisation |");
    println!("|---|---|---|---|---|---|---|");
    let mut code = ExitCode::SUCCESS;
    for (name, scene) in scenes() {
        let engines = [
            ("uvunwrap", Engine::Uvunwrap),
            #[cfg(feature = "xatlas")]
            ("xatlas", Engine::Xatlas { seconds }),
        ];
        for (engine_name, engine) in engines {
            let options = AtlasOptions {
                density: Density::Fit { page_size: 1024 },
                unwrap: Unwrap::Always,
                engine,
                ..AtlasOptions::default()
            };
            let triangles: usize = scene.surfaces.iter().map(|s| scene.meshes[s.mesh].triangles.len()).sum();
            let start = Instant::now();
            match atlas::build(&scene, &options, &|_, _| true) {
                Ok((a, findings)) => println!(
                    "| {name} | {triangles} | {engine_name}{} | {:.2} | {} | {:.3} | {:.0} % |",
                    if findings.is_empty() { "" } else { " (gave up)" },
                    start.elapsed().as_secs_f64(),
                    a.charts,
                    stretch(&scene, &a),
                    a.utilisation * 100.0
                ),
                Err(e) => {
                    println!("{name}: {e}");
                    code = ExitCode::FAILURE;
                }
            }
        }
    }
    code
}

/// Root mean square over the area of the lengths on the surface per length in the texture, where
/// texture areas are scaled to the surface's: 1 for a perfect map.
fn stretch(scene: &Scene, atlas: &Atlas) -> f64 {
    let (mut sum, mut metres, mut texels) = (0.0, 0.0, 0.0);
    for (p, s) in atlas.placements.iter().zip(&scene.surfaces) {
        let Some(p) = p else { continue };
        let (layout, mesh) = (&atlas.layouts[p.layout], &scene.meshes[s.mesh]);
        for (t, source) in layout.triangles.iter().zip(&mesh.triangles) {
            let [u0, u1, u2] = t.map(|v| atlas.texel_position(p, v).as_dvec2());
            let [a, b, c] =
                source.map(|v| s.world_from_mesh.transform_point3(mesh.positions[v as usize]).as_dvec3());
            let (d1, d2): (DVec2, DVec2) = (u1 - u0, u2 - u0);
            let det = d1.perp_dot(d2);
            let area = (b - a).cross(c - a).length() * 0.5;
            if det == 0.0 || area == 0.0 {
                continue;
            }
            let per_u = ((b - a) * d2.y - (c - a) * d1.y) / det;
            let per_v = ((c - a) * d1.x - (b - a) * d2.x) / det;
            sum += area * 0.5 * (per_u.length_squared() + per_v.length_squared());
            metres += area;
            texels += det.abs() * 0.5;
        }
    }
    (sum / metres * (texels / metres)).sqrt()
}

fn scenes() -> Vec<(String, Scene)> {
    let mut out = Vec::new();
    for n in [5, 16, 50, 100] {
        out.push(("bumpy floor".to_owned(), scene(vec![(bumpy(n), 1)])));
    }
    for n in [8, 32] {
        out.push(("sphere".to_owned(), scene(vec![(sphere(n), 1)])));
    }
    out.push(("200 spheres".to_owned(), scene(vec![(sphere(8), 200)])));
    out.push(("one point".to_owned(), scene(vec![(sheet(1, |_, _| Vec3::ZERO), 1), (bumpy(2), 1)])));
    out
}

fn bumpy(n: u16) -> Mesh {
    sheet(n, |u, v| {
        let height = 0.05 * (u * 40.0).sin() * (v * 31.0).cos() + 0.02 * (u * 131.0 + v * 77.0).sin();
        Vec3::new(u * 5.0, height, v * 5.0)
    })
}

fn sphere(n: u16) -> Mesh {
    sheet(n, |u, v| {
        let (a, b) = (u * std::f32::consts::TAU, v * std::f32::consts::PI);
        Vec3::new(b.sin() * a.cos(), b.cos(), b.sin() * a.sin())
    })
}

fn sheet(n: u16, f: impl Fn(f32, f32) -> Vec3) -> Mesh {
    let mut mesh = Mesh { name: "sheet".to_owned(), ..Mesh::default() };
    for y in 0..=n {
        for x in 0..=n {
            mesh.positions.push(f(f32::from(x) / f32::from(n), f32::from(y) / f32::from(n)));
        }
    }
    let n = u32::from(n);
    for y in 0..n {
        for x in 0..n {
            let a = y * (n + 1) + x;
            mesh.triangles.extend([[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]);
        }
    }
    mesh
}

fn scene(parts: Vec<(Mesh, u16)>) -> Scene {
    let mut scene = Scene { materials: vec![Material::default()], ..Scene::default() };
    for (mesh, count) in parts {
        for i in 0..count {
            scene.surfaces.push(Surface {
                path: format!("node {i}"),
                node: i.into(),
                gpu_instance: None,
                mesh: scene.meshes.len(),
                material: 0,
                world_from_mesh: Affine3A::from_translation(Vec3::X * 3.0 * f32::from(i)),
                lightmap: LightmapMode::On,
                casts_shadow: true,
                texels_per_metre: None,
            });
        }
        scene.meshes.push(mesh);
    }
    scene
}
