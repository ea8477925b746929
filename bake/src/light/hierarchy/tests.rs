#![expect(clippy::print_stdout, reason = "figures that are reported")]

use super::*;
use crate::sample::{Sequence, sequence};
use glam::Vec3;

/// Lights in a cube of 4 m, some in clusters, of various strengths and colours.
fn cloud(n: u32, seed: u64) -> Vec<PointLight> {
    (0..n)
        .map(|i| {
            let [a, b, c, d] = Sequence::new(sequence::key(seed, 1, u64::from(i)), 0).next4();
            let squeeze = if i % 3 == 0 { 0.1 } else { 1.0 };
            PointLight {
                position: Vec3A::new(a, b, c) * 4.0 * squeeze,
                intensity: Vec3::new(d, d * d, 0.5) * (1.0 + 9.0 * d),
            }
        })
        .collect()
}

fn options(alpha: f32) -> Options {
    Options {
        spacing: 0.25,
        alpha,
        levels: None,
        anchor: Vec3A::ZERO,
        build: Build::FromLights,
        blend: Blend::Conserving,
        clamp: Clamp::All,
        keep: 1.0,
    }
}

/// Weights of all levels sum to 1 at any one distance.
#[test]
fn blending_functions_are_a_partition_of_unity() {
    for alpha in [1.0, 2.0, 5.5] {
        let h = Hierarchy::new(&cloud(200, 1), &options(alpha));
        assert!(4 <= h.levels().len());
        for i in 0..4000u16 {
            let d = f32::from(i) * 0.01;
            let sum: f32 = (0..h.levels().len()).map(|l| h.blend(l, d)).sum();
            assert!((sum - 1.0).abs() < 1e-6, "alpha {alpha}, {d} m: {sum}");
        }
        // Each reaches as far as its bins do.
        for l in 0..h.levels().len() - 1 {
            assert_eq!(h.blend(l, 2.0 * h.levels()[l].radius), 0.0);
        }
    }
}

/// Weights of all that stands for a light sum to 1 at any place: those of all lights, weighted by intensity, to all intensity. The published ones do not.
#[test]
fn what_levels_take_over_adds_up() {
    for (build, alpha) in [Build::FromLights, Build::FromBelow].into_iter().zip([1.0, 2.5]) {
        for seed in 1..4 {
            let lights = cloud(400, seed);
            let h = Hierarchy::new(&lights, &Options { build, ..options(alpha) });
            let total: f32 = lights.iter().map(|l| luminance(l.intensity)).sum();
            for i in 0..200u32 {
                let [a, b, c, _] = Sequence::new(17, i).next4();
                let mut sum = 0.0;
                h.visit(Vec3A::new(a, b, c) * 12.0 - 4.0, |_, _, l, _, weight| {
                    sum += weight * luminance(l.intensity);
                });
                assert!((sum / total - 1.0).abs() < 2e-5, "{build:?} {alpha} {seed} {i}: {sum} of {total}");
            }
        }
    }
    let lights = cloud(2000, 5);
    let total: f32 = lights.iter().map(|l| luminance(l.intensity)).sum();
    let mut off = Vec::new();
    for alpha in [1.0, 2.0, 4.0, 8.0, 16.0] {
        let h = Hierarchy::new(&lights, &Options { blend: Blend::Published, ..options(alpha) });
        let mut worst = 0.0f32;
        for i in 0..400u32 {
            let [a, b, c, _] = Sequence::new(17, i).next4();
            let mut sum = 0.0;
            h.visit(Vec3A::new(a, b, c) * 12.0 - 4.0, |_, _, l, _, weight| {
                sum += weight * luminance(l.intensity);
            });
            worst = worst.max((sum / total - 1.0).abs());
        }
        off.push(worst);
    }
    println!("published weights off from 1 at alpha 1, 2, 4, 8, 16: {off:?}");
    assert!(off[4] < off[0] && 0.01 < off[0], "{off:?}");
}

