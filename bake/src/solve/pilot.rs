//! Learns which beams of light are worth following ([`crate::light::beams`]) and where the sky is seen
//! ([`crate::light::sky_guide`]).

use crate::geom::world::luminance;
use crate::light::beams::Beams;
use crate::light::sky_guide::{DIRECTIONS, Regions, SkyGuide, region_key};
use crate::sample::{Sequence, sequence};
use crate::transport::connect::LightVertex;
use crate::transport::{Kernel, Vertex};
use glam::{Vec3, Vec3A};
use rayon::prelude::*;

/// Random numbers of the pilot belong to this domain; see [`sequence::key`].
const DOMAIN: u64 = 0x5049;

/// Beams sent through each cell.
const BEAMS: u32 = 4;

/// Points that stand for the surfaces of a scene.
const RECEIVER_POINTS: u32 = 1 << 14;

/// Receivers each of them is connected to.
const RECEIVERS: usize = 4;

/// What a pilot learnt.
#[derive(Clone, Debug, Default)]
pub struct Learnt {
    /// Beams of suns and lamps.
    pub beams: Option<Beams>,
    /// Directions of the sky.
    pub sky_guide: Option<SkyGuide>,
    /// Where beams landed.
    landed: Vec<Option<LightVertex>>,
}

impl Learnt {
    /// Learns for the given receivers, from `kernel` without its beams and guide.
    #[must_use]
    pub fn new(kernel: &Kernel<'_>, receivers: &[Vertex], seed: u64) -> Self {
        let beams = beams(kernel, receivers, seed);
        let landed = landed(&Kernel { beams: beams.as_ref(), ..*kernel }, seed);
        Self { beams, sky_guide: sky_guide(kernel, receivers, seed), landed }
    }

    /// As [`Learnt::guide`], for the many texels of a map, which share beams.
    #[must_use]
    pub fn guide_texels<'a>(&'a self, kernel: Kernel<'a>) -> Kernel<'a> {
        Kernel { landed: &self.landed, ..self.guide(kernel) }
    }

    /// `kernel` with what was learnt.
    #[must_use]
    pub fn guide<'a>(&'a self, kernel: Kernel<'a>) -> Kernel<'a> {
        Kernel { beams: self.beams.as_ref(), sky_guide: self.sky_guide.as_ref(), ..kernel }
    }
}

/// Weighs the cells of all lights' beams by what they bring to `receivers`; `None` if the scene has
/// neither suns nor lamps, or nobody receives.
fn beams(kernel: &Kernel<'_>, receivers: &[Vertex], seed: u64) -> Option<Beams> {
    let (suns, punctual) = (&kernel.lights.suns, &kernel.lights.punctual);
    // The corners of the bounding cube lie within this distance.
    let radius = kernel.world.radius * 3f32.sqrt();
    let even = Beams::even(suns.len(), punctual.len(), radius);
    if even.is_empty() || receivers.is_empty() || radius <= 0.0 {
        return None;
    }
    let pilot = Kernel { beams: Some(&even), ..*kernel };
    let scores: Vec<f64> = (0..even.len())
        .into_par_iter()
        .map(|cell| {
            let mut score = 0.0;
            for k in 0..BEAMS {
                let mut s = Sequence::new(sequence::key(seed, DOMAIN, cell as u64), k);
                let [a, b, c, d] = s.next4();
                let beam = even.beam(suns, punctual, cell, [a, b], [c, d]);
                let Some(light) = pilot.land(&beam, &mut s, &mut 0) else { continue };
                let chosen: Vec<Vertex> = (0..RECEIVERS)
                    .map(|_| {
                        let u = s.next4()[0];
                        #[expect(
                            clippy::cast_possible_truncation,
                            clippy::cast_sign_loss,
                            reason = "an index"
                        )]
                        let i = (u * receivers.len() as f32) as usize;
                        receivers[i.min(receivers.len() - 1)]
                    })
                    .collect();
                score += pilot.worth(&light, &chosen);
            }
            score
        })
        .collect();
    let mean = scores.iter().sum::<f64>() / (scores.len() * BEAMS as usize) as f64;
    Some(even.learnt(&smooth(&scores, even.side()), mean))
}

/// Sends beams that many paths share.
fn landed(kernel: &Kernel<'_>, seed: u64) -> Vec<Option<LightVertex>> {
    let n = if kernel.beams.is_some() { LANDED } else { 0 };
    let key = sequence::key(seed, DOMAIN, u64::MAX - 1);
    (0..n).into_par_iter().map(|i| kernel.beam(&mut Sequence::new(key, i), &mut 0)).collect()
}

