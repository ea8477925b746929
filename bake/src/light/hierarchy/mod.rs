//! The lighting grid hierarchy: many point lights on grids of coarser and coarser spacing, blended by distance.
//!
//! \[LGH17\] Yuksel and Yuksel, "Lighting Grid Hierarchy for Self-illuminating Explosions" (ACM TOG 36, 4, 2017). Level 0 holds the lights
//! themselves. On every further level each light is shared among the eight vertices of the cell that it is in (equation 1), whose lights sit
//! at their centres of illumination (equation 2) and know how far what they stand for is spread (equations 4 and 5). What a level
//! brings to a place fades in and out with the distance (section 3.2), so that nothing is decided by a threshold and nothing flickers.
//!
//! The blending functions are a partition of unity in one distance; each level's lights have their own, so that weights summed over levels
//! are off by what differs between these: less with a larger alpha.

pub mod shadows;
#[cfg(test)]
mod tests;

use crate::geom::world::luminance;
use crate::scene::model::Rgb;
use glam::{DVec3, IVec3, Vec3A, ivec3};
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;

/// A point that emits the same in all directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointLight {
    /// Metres.
    pub position: Vec3A,
    /// Candela.
    pub intensity: Rgb,
}

/// A light of a level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridLight {
    /// Centre of illumination, metres.
    pub position: Vec3A,
    /// Candela.
    pub intensity: Rgb,
    /// Standard deviation of the lights that it stands for, along each axis, metres: the root of equation 4.
    pub deviation: Vec3A,
    /// Their mean distance from the centre, metres: equation 5.
    pub size: f32,
    /// The vertex that it belongs to, in spacings from the anchor; none of level 0 has one.
    pub vertex: IVec3,
}

/// What the lights of a level come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Build {
    /// The lights themselves, on every level.
    #[default]
    FromLights,
    /// The level below: quicker, and smoother than the published one.
    FromBelow,
}

/// How a hierarchy is built.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Spacing of level 1, metres; that of level 0 counts as half of it.
    pub spacing: f32,
    /// Radius of influence over spacing; the paper uses 2.
    pub alpha: f32,
    /// Levels above level 0 at most; without it until the lights are within one cell.
    pub levels: Option<usize>,
    /// A vertex of every level, metres: it must not depend on what shines.
    pub anchor: Vec3A,
    /// Where levels come from.
    pub build: Build,
    /// Part of the light of a level below the last that has to be kept; the weakest lights that make up the rest are left out.
    pub keep: f32,
}

/// One level.
#[derive(Clone, Debug)]
pub struct Level {
    /// Distance of vertices, metres.
    pub spacing: f32,
    /// Radius of influence, metres.
    pub radius: f32,
    /// Sorted by bin.
    pub lights: Vec<GridLight>,
    /// Lights that were left out, and the part of the level's light that they were.
    pub pruned: (usize, f64),
    /// Lights by bins with sides of twice the radius.
    bins: HashMap<IVec3, Range<usize>>,
}

/// Point lights by levels.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    levels: Vec<Level>,
    /// Distances below this count as this, metres.
    clamp: f32,
    anchor: Vec3A,
}

/// Most levels above the first: beyond that single precision ends.
const MOST: usize = 20;

/// Sums over the lights of a vertex.
#[derive(Clone, Copy, Default)]
struct Sums {
    intensity: DVec3,
    weight: f64,
    place: DVec3,
    square: DVec3,
    distance: f64,
}

/// The share of a light that a vertex has.
struct Share {
    vertex: IVec3,
    light: usize,
    part: f64,
}

impl Hierarchy {
    /// Builds all levels. Lights that are black are left out.
    #[must_use]
    pub fn new(lights: &[PointLight], options: &Options) -> Self {
        let lit = lights.iter().filter(|l| 0.0 < luminance(l.intensity));
        let first: Vec<GridLight> = lit
            .map(|l| GridLight {
                position: l.position,
                intensity: l.intensity,
                deviation: Vec3A::ZERO,
                size: 0.0,
                vertex: IVec3::ZERO,
            })
            .collect();
        let (low, high) = bounds(&first);
        let extent = if first.is_empty() { 0.0 } else { (high - low).max_element() };
        let above = options
            .levels
            .unwrap_or_else(|| (1..=MOST).find(|l| extent <= spacing(options.spacing, *l)).unwrap_or(MOST));
        let mut all = vec![first];
        match options.build {
            Build::FromLights => {
                let more: Vec<_> = (1..=above.min(MOST))
                    .into_par_iter()
                    .map(|l| gathered(&all[0], spacing(options.spacing, l), options.anchor))
                    .collect();
                all.extend(more);
            }
            Build::FromBelow => {
                for l in 1..=above.min(MOST) {
                    all.push(gathered(&all[l - 1], spacing(options.spacing, l), options.anchor));
                }
            }
        }
        let last = all.len() - 1;
        let levels = all.into_iter().enumerate().map(|(l, lights)| {
            let keep = if l == last { 1.0 } else { options.keep };
            Level::new(lights, spacing(options.spacing, l), options.alpha, keep)
        });
        Self { levels: levels.collect(), clamp: spacing(options.spacing, 0), anchor: options.anchor }
    }

