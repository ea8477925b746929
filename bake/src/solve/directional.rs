//! The direction that the light of texels comes from: band 1 of spherical harmonics.
//!
//! A surface with a normal map asks a lightmap what it would hold for another normal. With bands 0 and 1 of the light from before a surface that is
//! `E(n') / pi = a + s . n'`, s being the integral of radiance times direction over 2 pi (\[RH01\] Ramamoorthi & Hanrahan, "An Efficient Representation for Irradiance
//! Environment Maps", SIGGRAPH 2001, with the clamped cosine's factors of bands 0 and 1). The lightmap already knows `E(n) / pi` much better than a first band could say,
//! so what is kept of it is exact: `E(n') / pi = E(n) / pi + s . (n' - n)`. The part of s along n is half of `E(n) / pi` by itself; paths only have to find the other two.
//!
//! These paths are [`Kernel::sample_around`], those of light probes. What they find of s is taken over what they find of `E`, and times what the
//! lightmap has: where light is uneven both have the same noise. And s is never so long across the
//! normal that a normal within 60 degrees has a negative value; shaders take the greater of 0 and the value.

use crate::error::Error;
use crate::geom::texel::{TexelMap, TexelSampler};
use crate::geom::world::luminance;
use crate::sample::{Sequence, sequence};
use crate::scene::model::Rgb;
use crate::solve::accumulate::{Gate, Kind, Rejected};
use crate::solve::lightmap::{Solution, Texel, vertex_of};
use crate::solve::monitor::Monitor;
use crate::transport::around::Place;
use crate::transport::{Kernel, Vertex};
use glam::{Vec3, Vec3A};
use rayon::prelude::*;

/// Random numbers belong to this domain and the page; see [`sequence::key`].
const DOMAIN: u64 = 0x4449_0000;

/// Texels of a task.
const CHUNK: usize = 64;

/// Samples, at most, that light straight from suns and lamps is part of.
const STRAIGHT: u32 = 16;

/// The vector s of the module's text over `E / pi`, for each colour channel: its parts along x, y and z, each red, green and blue.
pub type Direction = [Rgb; 3];

/// Gathers `samples` paths for each texel of a solved page; one entry for each covered texel, zero where nothing is seen.
///
/// # Errors
///
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn gather(
    kernel: &Kernel<'_>,
    map: &TexelMap,
    page: usize,
    (samples, seed): (u32, u64),
    solution: &mut Solution,
    monitor: &Monitor,
) -> Result<Vec<Direction>, Error> {
    let mut out = vec![Direction::default(); map.texels.len()];
    let gates: Vec<Gate> = out
        .par_chunks_mut(CHUNK)
        .zip(solution.texels.par_chunks(CHUNK))
        .enumerate()
        .with_max_len(4)
        .map_init(TexelSampler::default, |sampler, (chunk, (out, texels))| {
            let (mut gate, mut rays) = (Gate::default(), 0);
            for (k, (out, texel)) in out.iter_mut().zip(texels).enumerate() {
                if monitor.stopped() {
                    return gate;
                }
                let index = chunk * CHUNK + k;
                sampler.set(map, index);
                let at = Rejected { page, texel: map.texels[index], kind: Kind::Direction, sample: 0 };
                let key = key(page, at.texel, seed);
                *out = of_texel(kernel, sampler, texel, samples, key, (&mut gate, at), &mut rays);
                monitor.report(&gate);
            }
            monitor.add(out.len() as u64 * u64::from(samples), u64::from(rays));
            gate
        })
        .collect();
    if monitor.stopped() {
        return Err(Error::Interrupted);
    }
    solution.gate = gates.into_iter().fold(solution.gate, Gate::merge);
    Ok(out)
}

fn of_texel(
    kernel: &Kernel<'_>,
    sampler: &TexelSampler,
    texel: &Texel,
    samples: u32,
    key: u64,
    (gate, at): (&mut Gate, Rejected),
    rays: &mut u32,
) -> Direction {
    let mut sum = Direction::default();
    // What these paths say of `E`, and the mean normal.
    let (mut flat, mut normals) = (Vec3::ZERO, Vec3A::ZERO);
    for i in 0..samples {
        let mut sequence = Sequence::new(key, i);
        let [a, b, c, d] = sequence.next4();
        let Some(vertex) = vertex_of(kernel, sampler, texel, [a, b]) else { continue };
        let n = vertex.shading_normal;
        normals += n;
        around(kernel, &vertex, [c, d], (i, samples), &mut sequence, rays, &mut |wi, light| {
            let light = gate.admit(light, Rejected { sample: i, ..at });
            let cos = wi.dot(n);
            if 0.0 < cos {
                flat += light * cos;
                for (s, w) in sum.iter_mut().zip(wi.to_array()) {
                    *s += light * w;
                }
            }
        });
    }
    settle(sum, flat, normals.normalize_or_zero())
}

