//! The lighting grid hierarchy: many point lights on grids of coarser and coarser spacing, blended by distance.
//!
//! \[LGH17\] Yuksel and Yuksel, "Lighting Grid Hierarchy for Self-illuminating Explosions" (ACM TOG 36, 4, 2017). Level 0 holds the lights
//! themselves. On every further level each light is shared among the eight vertices of the cell that it is in (equation 1), whose lights sit
//! at their centres of illumination (equation 2) and know how far what they stand for is spread (equations 4 and 5). What a level
//! brings to a place fades in and out with the distance (section 3.2), so that nothing is decided by a threshold and nothing flickers.
//!
//! The published blending functions are a partition of unity in one distance; each level's lights have their own, so that weights summed over levels
//! are off by what differs between these: less with a larger alpha. Where smoke hides all but the near side of a fire this is no noise but a bias, because there each level's lights
//! are deeper inside and so farther away than those of the level below. [`Blend::Conserving`] takes from each light what the lights above it have taken over of it by their
//! own distances: then the weights of all that stands for a light sum to 1 everywhere.

mod quick;
pub mod shadows;
#[cfg(test)]
mod tests;

use crate::geom::world::luminance;
use crate::scene::model::Rgb;
use glam::{DVec3, IVec3, Vec3A, Vec4, ivec3};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
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

/// A light as it counts at a place.
#[derive(Clone, Copy, Debug)]
pub struct Arriving<'a> {
    /// Its level.
    pub level: usize,
    /// Its number there.
    pub number: usize,
    /// The light.
    pub light: &'a GridLight,
    /// Direction towards it.
    pub wi: Vec3A,
    /// Illuminance on a plane that faces it, lux; below 0 where it takes back what lights of other levels bring too much.
    pub illuminance: Rgb,
}

/// Lights in a hierarchy and what is in their way.
pub trait GridLights {
    /// The lights.
    fn hierarchy(&self) -> &Hierarchy;

    /// Calls `visit` with each light that counts at a place, dimmed by what is known beforehand and not by surfaces.
    fn visit(&self, place: Vec3A, visit: impl FnMut(&Arriving<'_>));
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

impl Build {
    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::FromLights => "lights",
            Self::FromBelow => "below",
        }
    }
}

impl Blend {
    /// Name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Published => "published",
            Self::Conserving => "conserving",
        }
    }
}

/// How a light fades where the level above takes over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Blend {
    /// By its own distance, as published.
    Published,
    /// By the distances of the lights above that have shares of it.
    #[default]
    Conserving,
}

/// The nearest that lights count as, so that sums of them stay bounded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Clamp {
    /// Half of the spacing of level 1, for all of them, as published: lights stand for something as wide.
    #[default]
    All,
    /// The same but for lights of level 0, which are as near as they are.
    Above,
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
    /// How levels take over from each other.
    pub blend: Blend,
    /// Which distances are limited.
    pub clamp: Clamp,
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
    /// From where on no light of it counts, metres; without bounds on the last.
    pub reach: f32,
    /// Which lights of the level above have shares of each: their place and the share. None on the last.
    links: Vec<Vec4>,
    /// For each light, where its links begin, and the distance of the farthest of them, metres.
    above: Vec<(u32, f32)>,
    /// Which lights of the level below each stands for, and how much these and all before them of the same light bring: luminance times share. None on the first.
    parts: Vec<(u32, f32)>,
    /// For each light, where its parts begin, with their end after all.
    begins: Vec<u32>,
    /// Lights by bins as wide as it reaches.
    bins: HashMap<IVec3, Range<usize>>,
}