    /// All levels, the finest first.
    #[must_use]
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// Distances below this count as this, metres.
    #[must_use]
    pub fn clamp(&self) -> f32 {
        self.clamp
    }

    /// Weight of a level at a distance: rises from 0 at the radius of the level below to 1 at its own (but on the first), and falls to 0 at that of the
    /// level above (but on the last).
    #[must_use]
    pub fn blend(&self, level: usize, distance: f32) -> f32 {
        let r = |l: usize| self.levels[l].radius;
        let rises = match level {
            0 => 1.0,
            l => ((distance - r(l - 1)) / (r(l) - r(l - 1))).clamp(0.0, 1.0),
        };
        let falls = if level + 1 == self.levels.len() {
            1.0
        } else {
            1.0 - ((distance - r(level)) / (r(level + 1) - r(level))).clamp(0.0, 1.0)
        };
        // One of them is 1.
        rises.min(falls)
    }

    /// Calls `visit` with level, number in it, light, distance and weight of every light that counts at a place. In a fixed order.
    #[inline]
    pub fn visit(&self, place: Vec3A, mut visit: impl FnMut(usize, usize, &GridLight, f32, f32)) {
        let last = self.levels.len() - 1;
        for (l, level) in self.levels.iter().enumerate() {
            let mut each = |range: Range<usize>| {
                for i in range {
                    let light = &level.lights[i];
                    let distance = light.position.distance(place);
                    let weight = self.blend(l, distance);
                    if 0.0 < weight {
                        visit(l, i, light, distance, weight);
                    }
                }
            };
            if l == last {
                each(0..level.lights.len());
                continue;
            }
            let side = level.bin();
            let (low, high) = (bin(place - side, side), bin(place + side, side));
            for z in low.z..=high.z {
                for y in low.y..=high.y {
                    for x in low.x..=high.x {
                        if let Some(range) = level.bins.get(&ivec3(x, y, z)) {
                            each(range.clone());
                        }
                    }
                }
            }
        }
    }

    /// For each light of a level above the first, which lights of the level below it stands for, and how much they bring: luminance times share.
    #[must_use]
    pub(super) fn parts(&self, level: usize) -> Vec<Vec<(usize, f32)>> {
        let (here, below) = (&self.levels[level], &self.levels[level - 1].lights);
        let numbers: HashMap<IVec3, usize> =
            here.lights.iter().enumerate().map(|(i, l)| (l.vertex, i)).collect();
        let mut parts = vec![Vec::new(); here.lights.len()];
        for s in shares(below, here.spacing, self.anchor) {
            if let Some(i) = numbers.get(&s.vertex) {
                #[expect(clippy::cast_possible_truncation, reason = "a share")]
                let part = s.part as f32 * luminance(below[s.light].intensity);
                parts[*i].push((s.light, part));
            }
        }
        parts
    }

    /// What arrives at a place from all around, lux on a surface that faces every light: brute force where alpha is large.
    #[must_use]
    pub fn unshadowed(&self, place: Vec3A) -> Rgb {
        let mut sum = Rgb::ZERO;
        self.visit(place, |_, _, light, distance, weight| {
            sum += light.intensity * (weight * self.falloff(distance));
        });
        sum
    }

    /// The inverse square of a distance, clamped; 1/m^2.
    #[must_use]
    #[inline]
    pub fn falloff(&self, distance: f32) -> f32 {
        let d = distance.max(self.clamp);
        (d * d).recip()
    }

    /// Bytes of lights and bins.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let of = |l: &Level| l.lights.len() * size_of::<GridLight>() + l.bins.len() * 64;
        self.levels.iter().map(|l| of(l) as u64).sum()
    }
}

impl Level {
    fn new(mut lights: Vec<GridLight>, spacing: f32, alpha: f32, keep: f32) -> Self {
        let pruned = prune(&mut lights, keep);
        let mut level = Self { spacing, radius: alpha * spacing, lights, pruned, bins: HashMap::new() };
        let side = level.bin();
        let key = |l: &GridLight| bin(l.position, side).to_array();
        level.lights.sort_by_key(key);
        let mut from = 0;
        for chunk in level.lights.chunk_by(|a, b| key(a) == key(b)) {
            level.bins.insert(bin(chunk[0].position, side), from..from + chunk.len());
            from += chunk.len();
        }
        level
    }