/// What the random numbers of a texel are drawn from.
pub(super) fn key(page: usize, texel: u32, seed: u64) -> u64 {
    sequence::key(seed, DOMAIN + page as u64, u64::from(texel))
}

/// Visits the light of sample `i` of `samples` from before a texel's point.
pub(super) fn around(
    kernel: &Kernel<'_>,
    at: &Vertex,
    u: [f32; 2],
    (i, samples): (u32, u32),
    sequence: &mut Sequence,
    rays: &mut u32,
    visit: &mut dyn FnMut(Vec3A, Rgb),
) {
    let step = (samples / STRAIGHT).max(1);
    let p = at.position + at.geometric_normal * at.offset;
    // The last stands for as many as are left.
    let straight = (i % step == 0).then(|| step.min(samples.saturating_sub(i)) as f32);
    let from = Place { position: p, before: Some(at.geometric_normal), least: 0.0 };
    kernel.sample_around(from, u, straight, sequence, rays, visit);
}

/// The vector of a texel over its `E / pi`, from sums of light times direction and of light times cosine over the same samples.
fn settle(sum: Direction, flat: Rgb, n: Vec3A) -> Direction {
    let mut out = Direction::default();
    for c in 0..3 {
        // The other channels say something of this one where it found nothing.
        let (v, e) = if 0.0 < flat[c] {
            (Vec3A::from(sum.map(|s| s[c])), flat[c])
        } else {
            (Vec3A::from(sum.map(luminance)), luminance(flat))
        };
        // Half along the normal, and across it as much as the samples say.
        let across = if 0.0 < e { (v - n * v.dot(n)) * (0.5 / e) } else { Vec3A::ZERO };
        let across = if across.is_finite() { across.clamp_length_max(0.5 * MOST) } else { Vec3A::ZERO };
        for (out, s) in out.iter_mut().zip((n * 0.5 + across).to_array()) {
            out[c] = s;
        }
    }
    out
}

/// Most of s across the normal, in halves of `E / pi`: for n' at an angle a from n the value is at least (1 + cos a - MOST sin a) / 2 times `E / pi`, which is 0 at
/// 60 degrees for the root of 3.
const MOST: f32 = 1.732_050_8;

#[cfg(test)]
mod tests {
    use super::*;

    /// Light of one direction at 37 degrees and of all directions, from the closed forms of their sums: s over `E / pi` is half of the direction over the cosine.
    #[test]
    fn vectors_of_known_lights() {
        let n = Vec3A::Y;
        let wi = Vec3A::new(0.6, 0.8, 0.0);
        let s = settle(wi.to_array().map(Vec3::splat), Vec3::splat(0.8), n);
        let want = wi * (0.5 / 0.8);
        for (s, w) in s.iter().zip(want.to_array()) {
            assert!((s.x - w).abs() < 1e-6, "{s} {w}");
        }
        let even = [Vec3::ZERO, Vec3::splat(3.0), Vec3::ZERO];
        let s = settle(even, Vec3::splat(3.0), n);
        assert!((s[1].x - 0.5).abs() < 1e-6 && s[0] == Vec3::ZERO, "{s:?}");
        // A beam along the plane would make some normals negative.
        let low = Vec3A::new(0.995, 0.0999, 0.0).to_array().map(Vec3::splat);
        let s = settle(low, Vec3::splat(0.0999), n);
        assert!((s[0].x - MOST * s[1].x).abs() < 1e-6, "{s:?}");
        let turned = Vec3A::new(-0.866_025_4, 0.5, 0.0);
        let value = 1.0 + (0..3).map(|k| s[k].x * (turned - n)[k]).sum::<f32>();
        assert!(value.abs() < 1e-6, "{value}");
    }

    #[test]
    fn dark_channels_take_the_others_direction() {
        let sum = [Vec3::new(1.0, 0.0, 0.0), Vec3::new(2.0, 0.0, 0.0), Vec3::ZERO];
        let s = settle(sum, Vec3::new(2.0, 0.0, 0.0), Vec3A::Y);
        assert!((s[0].y - s[0].x).abs() < 1e-6 && (s[0].x - 0.25).abs() < 1e-6, "{s:?}");
        let black = settle(sum, Vec3::ZERO, Vec3A::Y);
        assert_eq!(black, [Vec3::ZERO, Vec3::splat(0.5), Vec3::ZERO]);
        assert_eq!(settle(sum, Vec3::splat(1e-45), Vec3A::Y)[1], Vec3::splat(0.5));
    }
}
