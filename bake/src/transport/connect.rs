//! Connecting path vertices to where a beam of light landed: see [`crate::light::beams`].

use crate::geom::Ray;
use crate::light::beams::{Beam, Source};
use crate::light::punctual::Incident;
use crate::media::{Media, Responses};
use crate::sample::Sequence;
use crate::sample::warp::cos_hemisphere_pdf;
use crate::scene::model::Rgb;
use crate::transport::encounter::Onward;
use crate::transport::path::{Kernel, MAX_LAYERS, Vertex};
use glam::{Vec3, Vec3A};
use std::f32::consts::FRAC_1_PI;

/// Where a beam landed and what it makes shine there.
#[derive(Clone, Copy, Debug)]
pub struct LightVertex {
    vertex: Vertex,
    /// Radiance that the place reflects of the beam's light, nits; not yet divided by `density`.
    radiance: Rgb,
    /// Density per area of beams of this light at the place.
    density: f32,
}

/// Between two vertices of a path: density per area at the second with which the first one's
/// directions find it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrival {
    pub(crate) density: f32,
}

/// What media leave of light between two vertices; apart, with the way there worked out again, so that scenes without media carry nothing of it.
#[inline(never)]
fn weakened_between(media: &Media, to: &Vertex, from: &Vertex, left: Rgb) -> Rgb {
    if left == Vec3::ZERO {
        return left;
    }
    let d = from.position - to.position;
    let distance = d.length_squared().sqrt();
    left * media.transmittance(to.position, d / distance, (distance - 2.0 * from.offset).max(0.0))
}