    /// Side of a bin: how far lights of the level reach.
    fn bin(&self) -> f32 {
        2.0 * self.radius
    }
}

fn bin(place: Vec3A, side: f32) -> IVec3 {
    (place / side).floor().as_ivec3()
}

/// Spacing of a level, of that of level 1.
fn spacing(first: f32, level: usize) -> f32 {
    first * 2f32.powi(i32::try_from(level).unwrap_or(i32::MAX) - 1)
}

fn bounds(lights: &[GridLight]) -> (Vec3A, Vec3A) {
    let none = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    lights.iter().fold(none, |(a, b), l| (a.min(l.position), b.max(l.position)))
}

/// Leaves out the weakest lights that together are no more than what need not be kept. Returns how many, and their part.
fn prune(lights: &mut Vec<GridLight>, keep: f32) -> (usize, f64) {
    let each = |l: &GridLight| f64::from(luminance(l.intensity));
    let total: f64 = lights.iter().map(each).sum();
    let mut order: Vec<usize> = (0..lights.len()).collect();
    order.sort_by(|a, b| each(&lights[*a]).total_cmp(&each(&lights[*b])));
    let (mut gone, mut sum) = (vec![false; lights.len()], 0.0);
    for i in order {
        let more = sum + each(&lights[i]);
        if (1.0 - f64::from(keep)) * total < more {
            break;
        }
        sum = more;
        gone[i] = true;
    }
    let n = gone.iter().filter(|g| **g).count();
    let mut k = 0;
    lights.retain(|_| {
        k += 1;
        !gone[k - 1]
    });
    (n, if 0.0 < total { sum / total } else { 0.0 })
}

/// The shares that vertices `h` apart have of lights, vertex by vertex, and for each in the order of the lights.
fn shares(lights: &[GridLight], h: f32, anchor: Vec3A) -> Vec<Share> {
    let mut shares: Vec<Share> = lights
        .par_iter()
        .enumerate()
        .flat_map_iter(|(light, l)| {
            let at = (l.position - anchor).as_dvec3() / f64::from(h);
            let (cell, t) = (at.floor().as_ivec3(), at - at.floor());
            (0..8).filter_map(move |corner: i32| {
                let bits = ivec3(corner & 1, corner >> 1 & 1, corner >> 2 & 1);
                let one = |bit: i32, t: f64| if bit == 1 { t } else { 1.0 - t };
                let part = one(bits.x, t.x) * one(bits.y, t.y) * one(bits.z, t.z);
                (0.0 < part).then_some(Share { vertex: cell + bits, light, part })
            })
        })
        .collect();
    // Stable.
    shares.par_sort_by_key(|s| s.vertex.to_array());
    shares
}

/// The lights of vertices `h` apart.
fn gathered(lights: &[GridLight], h: f32, anchor: Vec3A) -> Vec<GridLight> {
    let shares = shares(lights, h, anchor);
    let each = |shares: &[Share]| {
        let mut sums = Sums::default();
        for s in shares {
            let l = &lights[s.light];
            let (weight, p) = (s.part * f64::from(luminance(l.intensity)), l.position.as_dvec3());
            sums.intensity += l.intensity.as_dvec3() * s.part;
            sums.weight += weight;
            sums.place += p * weight;
        }
        let centre = sums.place / sums.weight;
        for s in shares {
            let l = &lights[s.light];
            let (weight, off) = (s.part * f64::from(luminance(l.intensity)), l.position.as_dvec3() - centre);
            // Around the centre: the published difference of squares would cancel. What lights of the level below stand for is spread as well.
            sums.square += (off * off + l.deviation.as_dvec3().powf(2.0)) * weight;
            sums.distance += off.length().hypot(f64::from(l.size)) * weight;
        }
        GridLight {
            position: centre.as_vec3a(),
            intensity: sums.intensity.as_vec3(),
            deviation: (sums.square / sums.weight).map(f64::sqrt).as_vec3a(),
            #[expect(clippy::cast_possible_truncation, reason = "a length")]
            size: (sums.distance / sums.weight) as f32,
            vertex: shares[0].vertex,
        }
    };
    let vertices: Vec<&[Share]> = shares.chunk_by(|a, b| a.vertex == b.vertex).collect();
    vertices.into_par_iter().map(each).collect()
}
