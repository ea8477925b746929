//! Figures of fires: how much light flickers when they move by less than anybody would see, what their shadows take and what keeping these saves.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use bake::geom::world::luminance;
use bake::light::fires::{FireOptions, Fires};
use bake::light::hierarchy::{Blend, GridLights, Hierarchy};
use bake::light::many::{Among, Chosen};
use bake::light::tree::Receiver;
use bake::light::{Direct, ManyLights, Punctual};
use bake::media::Media;
use bake::scene::model::{Density, LightKind, LightMode, Medium, Region, Rgb, Scene};
use bake::scene::voxels::Voxels;
use glam::{Affine3A, UVec3, Vec3, Vec3A};
use rayon::prelude::*;
use std::collections::HashMap;
use std::fmt::Write as _;
use std::sync::Arc;
use suite::scenes::fire::explosion;
use suite::tool;

/// Voxels along each side of the box of 3 m.
const SIZE: u32 = 32;
const FRAMES: u8 = 50;
/// Lights that lightcuts ask at each place: about as many as the hierarchy's that count there.
const CUT: usize = 128;

/// The explosion of the examples: smoke and heat.
fn grids(size: u32) -> [Arc<Voxels>; 2] {
    let shot = explosion(size, 0.5);
    [shot.smoke, shot.heat].map(|list| {
        let at = |v: UVec3| list[(v.x + size * (v.y + size * v.z)) as usize];
        Arc::new(Voxels::from_fn(UVec3::splat(size), 1 << 30, at).expect("a grid"))
    })
}

/// It, that many voxels aside.
fn moved([smoke, heat]: &[Arc<Voxels>; 2], voxels: f32) -> Media {
    let side = 3.0 / smoke.size().x as f32;
    let corner = Vec3::new(-1.5, 0.3, -1.5) + Vec3::X * (voxels * side);
    let place = (Affine3A::from_translation(corner) * Affine3A::from_scale(Vec3::splat(side))).inverse();
    let of = |values: &Arc<Voxels>, sigma: f32, emission: Rgb| Medium {
        path: "explosion".into(),
        sigma_s: Vec3::splat(sigma),
        sigma_a: Vec3::splat(sigma),
        emission,
        density: Density::Voxels { values: Arc::clone(values), voxels_from_world: place },
        g: 0.0,
        region: Region::Everywhere,
    };
    let media = vec![of(smoke, 4.0, Vec3::ZERO), of(heat, 0.0, Vec3::new(2e4, 9e3, 2.4e3))];
    Media::new(&Scene { media, ..Scene::default() }, Vec3::ZERO).expect("media")
}

/// Places on the walls of a room of 6 x 4 x 6 m, and their normals.
fn walls() -> Vec<(Vec3A, Vec3A)> {
    const ALONG: u8 = 12;
    let mut out = Vec::new();
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            for k in 0..ALONG * ALONG {
                let [a, b] =
                    [k % ALONG, k / ALONG].map(|i| (f32::from(i) + 0.5) / f32::from(ALONG) * 2.0 - 1.0);
                let mut p = Vec3A::ZERO;
                (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (sign, a, b);
                let mut normal = Vec3A::ZERO;
                normal[axis] = -sign;
                out.push((p * Vec3A::new(3.0, 2.0, 3.0) + Vec3A::Y * 2.0, normal));
            }
        }
    }
    out
}

/// A light by place and intensity.
type Light = (Vec3A, Rgb);

/// Illuminance by some lights with weights, through smoke.
fn lit(
    (place, normal): (Vec3A, Vec3A),
    media: &Media,
    clamp: f32,
    lights: impl Iterator<Item = (Light, f32)>,
) -> f64 {
    lights
        .map(|((position, intensity), weight)| {
            let way = position - place;
            let distance = way.length();
            let wi = way / distance;
            let cos = wi.dot(normal);
            if cos <= 0.0 || weight == 0.0 {
                return 0.0;
            }
            let left = media.transmittance(place, wi, distance).x;
            f64::from(luminance(intensity) * weight * cos * left / distance.max(clamp).powi(2))
        })
        .sum()
}

/// What the levels of a hierarchy are when each light belongs to the nearest vertex alone.
fn clusters(lights: &[Light], h: f32) -> Vec<Light> {
    let mut cells: HashMap<[i32; 3], (Vec3A, Rgb, f32)> = HashMap::new();
    for (p, intensity) in lights {
        let cell =
            cells.entry((*p / h).round().as_ivec3().to_array()).or_insert((Vec3A::ZERO, Rgb::ZERO, 0.0));
        let weight = luminance(*intensity);
        *cell = (cell.0 + *p * weight, cell.1 + *intensity, cell.2 + weight);
    }
    let mut all: Vec<_> = cells.into_iter().collect();
    all.sort_by_key(|(key, _)| *key);
    all.into_iter().map(|(_, (p, intensity, weight))| (p / weight, intensity)).collect()
}

