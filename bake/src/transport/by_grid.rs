//! Light of many lights in a hierarchy: all that they bring unhindered, and rays to a few of them that say how much of it is.
//!
//! \[LGH17\] section 6.3 sends rays to places around the middle of a light, spread as what it stands for. Here they go to one of the lights of level 0 that it stands for, in proportion to what these
//! bring: no ray ends within a wall between them, and what is hidden is as much as in truth.

use crate::geom::ray::offset_distance;
use crate::geom::world::luminance;
use crate::light::hierarchy::{Arriving, GridLights};
use crate::scene::model::Rgb;
use crate::transport::path::{Kernel, Vertex};
use glam::{Vec3, Vec3A};
use std::f32::consts::FRAC_1_PI;

/// Rays at most.
const MOST: usize = 16;

/// Fraction of the golden ratio, by which numbers of several rays are apart.
const GOLDEN: f64 = 0.618_033_988_75;

/// What is left of light in a direction up to a distance in metres, with the number of rays.
pub(crate) type Seen<'a> = dyn Fn(Vec3A, f32, &mut u32) -> Rgb + 'a;

/// A light that was chosen, and its colour: with the sign of what it brings, of luminance 1.
#[derive(Clone, Copy)]
struct Pick {
    level: usize,
    number: usize,
    colour: Rgb,
}

/// A few of all lights that come by, each with chances in proportion to what it brings.
struct Picks<const N: usize> {
    total: f32,
    rest: [f32; N],
    picks: [Option<Pick>; N],
}

impl<const N: usize> Picks<N> {
    fn offer(&mut self, a: &Arriving<'_>, n: usize, light: Rgb) {
        let weight = luminance(light).abs();
        if weight == 0.0 {
            return;
        }
        self.total += weight;
        if !self.total.is_finite() {
            return;
        }
        let chance = weight / self.total;
        for (rest, pick) in self.rest[..n].iter_mut().zip(&mut self.picks) {
            if *rest < chance {
                *pick = Some(Pick { level: a.level, number: a.number, colour: light / weight });
                *rest /= chance;
            } else {
                *rest = (*rest - chance) / (1.0 - chance);
            }
        }
    }
}

/// What a place gets of lights in a hierarchy, all together unhindered, and each of `n` that are chosen brings its direction, how far it is and what it stands for, of which `cosine` is a part by the direction.
pub(crate) fn pick<L: GridLights>(
    lights: &L,
    place: Vec3A,
    (n, [u, v, w]): (usize, [f32; 3]),
    cosine: impl Fn(Vec3A) -> f32,
    mut visit: impl FnMut(Vec3A, Rgb),
) -> f32 {
    let n = n.clamp(1, MOST);
    let rest = std::array::from_fn(|k| (u + k as f32 / n as f32).fract());
    let mut picks = Picks::<MOST> { total: 0.0, rest, picks: [None; MOST] };
    lights.visit(place, |a| {
        let cos = cosine(a.wi);
        if 0.0 < cos {
            picks.offer(a, n, a.illuminance * cos);
        }
    });
    if !picks.total.is_finite() {
        // Nothing can be chosen by such weights: it is for the gate to count.
        return picks.total;
    }
    for (k, pick) in picks.picks[..n].iter().flatten().enumerate() {
        let turn = f64::from(v) + f64::from(w) / 8_388_608.0 + k as f64 * GOLDEN;
        let light = lights.hierarchy().one_of(pick.level, pick.number, turn.fract());
        visit(light.position, pick.colour * (picks.total / n as f32));
    }
    picks.total
}

impl<const AIR: bool> Kernel<'_, AIR> {
    /// `E / pi` of lights in a hierarchy, of which `n` are asked what is in their way, nits.
    #[inline(never)]
    pub(crate) fn lit_by<L: GridLights>(
        &self,
        lights: &L,
        vertex: &Vertex,
        numbers: (usize, [f32; 3]),
        seen: &Seen<'_>,
        rays: &mut u32,
    ) -> Rgb {
        let cosine = |wi: Vec3A| {
            if wi.dot(vertex.geometric_normal) <= 0.0 { 0.0 } else { wi.dot(vertex.shading_normal) }
        };
        let mut sum = Vec3::ZERO;
        let total = pick(lights, vertex.position, numbers, cosine, |position, light| {
            let way = position - vertex.position;
            // What lies behind the surface is hidden by it.
            if way.dot(vertex.geometric_normal) <= 0.0 {
                return;
            }
            let distance = way.length();
            // One that lies on a surface must not be hidden by that surface's rounding.
            let slack = offset_distance(position.abs().max_element());
            sum += light * FRAC_1_PI * seen(way / distance, distance - slack, rays);
        });
        if total.is_finite() { sum } else { Vec3::splat(total) }
    }
}
