//! Measures the tree against Embree: nearest hits and occlusion of single rays without coherence.
//!
//! ```text
//! BAKE_SHARED=FOLDER cargo bench -p bake --bench rays [-- RAYS]
//! ```
//!
//! Each round times all right after each other; ratios are Embree's time by ours, so that above 1
//! ours is faster, and the median over the rounds is what counts. Hits are compared as well.
#![expect(clippy::print_stdout, reason = "the table is what the program is for")]

mod embree;
mod scenes;

use bake::geom::Ray;
use bake::plan::Tracing;
use embree::Embree;
use scenes::Rays;
use std::env;
use std::hint::black_box;
use std::path::PathBuf;
use std::time::Instant;

const ROUNDS: usize = 9;

fn main() -> anyhow::Result<()> {
    let rays = env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(200_000);
    let Some(embree) = Embree::open() else {
        println!("skipped: no libembree3.so.3");
        return Ok(());
    };
    let shared = env::var_os("BAKE_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    println!("| scene | triangles | rays | hit | ns a ray | of Embree's speed | of robust Embree's |");
    println!("|---|---|---|---|---|---|---|");
    let files = [
        ("Sponza", "scenes/sponza-crytek-amd/Sponza.gltf"),
        ("staircase", "scenes/bitterli-staircase/staircase.glb"),
    ];
    for (name, file) in files {
        let path = shared.join(file);
        if path.exists() {
            measure(name, &embree, &scenes::load(&path)?, rays)?;
        } else {
            println!("{name}: skipped, no file");
        }
    }
    measure("stones", &embree, &scenes::stones()?, rays)
}

fn measure(name: &str, embree: &Embree, tracing: &Tracing, n: u32) -> anyhow::Result<()> {
    let triangles = &tracing.world.triangles().collect::<Vec<_>>();
    let start = Instant::now();
    let bvh = bake::geom::Bvh::build(&tracing.world, |_| Some(bake::geom::bvh::Opacity::Opaque))?;
    let seconds = start.elapsed().as_secs_f64();
    let (world, lights, kernels) = (tracing.world.clone(), tracing.lights.clone(), tracing.kernels.clone());
    let tracing = &Tracing { world, bvh, lights, media: None, responses: None, fires: None, kernels };
    let fast = embree.scene(triangles, false)?;
    let robust = embree.scene(triangles, true)?;
    let rays = Rays::new(tracing, n);
    let bvh = &tracing.bvh;
    println!(
        "| {name} | {} | | | {:.1} bytes a triangle, built in {seconds:.2} s | | |",
        triangles.len(),
        bvh.bytes() as f64 / triangles.len() as f64
    );
    let line = |what: &str, list: &[Ray], share: f64, times: [f64; 3]| {
        println!(
            "| {name} | {} | {what} | {:.0} % | {:.0} | {:.3} | {:.3} |",
            triangles.len(),
            100.0 * share,
            times[0] / list.len() as f64,
            times[1],
            times[2]
        );
    };
    for (what, list) in [("closest, first", &rays.first), ("closest, second", &rays.second)] {
        let ours = |r: &Ray| bvh.closest(r, |_| true).map(|h| (h.t, h.triangle));
        let (hit, differ) = compare(list, tracing.world.radius, ours, |r| robust.closest(r));
        let times = race(
            list,
            [
                &|r| {
                    black_box(ours(r));
                },
                &|r| {
                    black_box(fast.closest(r));
                },
                &|r| {
                    black_box(robust.closest(r));
                },
            ],
        );
        line(what, list, hit, times);
        anyhow::ensure!(differ * 10_000 <= list.len(), "{name}, {what}: {differ} hits differ");
        if 0 < differ {
            println!("{name}, {what}: {differ} of {} hits differ from robust Embree's", list.len());
        }
    }
    for (what, list) in [
        ("occluded, first", &rays.first),
        ("occluded, second", &rays.second),
        ("occluded, segments", &rays.shadow),
    ] {
        let differ = list.iter().filter(|r| bvh.occluded(r, |_| true) != robust.occluded(r)).count();
        let hit = list.iter().filter(|r| robust.occluded(r)).count() as f64 / list.len() as f64;
        let times = race(
            list,
            [
                &|r| {
                    black_box(bvh.occluded(r, |_| true));
                },
                &|r| {
                    black_box(fast.occluded(r));
                },
                &|r| {
                    black_box(robust.occluded(r));
                },
            ],
        );
        line(what, list, hit, times);
        anyhow::ensure!(differ * 10_000 <= list.len(), "{name}, {what}: {differ} answers differ");
    }
    Ok(())
}

/// Share of rays that hit, and how many give something else than a tie. Files have coincident faces
/// that differ by rounding.
fn compare(
    rays: &[Ray],
    radius: f32,
    a: impl Fn(&Ray) -> Option<(f32, u32)>,
    b: impl Fn(&Ray) -> Option<(f32, u32)>,
) -> (f64, usize) {
    let (mut hits, mut differ) = (0, 0);
    for ray in rays {
        let (a, b) = (a(ray), b(ray));
        hits += usize::from(a.is_some());
        differ += usize::from(match (a, b) {
            (Some((t, i)), Some((u, k))) => i != k && 1e-5 * t.max(u) + 1e-6 * radius < (t - u).abs(),
            (None, None) => false,
            _ => true,
        });
    }
    (hits as f64 / rays.len() as f64, differ)
}

/// Nanoseconds that the first takes for all rays, and the others' times by it: medians. The methods
/// take turns every few milliseconds, so that other work on the machine slows all of them.
fn race(rays: &[Ray], methods: [&dyn Fn(&Ray); 3]) -> [f64; 3] {
    let mut rounds: Vec<[f64; 3]> = Vec::new();
    for _ in 0..=ROUNDS {
        let mut times = [0.0; 3];
        for part in rays.chunks(5_000) {
            for (time, method) in times.iter_mut().zip(methods) {
                let start = Instant::now();
                part.iter().for_each(method);
                *time += start.elapsed().as_secs_f64() * 1e9;
            }
        }
        rounds.push([times[0], times[1] / times[0], times[2] / times[0]]);
    }
    // The first round warms up.
    rounds.remove(0);
    [0, 1, 2].map(|i| {
        let mut column: Vec<f64> = rounds.iter().map(|r| r[i]).collect();
        column.sort_by(f64::total_cmp);
        column[column.len() / 2]
    })
}
