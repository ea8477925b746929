//! Next-event estimation: light straight from the lights at one vertex.
//!
//! Lights fall in strata that are each sampled once: punctual lights, suns, emissive triangles and
//! the sky. Candela and lux never meet in one distribution, so probabilities do not depend on the
//! unit of length.

use crate::geom::ray::offset_distance;
use crate::geom::{Hit, Ray};
use crate::light::beams::Source;
use crate::light::punctual::Incident;
use crate::sample::Sequence;
use crate::sample::warp::cos_hemisphere_pdf;
use crate::scene::model::Rgb;
use crate::transport::connect::Arrival;
use crate::transport::path::{Kernel, Vertex};
use glam::{Vec3, Vec3A};
use std::f32::consts::FRAC_1_PI;

/// Up to this many punctual lights are all sampled at the receiver; deeper along the path, or if
/// there are more, one is chosen by what it would contribute unshadowed.
const EXHAUSTIVE: usize = 4;

/// Which lights are asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// All of them.
    All,
    /// Suns and lamps: no direction hits them by chance.
    Small,
    /// Emitters and sky.
    Area,
}

impl Kernel<'_> {
    /// `E / pi` straight from the lights at `vertex`, one sample, nits. At the receiver lights whose
    /// direct part is left to the game are left out. `arrival` says how the vertex was found, where
    /// connecting to beams could have found it as well.
    pub(crate) fn direct(
        &self,
        vertex: &Vertex,
        part: Part,
        receiver: bool,
        arrival: Option<Arrival>,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let lights = self.lights;
        let mut sum = Vec3::ZERO;
        let (small, area) = (part != Part::Area, part != Part::Small);
        let punctual = small && !lights.punctual.is_empty();
        let emitters = area && !lights.emitters.is_empty();
        if punctual || emitters {
            let [a, b, c, d] = sequence.next4();
            if punctual {
                sum += self.punctual(vertex, receiver, arrival, a, rays);
            }
            if emitters {
                sum += self.emitters(vertex, b, [c, d], rays);
            }
        }
        let suns = small && !lights.suns.is_empty();
        let sky = area && (lights.sky.is_sampled() || self.sky_guide.is_some()) && !vertex.open;
        if suns || sky {
            let [a, b, c, d] = sequence.next4();
            let asked = if suns { lights.suns.as_slice() } else { &[] };
            for (i, sun) in asked.iter().enumerate() {
                if receiver && sun.indirect_only {
                    continue;
                }
                // Several suns share two numbers, each shifted by another multiple of the golden ratio.
                let shift = i as f32 * 0.618_034;
                let u = [(a + shift).fract(), (b + 2.0 * shift).fract()];
                let light = sun.sample(u);
                let weight = self.chance_weight(arrival, vertex, Source::Sun(i), &light);
                sum += self.lit(vertex, &light, rays) * weight;
            }
            if sky {
                sum += self.sky(vertex, [c, d], rays);
            }
        }
        sum
    }

    fn punctual(
        &self,
        vertex: &Vertex,
        receiver: bool,
        arrival: Option<Arrival>,
        u: f32,
        rays: &mut u32,
    ) -> Rgb {
        let list = &self.lights.punctual;
        let counts = |i: usize| !(receiver && list[i].indirect_only);
        if receiver && list.len() <= EXHAUSTIVE {
            return (0..list.len())
                .filter(|&i| counts(i))
                .filter_map(|i| list[i].incident(vertex.position))
                .map(|incident| self.lit(vertex, &incident, rays))
                .sum();
        }
        let weight = |i: usize| {
            if counts(i) { list[i].importance(vertex.position, vertex.shading_normal) } else { 0.0 }
        };
        let total: f32 = (0..list.len()).map(weight).sum();
        if !(0.0 < total && total.is_finite()) {
            return Vec3::ZERO;
        }
        let mut rest = u * total;
        let mut chosen = None;
        for i in 0..list.len() {
            let w = weight(i);
            if 0.0 < w {
                chosen = Some((i, w / total));
                if rest < w {
                    break;
                }
                rest -= w;
            }
        }
        let Some((i, probability)) = chosen else { return Vec3::ZERO };
        list[i].incident(vertex.position).map_or(Vec3::ZERO, |x| {
            let weight = self.chance_weight(arrival, vertex, Source::Punctual(i), &x);
            self.lit(vertex, &x, rays) * (weight / probability)
        })
    }

    /// A light without area, as far as it is not shadowed.
    fn lit(&self, vertex: &Vertex, light: &Incident, rays: &mut u32) -> Rgb {
        let cos = light.wi.dot(vertex.shading_normal);
        if cos <= 0.0 {
            return Vec3::ZERO;
        }
        // A lamp that lies on a surface must not be hidden by that surface's rounding.
        let slack = offset_distance((vertex.position + light.wi * light.distance).abs().max_element());
        let t_max = if light.distance.is_finite() { light.distance - slack } else { f32::INFINITY };
        light.illuminance * (cos * FRAC_1_PI) * self.transmittance(vertex, light.wi, t_max, rays)
    }

    fn emitters(&self, vertex: &Vertex, u: f32, v: [f32; 2], rays: &mut u32) -> Rgb {
        let n = vertex.shading_normal;
        let Some(s) = self.lights.emitters.sample(vertex.position, n, u, v) else { return Vec3::ZERO };
        let cos = s.wi.dot(n);
        if cos <= 0.0 {
            return Vec3::ZERO;
        }
        let emission = self.world.shade(self.scene, s.triangle, s.bary).emission;
        if emission == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let at = self.world.point(s.triangle, s.bary);
        let seen = self.transmittance(vertex, s.wi, s.distance - 2.0 * at.offset, rays);
        let weight = 1.0 / (s.pdf_solid_angle + cos_hemisphere_pdf(cos));
        emission * seen * (cos * FRAC_1_PI * weight)
    }

    fn sky(&self, vertex: &Vertex, u: [f32; 2], rays: &mut u32) -> Rgb {
        let Some((wi, pdf)) = self.sky_direction(vertex, u) else { return Vec3::ZERO };
        let cos = wi.dot(vertex.shading_normal);
        let radiance = self.lights.sky.radiance(wi);
        if cos <= 0.0 || pdf <= 0.0 || radiance == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let seen = self.transmittance(vertex, wi, f32::INFINITY, rays);
        radiance * seen * (cos * FRAC_1_PI / (pdf + cos_hemisphere_pdf(cos)))
    }

    /// A direction towards the sky and its density per steradian: by the pixels of an image, else by
    /// what the pilot learnt.
    fn sky_direction(&self, vertex: &Vertex, u: [f32; 2]) -> Option<(Vec3A, f32)> {
        if let Some(s) = self.lights.sky.sample(u) {
            return Some((s.wi, s.pdf_solid_angle));
        }
        self.sky_guide?.sample(vertex.position, u)
    }

    /// Density per steradian with which next-event estimation at `vertex` chooses the direction `wi`.
    pub(crate) fn sky_density(&self, vertex: &Vertex, wi: Vec3A) -> f32 {
        if vertex.open {
            return 0.0;
        }
        if self.lights.sky.is_sampled() {
            return self.lights.sky.pdf(wi);
        }
        self.sky_guide.map_or(0.0, |g| g.pdf(vertex.position, wi))
    }

    /// Whether nothing at all gets along a ray.
    pub(crate) fn blocked(&self, ray: &Ray) -> bool {
        let opaque = |hit: &Hit| self.world.pass(self.scene, hit.triangle, hit.bary) == Vec3::ZERO;
        0.0 < ray.t_max && self.bvh.occluded(ray, opaque)
    }

    /// What is left of light along a segment after all surfaces and media that it crosses: 0 behind an opaque surface.
    pub(crate) fn transmittance(&self, from: &Vertex, wi: Vec3A, t_max: f32, rays: &mut u32) -> Rgb {
        let left = self.unblocked(from, wi, t_max, rays);
        match self.media {
            Some(media) if left != Vec3::ZERO => {
                left * media.transmittance(from.position, wi, t_max.max(0.0))
            }
            _ => left,
        }
    }

    /// What surfaces leave of light along a segment.
    pub(crate) fn unblocked(&self, from: &Vertex, wi: Vec3A, t_max: f32, rays: &mut u32) -> Rgb {
        let ray: Ray = from.ray(wi, t_max);
        if t_max <= 0.0 {
            return Vec3::ONE;
        }
        *rays += 1;
        let mut left = Vec3::ONE;
        let blocked = self.bvh.occluded(&ray, |hit| {
            left *= self.world.pass(self.scene, hit.triangle, hit.bary);
            left == Vec3::ZERO
        });
        if blocked { Vec3::ZERO } else { left }
    }
}