/// Point lights by levels.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    levels: Vec<Level>,
    /// Distances below this count as this, metres.
    clamp: f32,
    clamped: Clamp,
    anchor: Vec3A,
    build: Build,
    blend: Blend,
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
        let places = |l: usize| -> HashMap<IVec3, Vec3A> {
            all.get(l + 1).into_iter().flatten().map(|light| (light.vertex, light.position)).collect()
        };
        let above: Vec<_> = (0..=last).map(places).collect();
        let mut hierarchy = Self {
            levels: Vec::new(),
            clamp: spacing(options.spacing, 0),
            clamped: options.clamp,
            anchor: options.anchor,
            build: options.build,
            blend: options.blend,
        };
        for (l, lights) in all.into_iter().enumerate() {
            let keep = if l == last { 1.0 } else { options.keep };
            let (h, next) = (spacing(options.spacing, l), spacing(options.spacing, l + 1));
            let links = |light: &GridLight| -> Vec<Vec4> {
                let each = hierarchy.shared(l, light, next).into_iter();
                each.filter_map(|(v, part)| above[l].get(&v).map(|p| p.extend(part))).collect()
            };
            let level = Level::new(lights, (h, options.alpha), (keep, options.blend), links);
            hierarchy.levels.push(level);
        }
        for l in 1..hierarchy.levels.len() {
            let parts = hierarchy.parts(l);
            hierarchy.levels[l].stands_for(&parts);
        }
        hierarchy
    }

    /// The spacing of level 1 for lights that come from no grid: that of their bounding box is halved for as long as no more vertices than lights shine (\[LGH17\] section 6.4, which stops one level later, with
    /// more of them than lights).
    #[must_use]
    pub fn spacing_for(lights: &[PointLight], anchor: Vec3A) -> f32 {
        let lit: Vec<Vec3A> =
            lights.iter().filter(|l| 0.0 < luminance(l.intensity)).map(|l| l.position).collect();
        let none = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        let (low, high) = lit.iter().fold(none, |(a, b), p| (a.min(*p), b.max(*p)));
        let extent = if lit.is_empty() { 0.0 } else { (high - low).max_element() };
        // Lights that are all at one place need no levels.
        let mut h = extent.max(1e-3);
        for _ in 0..MOST {
            let vertices: HashSet<IVec3> =
                lit.iter().flat_map(|p| trilinear(*p, 0.5 * h, anchor).map(|(v, _)| v)).collect();
            if lit.len() < vertices.len() {
                break;
            }
            h *= 0.5;
        }
        h
    }

    /// A light of level 0 that one of a level stands for, in proportion to what they bring: its place and deviation.
    #[must_use]
    pub fn one_of(&self, level: usize, number: usize, mut u: f64) -> &GridLight {
        let mut number = number;
        for l in (1..=level).rev() {
            let here = &self.levels[l];
            let parts = &here.parts[here.begins[number] as usize..here.begins[number + 1] as usize];
            let Some((_, total)) = parts.last() else { return &here.lights[number] };
            let at = u * f64::from(*total);
            let k = parts.partition_point(|(_, sum)| f64::from(*sum) <= at).min(parts.len() - 1);
            let before = k.checked_sub(1).map_or(0.0, |k| f64::from(parts[k].1));
            u = ((at - before) / (f64::from(parts[k].1) - before)).clamp(0.0, 1.0);
            number = parts[k].0 as usize;
        }
        &self.levels[0].lights[number]
    }

    /// The vertices of the level above, `next` apart, that have shares of a light of a level, and these.
    ///
    /// Shares of level 0 are those of its place. Of lights on vertices that are built of level 0 as well they are those of the vertex, wherever in its cells the light is: a trilinear weight of
    /// the coarser grid is a sum of such of the finer one, with 1 for the vertex both have, and half of that for each axis along which it is beside.
    fn shared(&self, level: usize, light: &GridLight, next: f32) -> Vec<(IVec3, f32)> {
        if level == 0 || self.build == Build::FromBelow {
            #[expect(clippy::cast_possible_truncation, reason = "a share")]
            return trilinear(light.position, next, self.anchor).map(|(v, part)| (v, part as f32)).collect();
        }
        let odd = light.vertex & 1;
        let below = light.vertex.div_euclid(IVec3::splat(2));
        let part = 0.5f32.powi(odd.element_sum());
        let corner = |k: i32| ivec3(k & 1, k >> 1 & 1, k >> 2 & 1);
        (0..8).map(corner).filter(|c| c.cmple(odd).all()).map(|c| (below + c, part)).collect()
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
            l => ramp(distance, r(l - 1), r(l)),
        };
        let falls =
            if level + 1 == self.levels.len() { 1.0 } else { 1.0 - ramp(distance, r(level), r(level + 1)) };
        // One of them is 1.
        rises.min(falls)
    }

    /// Weight of a light at a place that is so far away. Where levels are [`Blend::Conserving`] it may be less than 0, where lights above count although this one is too near to.
    #[inline]
    fn weight(&self, level: usize, number: usize, place: Vec3A, distance: f32) -> f32 {
        if self.blend == Blend::Published || level + 1 == self.levels.len() {
            return self.blend(level, distance);
        }
        let here = &self.levels[level];
        let (first, apart) = here.above[number];
        let (near, far) = (here.radius, self.levels[level + 1].radius);
        let rises = match level {
            0 => 1.0,
            l => ramp(distance, self.levels[l - 1].radius, near),
        };
        if distance + apart <= near {
            return rises;
        }
        if far <= distance - apart {
            return 0.0;
        }
        let links = &here.links
            [first as usize..here.above.get(number + 1).map_or(here.links.len(), |a| a.0 as usize)];
        let taken = |link: &Vec4| link.w * ramp(Vec3A::from_vec4(*link).distance(place), near, far);
        rises - links.iter().map(taken).sum::<f32>()
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
                    let weight = self.weight(l, i, place, distance);
                    if weight != 0.0 {
                        visit(l, i, light, distance, weight);
                    }
                }
            };
            if l == last {
                each(0..level.lights.len());
                continue;
            }
            let side = level.reach;
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
    fn parts(&self, level: usize) -> Vec<Vec<(usize, f32)>> {
        let (here, below) = (&self.levels[level], &self.levels[level - 1].lights);
        let numbers: HashMap<IVec3, usize> =
            here.lights.iter().enumerate().map(|(i, l)| (l.vertex, i)).collect();
        let mut parts = vec![Vec::new(); here.lights.len()];
        for (child, light) in below.iter().enumerate() {
            for (vertex, part) in self.shared(level - 1, light, here.spacing) {
                if let Some(i) = numbers.get(&vertex) {
                    parts[*i].push((child, part * luminance(light.intensity)));
                }
            }
        }
        parts
    }

    /// What arrives at a place from all around, lux on a surface that faces every light: brute force where alpha is large.
    #[must_use]
    pub fn unshadowed(&self, place: Vec3A) -> Rgb {
        let mut sum = Rgb::ZERO;
        self.visit(place, |level, _, light, distance, weight| {
            sum += light.intensity * (weight * self.falloff(level, distance));
        });
        sum
    }

    /// The inverse square of a distance to a light of a level, clamped; 1/m^2.
    #[must_use]
    #[inline]
    pub fn falloff(&self, level: usize, distance: f32) -> f32 {
        let near = self.clamped == Clamp::Above && level == 0;
        let d = if near { distance } else { distance.max(self.clamp) };
        (d * d).recip()
    }

    /// Bytes of lights and bins.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let of = |l: &Level| {
            l.lights.len() * size_of::<GridLight>()
                + l.links.len() * 16
                + l.above.len() * 8
                + l.parts.len() * 8
                + l.begins.len() * 4
                + l.bins.len() * 64
        };
        self.levels.iter().map(|l| of(l) as u64).sum()
    }
}

