//! Light of media that emit, by places that are chosen for it.
//!
//! A place is chosen in proportion to what is emitted there, and all that its direction brings counts
//! ([`Media::emitting_place`]): weighed against directions that surfaces and phase functions choose (\[Vea97\] eq. 9.8).

use crate::geom::Ray;
use crate::geom::ray::offset_distance;
use crate::media::Media;
use crate::sample::warp::cos_hemisphere_pdf;
use crate::scene::model::Rgb;
use crate::transport::path::{Kernel, MAX_LAYERS, Vertex};
use glam::{Vec3, Vec3A};
use std::f32::consts::FRAC_1_PI;

impl<const AIR: bool> Kernel<'_, AIR> {
    /// `E / pi` of media that emit, one sample, nits.
    #[inline(never)]
    pub(crate) fn fire(&self, media: &Media, vertex: &Vertex, u: [f32; 4], rays: &mut u32) -> Rgb {
        let Some(place) = media.emitting_place(u) else { return Vec3::ZERO };
        let wi = (place - vertex.position).normalize_or_zero();
        let cos = wi.dot(vertex.shading_normal);
        if cos <= 0.0 || wi.dot(vertex.geometric_normal) < 0.0 {
            return Vec3::ZERO;
        }
        let pdf = media.emitting_pdf(vertex.position, wi);
        if !(0.0 < pdf && pdf.is_finite()) {
            return Vec3::ZERO;
        }
        let light = self.glow_along(media, vertex.ray(wi, f32::INFINITY), rays);
        light * (cos * FRAC_1_PI / (pdf + cos_hemisphere_pdf(cos)))
    }

    /// Radiance that a place in the air scatters back along `direction`, of media that emit, per unit of sigma_s.
    #[inline(never)]
    pub(crate) fn fire_in_air(
        &self,
        media: &Media,
        p: Vec3A,
        (direction, g): (Vec3A, f32),
        u: [f32; 4],
        rays: &mut u32,
    ) -> Rgb {
        let Some(place) = media.emitting_place(u) else { return Vec3::ZERO };
        let wi = (place - p).normalize_or_zero();
        let pdf = media.emitting_pdf(p, wi);
        if !(0.0 < pdf && pdf.is_finite()) {
            return Vec3::ZERO;
        }
        let phase = media.phase(g, wi.dot(direction));
        self.glow_along(media, Ray { origin: p, direction: wi, t_max: f32::INFINITY }, rays)
            * (phase / (pdf + phase))
    }

    /// Radiance of media along a ray, through whatever lets light pass.
    fn glow_along(&self, media: &Media, mut ray: Ray, rays: &mut u32) -> Rgb {
        let (mut sum, mut left) = (Vec3::ZERO, Vec3::ONE);
        for _ in 0..MAX_LAYERS {
            *rays += 1;
            let hit = self.closest(&ray);
            sum += left * media.emitted(ray.origin, ray.direction, hit.map_or(f32::INFINITY, |h| h.t));
            let Some(hit) = hit else { break };
            let pass = self.world.pass(self.scene, hit.triangle, hit.bary);
            if pass == Vec3::ZERO {
                break;
            }
            left *= pass * media.transmittance(ray.origin, ray.direction, hit.t);
            let at = self.world.point(hit.triangle, hit.bary);
            let beyond = if ray.direction.dot(at.geometric_normal) < 0.0 { -1.0 } else { 1.0 };
            let off = at.offset.max(offset_distance(at.position.abs().max_element()));
            ray.origin = at.position + at.geometric_normal * (beyond * off);
        }
        sum
    }

    /// What media leave of light along a ray's first `t` metres.
    pub(crate) fn weaken(&self, origin: Vec3A, direction: Vec3A, t: f32) -> Rgb {
        self.media().map_or(Vec3::ONE, |m| m.transmittance(origin, direction, t))
    }
}