/// Every level has all of the light, and the same centre of it; each light of it is within the eight cells around its vertex, which are two
/// spacings wide.
#[test]
fn levels_conserve_light_and_its_centre() {
    for (seed, build) in [(1, Build::FromLights), (2, Build::FromBelow), (3, Build::FromLights)] {
        let lights = cloud(500, seed);
        let h = Hierarchy::new(&lights, &Options { build, ..options(2.0) });
        let total: DVec3 = lights.iter().map(|l| l.intensity.as_dvec3()).sum();
        let weigh = |p: Vec3A, i: Rgb| p.as_dvec3() * f64::from(luminance(i));
        let centre: DVec3 = lights.iter().map(|l| weigh(l.position, l.intensity)).sum();
        for (l, level) in h.levels().iter().enumerate() {
            let sum: DVec3 = level.lights.iter().map(|l| l.intensity.as_dvec3()).sum();
            assert!(((sum - total) / total).abs().max_element() < 1e-5, "level {l}: {sum} of {total}");
            let here: DVec3 = level.lights.iter().map(|l| weigh(l.position, l.intensity)).sum();
            assert!(((here - centre) / centre).abs().max_element() < 1e-4, "level {l}");
            assert_eq!(level.pruned, (0, 0.0));
        }
        let last = h.levels().last().expect("a level");
        assert!(last.lights.len() <= 27, "{} lights on the last level", last.lights.len());
    }
}

/// Illumination centres are within the block of eight cells around some vertex: with the share of each vertex known, around its own.
#[test]
fn centres_are_inside_their_blocks() {
    let lights: Vec<GridLight> = cloud(300, 7)
        .into_iter()
        .map(|l| GridLight {
            position: l.position,
            intensity: l.intensity,
            deviation: Vec3A::ZERO,
            size: 0.0,
            vertex: IVec3::ZERO,
        })
        .collect();
    for h in [0.3, 0.7, 2.0] {
        // One light alone is at its place on each of the vertices around it, none of which is farther than a spacing along any axis.
        for l in &lights {
            let vertices = gathered(std::slice::from_ref(l), h, Vec3A::ZERO);
            assert!(vertices.len() <= 8 && vertices.iter().all(|v| v.position.distance(l.position) < 1e-5));
            assert!(vertices.iter().all(|v| v.size < 1e-5 && v.deviation.max_element() < 1e-5));
        }
        // Of many, each vertex' centre is among the lights of its block.
        for v in gathered(&lights, h, Vec3A::ZERO) {
            let near = lights.iter().filter(|l| (l.position - v.position).abs().max_element() <= 2.0 * h);
            assert!(0 < near.count());
            assert!(v.deviation.max_element() <= h * 1.001 && v.size <= 3f32.sqrt() * h * 1.001, "{v:?}");
        }
    }
}

/// Left out is no more than what need not be kept, of the weakest, and the last level has everything.
#[test]
fn weak_lights_are_left_out_below_the_last_level() {
    let lights = cloud(500, 4);
    let h = Hierarchy::new(&lights, &Options { keep: 0.95, ..options(2.0) });
    let total: f64 = lights.iter().map(|l| f64::from(luminance(l.intensity))).sum();
    for (l, level) in h.levels().iter().enumerate() {
        let sum: f64 = level.lights.iter().map(|l| f64::from(luminance(l.intensity))).sum();
        let last = l + 1 == h.levels().len();
        let (n, part) = level.pruned;
        assert!((sum / total + part - 1.0).abs() < 1e-5);
        assert!(if last { n == 0 } else { part <= 0.05 }, "level {l}: {n} lights, {part}");
    }
    assert!(50 < h.levels()[0].pruned.0);
}