/// Level by level: where levels take over from each other at once, between their radii.
fn hard(hierarchy: &Hierarchy, level: usize, distance: f32) -> f32 {
    let levels = hierarchy.levels();
    let from = if level == 0 { 0.0 } else { 0.5 * (levels[level - 1].radius + levels[level].radius) };
    let to = levels.get(level + 1).map_or(f32::INFINITY, |l| 0.5 * (levels[level].radius + l.radius));
    if (from..to).contains(&distance) { 1.0 } else { 0.0 }
}

/// A random number for each place, the same in all frames.
fn number(i: usize) -> f64 {
    (i as f64 * 0.618_033_988_749_895).fract()
}

fn cut(lights: &ManyLights, lamps: &[Light], i: usize, at: (Vec3A, Vec3A), media: &Media, clamp: f32) -> f64 {
    let receiver = Receiver { position: at.0, normal: at.1, below: 0.0 };
    let mut chosen = Vec::new();
    let mut visit = |c: Chosen, _: f32, expected: f32| {
        if let Chosen::Lamp(k) = c {
            chosen.push((lamps[k], expected.recip()));
        }
    };
    lights.several(&receiver, Among::Lamps, CUT, number(i), &mut visit);
    lit(at, media, clamp, chosen.into_iter())
}

/// Illuminance at all places by each way.
fn frame(media: &Media, places: &[(Vec3A, Vec3A)]) -> Vec<Vec<f64>> {
    let fires = |blend| Fires::new(media, FireOptions { blend, ..FireOptions::default() }).expect("a fire");
    let (ours, published) = (fires(Blend::Conserving), fires(Blend::Published));
    ours.shadows();
    published.shadows();
    let h = published.hierarchy();
    let clamp = h.clamp();
    let lamps: Vec<Light> = h.levels()[0].lights.iter().map(|l| (l.position, l.intensity)).collect();
    let of = |&(position, intensity): &Light| {
        let kind = LightKind::Point { position: position.into(), intensity, range: None };
        Punctual::new(kind, LightMode::Baked, Vec3::ZERO).expect("a lamp")
    };
    let punctual: Vec<Punctual> = lamps.iter().map(of).collect();
    let tree = |direct| ManyLights::new(direct, Some(&punctual), None).expect("a tree");
    let trees = [tree(Direct::Lightcuts), tree(Direct::Published)];
    let clustered: Vec<Vec<Light>> = h.levels().iter().map(|l| clusters(&lamps, l.spacing)).collect();
    let each = |(i, at): (usize, &(Vec3A, Vec3A))| {
        let by_fires = |fires: &Fires| {
            let mut sum = 0.0;
            fires.visit(at.0, |a| sum += f64::from(luminance(a.illuminance) * a.wi.dot(at.1).max(0.0)));
            sum
        };
        let levels = |lights: &dyn Fn(usize) -> Vec<Light>, weight: &dyn Fn(usize, f32) -> f32| -> f64 {
            let one = |l: usize| {
                let lights = lights(l).into_iter();
                lit(*at, media, clamp, lights.map(|light| (light, weight(l, light.0.distance(at.0)))))
            };
            (0..h.levels().len()).map(one).sum()
        };
        let gridded = |l: usize| h.levels()[l].lights.iter().map(|l| (l.position, l.intensity)).collect();
        vec![
            lit(*at, media, clamp, lamps.iter().map(|l| (*l, 1.0))),
            by_fires(&ours),
            by_fires(&published),
            levels(&gridded, &|l, d| hard(h, l, d)),
            levels(&|l| clustered[l].clone(), &|l, d| h.blend(l, d)),
            cut(&trees[0], &lamps, i, *at, media, clamp),
            cut(&trees[1], &lamps, i, *at, media, clamp),
        ]
    };
    places.par_iter().enumerate().map(each).collect()
}

const WAYS: [&str; 7] = [
    "all lights, one by one",
    "the hierarchy",
    "the hierarchy, blended as published",
    "its levels with hard thresholds",
    "clusters instead of shares",
    "lightcuts, trees rebuilt",
    "lightcuts as published, trees rebuilt",
];