/// Beams that many paths share: 64 for each path of a texel that takes one of them, so that their own noise is small
/// beside that of a texel.
pub const LANDED: u32 = 1 << 14;

/// Most receivers that look at the sky from one region.
const LOOKOUTS: usize = 6;

/// Looks at the sky from the receivers of each region, in every direction once.
fn sky_guide(kernel: &Kernel<'_>, receivers: &[Vertex], seed: u64) -> Option<SkyGuide> {
    let sky = &kernel.lights.sky;
    if sky.is_black() || sky.is_sampled() {
        return None;
    }
    let world = kernel.world;
    let (lo, hi) = world
        .triangles()
        .flatten()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(lo, hi), v| (lo.min(v), hi.max(v)));
    let regions = Regions::new(lo, hi)?;
    let mut lookouts = vec![Vec::new(); regions.len()];
    for r in receivers {
        let list = &mut lookouts[regions.of(r.position)];
        if list.len() < LOOKOUTS {
            list.push(*r);
        }
    }
    let scores: Vec<Vec<f64>> = lookouts
        .par_iter()
        .enumerate()
        .map(|(region, list)| {
            if list.is_empty() {
                return Vec::new();
            }
            let mut scores = vec![0.0; DIRECTIONS];
            for (k, from) in list.iter().enumerate() {
                for (cell, score) in scores.iter_mut().enumerate() {
                    let key = region_key(seed, (region * DIRECTIONS + cell) as u64);
                    #[expect(clippy::cast_possible_truncation, reason = "a small number")]
                    let u = Sequence::new(key, k as u32).next4();
                    let wi = SkyGuide::direction(cell, [u[0], u[1]]);
                    let cos = wi.dot(from.shading_normal);
                    if 0.0 < cos {
                        let seen = kernel.transmittance(from, wi, f32::INFINITY, &mut 0);
                        *score += f64::from(luminance(seen * sky.radiance(wi)) * cos);
                    }
                }
            }
            scores
        })
        .collect();
    SkyGuide::new(regions, scores)
}

/// Cells borrow from their neighbours and single great scores are cut: with this few beams in a cell
/// its own score is a rough guess, and a cell that is chosen too rarely costs more than one that is
/// chosen too often.
fn smooth(scores: &[f64], side: usize) -> Vec<f64> {
    let positive: Vec<f64> = scores.iter().copied().filter(|s| 0.0 < *s).collect();
    let mean = positive.iter().sum::<f64>() / positive.len().max(1) as f64;
    let cut: Vec<f64> = scores.iter().map(|s| s.min(20.0 * mean)).collect();
    (0..scores.len())
        .map(|i| {
            let (light, within) = (i / (side * side), i % (side * side));
            let (x, y) = (within % side, within / side);
            let mut sum = 0.0;
            let mut n = 0.0;
            for v in y.saturating_sub(1)..(y + 2).min(side) {
                for u in x.saturating_sub(1)..(x + 2).min(side) {
                    sum += cut[(light * side + v) * side + u];
                    n += 1.0;
                }
            }
            // The root tempers the differences: light that matters to few receivers still matters.
            (0.5 * cut[i] + 0.5 * sum / n).sqrt()
        })
        .collect()
}

/// Some thousand points spread over the scene's surfaces by area, on their front sides.
#[must_use]
pub fn receivers(kernel: &Kernel<'_>, wanted: impl Fn(usize) -> bool, seed: u64) -> Vec<Vertex> {
    let world = kernel.world;
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 triangles")]
    let area = |t: usize| {
        if wanted(world.surface(t as u32)) { f64::from(world.area(t as u32)) } else { 0.0 }
    };
    let Some(cdf) = crate::sample::discrete::Cdf::new((0..world.len()).map(area)) else {
        return Vec::new();
    };
    (0..RECEIVER_POINTS)
        .filter_map(|i| {
            let u = Sequence::new(sequence::key(seed, DOMAIN, u64::MAX), i).next4();
            let (t, _) = cdf.sample(u[0]);
            let bary = crate::sample::warp::square_to_triangle([u[1], u[2]]);
            #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 triangles")]
            let at = world.point(t as u32, bary);
            (at.geometric_normal != Vec3A::ZERO).then(|| Vertex::front(&at))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The plan states memory without knowing this module.
    #[test]
    fn the_plan_knows_the_size_of_shared_beams() {
        let bytes = u64::from(LANDED) * size_of::<Option<LightVertex>>() as u64;
        assert_eq!(bytes, crate::plan::memory::SHARED_BEAMS);
    }
}