/// The larger alpha, the nearer to a sum over all lights, with the same clamp of distances: on surfaces that face the middle of the lights, and from all around.
#[test]
fn the_error_falls_with_alpha() {
    let lights = cloud(2000, 5);
    for (blend, most) in [(Blend::Conserving, 0.02), (Blend::Published, 0.05)] {
        let error = |alpha: f32| {
            let h = Hierarchy::new(&lights, &Options { blend, ..options(alpha) });
            let (mut facing, mut around) = (0.0, 0.0);
            for i in 0..200u32 {
                let [a, b, c, _] = Sequence::new(99, i).next4();
                let place = Vec3A::new(a, b, c) * 8.0 - 2.0;
                let normal = (Vec3A::splat(2.0) - place).normalize();
                let cos = |p: Vec3A| (p - place).normalize().dot(normal).max(0.0);
                let (mut sums, mut want) = ([0.0; 2], [0.0; 2]);
                h.visit(place, |level, _, l, d, w| {
                    let all = luminance(l.intensity) * w * h.falloff(level, d);
                    sums = [sums[0] + all * cos(l.position), sums[1] + all];
                });
                for l in &lights {
                    let all = luminance(l.intensity) * h.falloff(0, l.position.distance(place));
                    want = [want[0] + all * cos(l.position), want[1] + all];
                }
                facing += f64::from((sums[0] / want[0] - 1.0).abs()) / 200.0;
                around += f64::from((sums[1] / want[1] - 1.0).abs()) / 200.0;
            }
            (facing, around)
        };
        let curve = [1.0, 2.0, 4.0, 8.0, 16.0].map(error);
        println!("{blend:?}: mean error at alpha 1, 2, 4, 8, 16, facing and from all around: {curve:?}");
        assert!(curve.windows(2).all(|w| w[1].0 < 0.7 * w[0].0 && w[1].1 < 0.7 * w[0].1), "{curve:?}");
        assert!(curve[1].0 < most && curve[4].0 < 1e-3, "{curve:?}");
    }
}

/// A light that moves by a thousandth of a cell changes what arrives by about as much, and never jumps.
#[test]
fn small_moves_make_small_changes() {
    let lights = cloud(300, 6);
    let at = |shift: f32| {
        let moved: Vec<PointLight> =
            lights.iter().map(|l| PointLight { position: l.position + Vec3A::X * shift, ..*l }).collect();
        let h = Hierarchy::new(&moved, &options(2.0));
        luminance(h.unshadowed(Vec3A::new(2.0, -1.0, 2.0)))
    };
    let values: Vec<f32> = (0..100u8).map(|i| at(f32::from(i) * 2.5e-4)).collect();
    let step = values.windows(2).map(|w| (w[1] / w[0] - 1.0).abs()).fold(0.0, f32::max);
    println!("greatest change in a thousandth of a cell: {step:.2e}");
    assert!(step < 5e-4, "{step}");
}

/// What one of a level stands for comes up in proportion to what it brings.
#[test]
fn lights_of_a_level_lead_to_those_they_stand_for() {
    for build in [Build::FromLights, Build::FromBelow] {
        let lights = cloud(300, 8);
        let h = Hierarchy::new(&lights, &Options { build, ..options(2.0) });
        for level in 1..h.levels().len() {
            let here = &h.levels()[level].lights;
            let (mut sum, mut square) = (Vec3A::ZERO, Vec3A::ZERO);
            // One in the middle of them.
            let number = here.len() / 2;
            let n = 1 << 14;
            for k in 0..n {
                let off = h.one_of(level, number, (f64::from(k) + 0.5) / f64::from(n)).position
                    - here[number].position;
                sum += off / n as f32;
                square += off * off / n as f32;
            }
            let deviation = here[number].deviation;
            assert!(sum.length() < 2e-3 * h.levels()[level].spacing, "{build:?} {level}: {sum}");
            let more = build == Build::FromBelow;
            let got = square.map(f32::sqrt);
            assert!(
                more || (got - deviation).abs().max_element() < 5e-3 * h.levels()[level].spacing,
                "{build:?} {level}: {got} for {deviation}"
            );
        }
        // Of the last level every light has its part.
        let last = h.levels().len() - 1;
        assert!(h.levels()[last].lights.len() <= 8);
    }
}