/// From 0 at `from` to 1 at `to`.
#[inline]
fn ramp(at: f32, from: f32, to: f32) -> f32 {
    ((at - from) / (to - from)).clamp(0.0, 1.0)
}

impl Level {
    fn new(
        mut lights: Vec<GridLight>,
        (spacing, alpha): (f32, f32),
        (keep, blend): (f32, Blend),
        links: impl Fn(&GridLight) -> Vec<Vec4>,
    ) -> Self {
        let pruned = prune(&mut lights, keep);
        let radius = alpha * spacing;
        let apart = |l: &GridLight, links: &[Vec4]| {
            links.iter().map(|p| l.position.distance(Vec3A::from_vec4(*p))).fold(0.0, f32::max)
        };
        let farthest = match blend {
            Blend::Published => 0.0,
            Blend::Conserving => lights.iter().map(|l| apart(l, &links(l))).fold(0.0, f32::max),
        };
        let side = 2.0 * radius + farthest;
        let key = |l: &GridLight| bin(l.position, side).to_array();
        lights.sort_by_key(key);
        let mut level = Self {
            spacing,
            radius,
            pruned,
            reach: side,
            links: Vec::new(),
            above: Vec::new(),
            parts: Vec::new(),
            begins: Vec::new(),
            bins: HashMap::new(),
            lights,
        };
        if blend == Blend::Conserving {
            for l in &level.lights {
                let links = links(l);
                #[expect(clippy::cast_possible_truncation, reason = "at most 8 of fewer than 2^29 lights")]
                level.above.push((level.links.len() as u32, apart(l, &links)));
                level.links.extend(links);
            }
        }
        let mut from = 0;
        for chunk in level.lights.chunk_by(|a, b| key(a) == key(b)) {
            level.bins.insert(bin(chunk[0].position, side), from..from + chunk.len());
            from += chunk.len();
        }
        level
    }
}

impl Level {
    /// Keeps which lights of the level below its own stand for.
    #[expect(clippy::cast_possible_truncation, reason = "at most 8 parts of fewer than 2^29 lights")]
    fn stands_for(&mut self, parts: &[Vec<(usize, f32)>]) {
        for parts in parts {
            self.begins.push(self.parts.len() as u32);
            let mut sum = 0.0;
            self.parts.extend(parts.iter().map(|(child, part)| {
                sum += part;
                (*child as u32, sum)
            }));
        }
        self.begins.push(self.parts.len() as u32);
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

/// The vertices `h` apart around a place, and the share that each has of what is there.
fn trilinear(place: Vec3A, h: f32, anchor: Vec3A) -> impl Iterator<Item = (IVec3, f64)> {
    let at = (place - anchor).as_dvec3() / f64::from(h);
    let (cell, t) = (at.floor().as_ivec3(), at - at.floor());
    (0..8).filter_map(move |corner: i32| {
        let bits = ivec3(corner & 1, corner >> 1 & 1, corner >> 2 & 1);
        let one = |bit: i32, t: f64| if bit == 1 { t } else { 1.0 - t };
        let part = one(bits.x, t.x) * one(bits.y, t.y) * one(bits.z, t.z);
        (0.0 < part).then_some((cell + bits, part))
    })
}

/// The shares that vertices `h` apart have of lights, vertex by vertex, and for each in the order of the lights.
fn shares(lights: &[GridLight], h: f32, anchor: Vec3A) -> Vec<Share> {
    let mut shares: Vec<Share> = lights
        .par_iter()
        .enumerate()
        .flat_map_iter(|(light, l)| {
            trilinear(l.position, h, anchor).map(move |(vertex, part)| Share { vertex, light, part })
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