impl<const AIR: bool> Kernel<'_, AIR> {
    /// Sends a beam and finds where it lands; `None` if it leaves the scene or is absorbed.
    pub(crate) fn beam(&self, sequence: &mut Sequence, rays: &mut u32) -> Option<LightVertex> {
        let beams = self.beams?;
        let [a, b, c, _] = sequence.next4();
        let [d, e, _, _] = sequence.next4();
        let beam = beams.sample(&self.lights.suns, &self.lights.punctual, [a, b, c], [d, e])?;
        self.land(&beam, sequence, rays)
    }

    /// Follows a beam to where its light is reflected first.
    pub(crate) fn land(&self, beam: &Beam, sequence: &mut Sequence, rays: &mut u32) -> Option<LightVertex> {
        let beams = self.beams?;
        let mut ray = Ray { origin: beam.origin, direction: beam.direction, t_max: f32::INFINITY };
        let mut through = Vec3::ONE;
        for _ in 0..MAX_LAYERS {
            *rays += 1;
            let hit = self.closest(&ray)?;
            let (vertex, reflectance) = match self.encounter(&hit, ray.direction).onward(sequence) {
                Onward::Absorbed => return None,
                Onward::Through { tint, origin } => {
                    through *= tint;
                    ray.origin = origin;
                    continue;
                }
                Onward::Reflected { vertex, reflectance } => (vertex, through * reflectance),
            };
            let light = self.incident(beam, vertex.position)?;
            let cos = light.wi.dot(vertex.shading_normal);
            if cos <= 0.0 {
                return None;
            }
            let arriving = match (self.media(), self.responses()) {
                (None, _) => Vec3::splat(cos * FRAC_1_PI),
                (Some(media), None) => {
                    media.transmittance(vertex.position, light.wi, light.distance) * (cos * FRAC_1_PI)
                }
                (_, Some(responses)) => self.lamp_through(responses, &vertex, &light, cos),
            };
            let radiance = light.illuminance * reflectance * arriving;
            let density = beams.area_density(&self.lights.suns, beam.source, &light, vertex.position, cos);
            return (radiance != Vec3::ZERO && 0.0 < density).then_some(LightVertex {
                vertex,
                radiance,
                density,
            });
        }
        None
    }

    fn incident(&self, beam: &Beam, p: Vec3A) -> Option<Incident> {
        match beam.source {
            Source::Punctual(i) => self.lights.punctual[i].incident(p),
            Source::Sun(i) => {
                let sun = &self.lights.suns[i];
                Some(Incident { wi: -beam.direction, ..sun.sample([0.5; 2]) })
            }
        }
    }

    /// `E / pi` that `to` receives by reflection at the place where the beam landed, weighed against
    /// finding that place by chance, nits.
    #[inline]
    pub(crate) fn connect(&self, to: &Vertex, light: &LightVertex, rays: &mut u32) -> Rgb {
        match self.responses() {
            None => self.connect_straight(to, light, rays),
            Some(responses) => self.connect_through(responses, to, light, rays),
        }
    }

    #[inline(never)]
    fn connect_straight(&self, to: &Vertex, light: &LightVertex, rays: &mut u32) -> Rgb {
        let from = &light.vertex;
        let d = from.position - to.position;
        let distance2 = d.length_squared();
        let distance = distance2.sqrt();
        let wi = d / distance;
        let (receiver, reflector) = (wi.dot(to.shading_normal), -wi.dot(from.shading_normal));
        // What a diffuse reflector sends is seen only from in front of its plane.
        let seen = 0.0 < receiver && 0.0 < reflector && 0.0 < -wi.dot(from.geometric_normal);
        if !(seen && wi.is_finite()) {
            return Vec3::ZERO;
        }
        let by_chance = cos_hemisphere_pdf(receiver) * (reflector / distance2);
        let factor = by_chance / (light.density + by_chance);
        if factor <= 0.0 {
            return Vec3::ZERO;
        }
        let left = self.unblocked(to, wi, distance - 2.0 * from.offset, rays);
        let left = match self.media() {
            None => left,
            Some(media) => weakened_between(media, to, from, left),
        };
        light.radiance * left * factor
    }

    /// The same by way of media as tables see them, which scatter what passes along the planes as well.
    #[inline(never)]
    fn connect_through(
        &self,
        responses: &Responses,
        to: &Vertex,
        light: &LightVertex,
        rays: &mut u32,
    ) -> Rgb {
        let d = light.vertex.position - to.position;
        let distance2 = d.length_squared();
        let distance = distance2.sqrt();
        let wi = d / distance;
        let (receiver, reflector) = (wi.dot(to.shading_normal), -wi.dot(light.vertex.shading_normal));
        let from = &light.vertex;
        let seen = to.faces(wi, distance) && from.faces(-wi, distance);
        if !(seen && wi.is_finite()) {
            return Vec3::ZERO;
        }
        let reflector = reflector.max(0.0);
        let geometry = reflector / distance2;
        let by_chance = cos_hemisphere_pdf(receiver.max(0.0)) * geometry;
        let density = light.density + by_chance;
        let t_max = distance - 2.0 * light.vertex.offset;
        let left = self.unblocked(to, wi, t_max, rays);
        if left == Vec3::ZERO {
            return left;
        }
        let clear = receiver.max(0.0) * reflector / distance2;
        let normal = light.vertex.geometric_normal;
        let spread = self.patch_spread(responses, to, wi, distance, normal, clear);
        light.radiance * left * spread / density
    }

    /// Weight of finding by chance that light from `source` lands at `vertex`, against connecting to a
    /// beam.
    pub(crate) fn chance_weight(
        &self,
        arrival: Option<Arrival>,
        vertex: &Vertex,
        source: Source,
        light: &Incident,
    ) -> f32 {
        let (Some(beams), Some(arrival)) = (self.beams, arrival) else { return 1.0 };
        let cos = light.wi.dot(vertex.shading_normal);
        let beam = beams.area_density(&self.lights.suns, source, light, vertex.position, cos.max(0.0));
        let weight = arrival.density / (arrival.density + beam);
        if weight.is_finite() { weight } else { 1.0 }
    }

    /// How much a beam brings to receivers, for the pilot: mean luminance of the connections with the
    /// density they would have with all cells alike.
    pub(crate) fn worth(&self, light: &LightVertex, receivers: &[Vertex]) -> f64 {
        let mut rays = 0;
        let sum: f64 = receivers
            .iter()
            .map(|r| f64::from(crate::geom::world::luminance(self.connect(r, light, &mut rays))))
            .sum();
        sum / receivers.len().max(1) as f64
    }
}