/// Points where light that left a lamp met the walls of a room, as lights of their own: the spacing comes from them, and the larger alpha, the nearer to a sum over all, as in \[LGH17\] figure 13.
#[test]
fn points_where_light_was_reflected_need_no_spacing() {
    const N: u32 = 50_000;
    let lamp = Vec3A::new(1.0, 2.5, 1.5);
    let room = Vec3A::new(4.0, 3.0, 6.0);
    let point = |k: u32| {
        let [a, b, ..] = Sequence::new(sequence::key(3, 9, u64::from(k)), 0).next4();
        let (z, phi) = (1.0 - 2.0 * a, std::f32::consts::TAU * b);
        let r = (1.0 - z * z).sqrt();
        let way = Vec3A::new(r * phi.cos(), z, r * phi.sin());
        let t = way.signum().max(Vec3A::ZERO) * room - lamp;
        let t = (t / way).min_element();
        // What a wall of albedo 0.5 sends on, alike in all directions.
        PointLight { position: lamp + way * t, intensity: Vec3::new(0.5, 0.4, 0.3) / N as f32 }
    };
    let lights: Vec<PointLight> = (0..N).map(point).collect();
    let spacing = Hierarchy::spacing_for(&lights, Vec3A::ZERO);
    let of = |alpha| Hierarchy::new(&lights, &Options { spacing, ..options(alpha) });
    let vertices = of(1.0).levels()[1].lights.len();
    assert!(vertices <= N as usize && N as usize <= 8 * vertices, "{vertices} of level 1");
    let error = |alpha: f32| {
        let h = of(alpha);
        let (mut off, mut asked) = (0.0, 0);
        for k in 0..60u32 {
            let [a, b, c, _] = Sequence::new(77, k).next4();
            let place = Vec3A::new(a, b, c) * room;
            h.visit(place, |_, _, _, _, _| asked += 1);
            let each = |l: &PointLight| f64::from(l.intensity.x * h.falloff(0, l.position.distance(place)));
            let want: f64 = lights.iter().map(each).sum();
            off += (f64::from(h.unshadowed(place).x) / want - 1.0).abs() / 60.0;
        }
        (off, asked / 60)
    };
    let [one, four, sixteen] = [1.0, 4.0, 16.0].map(error);
    println!(
        "h_1 {:.1} cm, {vertices} vertices; alpha 1, 4, 16: error {:.3}, {:.3}, {:.4} % with {}, {}, {} of {N} lights",
        100.0 * spacing,
        100.0 * one.0,
        100.0 * four.0,
        100.0 * sixteen.0,
        one.1,
        four.1,
        sixteen.1
    );
    assert!(one.0 < 0.15 && four.0 < 0.2 * one.0 && sixteen.0 < 0.2 * four.0, "{one:?} {four:?} {sixteen:?}");
    assert!(one.1 < four.1 && four.1 < sixteen.1 && sixteen.1 < N as usize, "{one:?} {four:?} {sixteen:?}");
}

mod shadows {
    use super::*;
    use crate::light::hierarchy::shadows::Shadows;
    use crate::media::Media;
    use crate::media::lattice::Lattice;
    use crate::scene::model::{Density, Medium, Region, Scene};
    use crate::scene::voxels::Voxels;
    use glam::{Affine3A, UVec3};
    use std::sync::Arc;

    const N: u32 = 24;