/// An explosion that moves by a hundredth of a voxel from frame to frame: the greatest change of any place from one to the next beyond that of the sum over all lights.
#[test]
fn nothing_flickers_when_a_fire_moves_a_little() {
    if !suite::slow() {
        return println!("skipped: RUN_SLOW_TESTS is not set");
    }
    let grids = grids(SIZE);
    let places = walls();
    let (mut before, mut worst, mut error) = (None::<Vec<Vec<f64>>>, [0.0f64; 7], [0.0f64; 7]);
    for k in 0..FRAMES {
        let now = frame(&moved(&grids, f32::from(k) * 0.01), &places);
        for (i, here) in now.iter().enumerate() {
            for (way, light) in here.iter().enumerate() {
                error[way] += (light / here[0] - 1.0).abs() / (f64::from(FRAMES) * places.len() as f64);
                if let Some(before) = before.as_ref().map(|b| &b[i]) {
                    let own = here[0] - before[0];
                    let change = (light - before[way] - if way == 0 { 0.0 } else { own }).abs() / before[0];
                    worst[way] = worst[way].max(change);
                }
            }
        }
        before = Some(now);
    }
    let mut table = format!(
        "Greatest change of any of {} places from one of {FRAMES} frames to the next, over its light, on {}; of all but the first line beyond the first line's own:\n\n| way | change | mean error |\n|---|---|---|\n",
        places.len(),
        tool::machine()
    );
    for (k, way) in WAYS.iter().enumerate() {
        let _ = writeln!(table, "| {way} | {:.4} % | {:.2} % |", 100.0 * worst[k], 100.0 * error[k]);
    }
    println!("{table}");
    assert!(10.0 * worst[1] <= worst[5].min(worst[6]), "{worst:?}");
    assert!(error[1] < 0.05, "{error:?}");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::write(suite::root().join("data/flicker.md"), table).expect("a file");
    }
}

/// Lights and shadows level by level of the explosion of 64^3 voxels, and how much quicker its shadows are looked up than marched: as published, in steps as wide as the filter, and voxel by
/// voxel.
#[test]
fn shadows_that_are_kept_are_quicker_than_marching() {
    if !suite::slow() {
        return println!("skipped: RUN_SLOW_TESTS is not set");
    }
    let media = moved(&grids(64), 0.0);
    let fires = Fires::new(&media, FireOptions::default()).expect("a fire");
    let shadows = fires.shadows().expect("smoke");
    let mut table = String::from(
        "| level | spacing | lights | texels of each | bytes of a texel | MiB |\n|---|---|---|---|---|---|\n",
    );
    let mut total = 0.0;
    for (l, (level, size)) in fires.hierarchy().levels().iter().zip(fires.sizes()).enumerate() {
        let mib = size.bytes as f64 / f64::from(1 << 20);
        total += mib;
        let [lights, texels, bytes] = [size.lights, size.texels, size.texel_bytes];
        let _ =
            writeln!(table, "| {l} | {:.3} m | {lights} | {texels} | {bytes} | {mib:.2} |", level.spacing);
    }
    let _ = writeln!(table, "| all | | | | | {total:.2} |");
    // What places around ask: all lights that count there, by level, number, what they are, direction and distance.
    type Asked = (usize, usize, bake::light::hierarchy::GridLight, Vec3A, f32);
    let mut asked: Vec<Asked> = Vec::new();
    for (place, _) in walls().into_iter().step_by(16) {
        fires.hierarchy().visit(place, |level, number, light, distance, _| {
            asked.push((level, number, *light, (place - light.position).normalize_or(Vec3A::Y), distance));
        });
    }
    let time = |each: &dyn Fn(&Asked) -> f32| {
        // The best of some, because other programs run as well.
        let one = || {
            let begin = std::time::Instant::now();
            let sum: f32 = asked.iter().map(each).sum();
            (begin.elapsed().as_secs_f64(), sum)
        };
        (0..5).map(|_| one()).min_by(|a, b| a.0.total_cmp(&b.0)).expect("five")
    };
    let kept = time(&|(l, i, _, direction, distance)| shadows.left(*l, *i, *direction, *distance).x);
    let published = time(&|(l, _, light, direction, distance)| {
        (-shadows.marched(*l, light, *direction, *distance)).exp().x
    });
    let exact = time(&|(_, _, light, direction, distance)| {
        media.transmittance(light.position, *direction, *distance).x
    });
    let n = asked.len() as f64;
    let text = format!(
        "Of the explosion of 64^3 voxels at alpha 2, on {}:\n\n{table}\nTo look up what smoke leaves of a light takes a {:.0}th of marching as published and a {:.0}th of marching voxel by voxel; {:.0} lights count at a place on the walls of the room.\n",
        tool::machine(),
        published.0 / kept.0,
        exact.0 / kept.0,
        n / 54.0
    );
    println!(
        "{text}means {:.3}, {:.3} and {:.3}",
        f64::from(kept.1) / n,
        f64::from(published.1) / n,
        f64::from(exact.1) / n
    );
    assert!(10.0 * kept.0 < published.0.min(exact.0), "{kept:?} {published:?} {exact:?}");
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        std::fs::write(suite::root().join("data/fire-levels.md"), text).expect("a file");
    }
}