    /// A ball of uneven smoke in a cube of 2.4 m, voxels of 10 cm, whose optical depth from its middle is about 3.
    fn smoke() -> Media {
        let density = |v: UVec3| {
            let p = (v.as_vec3() + 0.5) / N as f32 - 0.5;
            let [a, ..] =
                Sequence::new(sequence::key(5, 5, u64::from(v.x + 64 * (v.y / 2 + 64 * (v.z / 2)))), 0)
                    .next4();
            if p.length() < 0.4 { 2.0 * a } else { 0.0 }
        };
        let values = Voxels::from_fn(UVec3::splat(N), 1 << 30, density).expect("a grid");
        let medium = Medium {
            path: "smoke".into(),
            sigma_s: Vec3::splat(1.5),
            sigma_a: Vec3::splat(1.5),
            emission: Vec3::ZERO,
            density: Density::Voxels {
                values: Arc::new(values),
                voxels_from_world: Affine3A::from_scale(Vec3::splat(10.0)),
            },
            g: 0.0,
            region: Region::Everywhere,
        };
        Media::new(&Scene { media: vec![medium], ..Scene::default() }, Vec3::ZERO).expect("smoke")
    }

    /// Lights at the centres of voxels inside of the ball.
    fn fire() -> Vec<PointLight> {
        let cells =
            (0..N * N * N).map(|i| Vec3A::new((i % N) as f32, (i / N % N) as f32, (i / (N * N)) as f32));
        let centre = Vec3A::splat(1.2);
        cells
            .map(|c| (c + 0.5) * 0.1)
            .filter(|p| p.distance(centre) < 0.7)
            .map(|position| PointLight { position, intensity: Vec3::splat(1.0 + (7.0 * position.x).sin()) })
            .collect()
    }

    /// What is left of a level's light at places where the level counts, against the lights themselves, each along its own line.
    #[test]
    fn maps_know_what_smoke_leaves_of_the_lights_they_stand_for() {
        let (media, lights) = (smoke(), fire());
        let h = Hierarchy::new(&lights, &Options { spacing: 0.2, ..options(2.0) });
        let shadows =
            Shadows::new(&h, (Lattice::new(&media).expect("a lattice"), media.clone()), 4, &|| false);
        for (l, level) in h.levels().iter().enumerate() {
            let near = if l == 0 { 0.0 } else { h.levels()[l - 1].radius };
            let (mut sum, mut want, mut published) = (0.0, 0.0, 0.0);
            for k in 0..400u32 {
                let [a, b, c, d] = Sequence::new(sequence::key(8, l as u64, u64::from(k)), 0).next4();
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
                let i = ((a * level.lights.len() as f32) as usize).min(level.lights.len() - 1);
                let light = &level.lights[i];
                let direction = crate::sample::warp::square_to_cos_hemisphere([b, c]);
                let direction = if k % 2 == 0 { direction } else { -direction };
                let distance = near + (2.0 * level.radius - near) * d;
                let place = light.position + direction * distance;
                sum += f64::from(shadows.left(l, i, direction, distance).x);
                published += f64::from((-shadows.marched(l, light, direction, distance)).exp().x);
                let (mut left, mut all) = (0.0, 0.0);
                for p in &lights {
                    let off = ((p.position / level.spacing) - light.vertex.as_vec3a()).abs();
                    let weight = if l == 0 {
                        f32::from(u8::from(p.position == light.position))
                    } else {
                        (1.0 - off).max(Vec3A::ZERO).to_array().iter().product::<f32>()
                    } * luminance(p.intensity);
                    if 0.0 < weight {
                        let way = place - p.position;
                        let t = media.transmittance(p.position, way.normalize(), way.length()).x;
                        // Nearer ones bring more than from where the light of the level is.
                        let near = way.length().max(0.25 * level.spacing);
                        let facing = way.dot(direction).max(0.0) / way.length();
                        let turned = if l == 0 { 1.0 } else { facing * (distance / near).powi(2) };
                        left += f64::from(weight * t * turned);
                        all += f64::from(weight);
                    }
                }
                want += left / all;
            }
            println!(
                "level {l}: {:.4} of {:.4}, {:.4} as published",
                sum / 400.0,
                want / 400.0,
                published / 400.0
            );
            assert!((sum / want - 1.0).abs() < 0.1, "level {l}: {sum} of {want}");
        }
    }
}
