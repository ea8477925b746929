//! Light from all directions at a place in the air: what light probes are made of.
//!
//! The same paths as those of lightmaps and of the nodes of the light grid, but that they start in no plane. Directional lightmaps ask for the half of these directions
//! that is before their surface.

use crate::geom::ray::offset_distance;
use crate::geom::{Hit, Ray};
use crate::sample::Sequence;
use crate::scene::model::Rgb;
use crate::transport::airlight::in_air;
use crate::transport::by_grid::pick;
use crate::transport::lamps::Patches;
use crate::transport::path::{Kernel, Vertex};
use glam::{Vec3, Vec3A};
use std::f32::consts::{FRAC_1_PI, PI};

/// What [`Kernel::sample_around`] finds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finds {
    /// Radiance times steradian, which sums to the integral of radiance over all directions.
    Radiance,
    /// `E / pi` of a surface that faces that way, times steradian: with tables light of media has no single direction.
    Irradiance,
}

/// Places in the air keep this part of their distance from what is behind them.
const NEXT_TO: f32 = 0.95;

/// Where light is looked for in the air.
#[derive(Clone, Copy, Debug)]
pub struct Place {
    /// Metres relative to [`crate::geom::World::origin`].
    pub position: Vec3A,
    /// A unit normal, where only what comes from its side is asked for.
    pub before: Option<Vec3A>,
    /// Lamps that are nearer shine as from this distance, metres; not for [`Finds::Irradiance`].
    pub least: f32,
}

/// What a ray from a place in the air met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Met {
    /// How far away, metres.
    pub distance: f32,
    /// Unit normal of its front.
    pub normal: Vec3A,
    /// Whether it was seen from its front.
    pub front: bool,
    /// Whether it has two.
    pub double_sided: bool,
}

impl<const AIR: bool> Kernel<'_, AIR> {
    /// What [`Kernel::sample_around`] gives to `visit`.
    #[must_use]
    pub fn finds_around(&self) -> Finds {
        if self.responses().is_some() { Finds::Irradiance } else { Finds::Radiance }
    }

    /// See [`Kernel::sample_around`].
    pub(crate) fn sample(
        &self,
        Place { position: p, before, least }: Place,
        u: [f32; 2],
        straight: Option<f32>,
        sequence: &mut Sequence,
        rays: &mut u32,
        visit: &mut dyn FnMut(Vec3A, Rgb),
    ) {
        let (wi, pdf) = match before {
            None => (square_to_sphere(u), 0.25 * FRAC_1_PI),
            Some(n) => {
                let d = square_to_sphere(u);
                // The sphere folded onto the hemisphere.
                (if d.dot(n) < 0.0 { -d } else { d }, 0.5 * FRAC_1_PI)
            }
        };
        let visit = &mut |wi: Vec3A, light: Rgb| {
            if before.is_none_or(|n| 0.0 < wi.dot(n)) {
                visit(wi, light);
            }
        };
        if self.finds_around() == Finds::Irradiance {
            let at = Vertex {
                position: p,
                geometric_normal: wi,
                shading_normal: wi,
                offset: offset_distance(p.abs().max_element()),
                open: false,
                detached: true,
            };
            let [a, b, _, _] = sequence.next4();
            let e = self.whole(&at, [a, b], sequence);
            *rays += e.rays;
            visit(wi, (e.direct + e.indirect) / pdf);
            return;
        }
        let from = in_air(p);
        let scattering = self.media().filter(|_| self.scatters());
        let light = match scattering {
            Some(media) => self.arrives_through_media(media, (p, wi), sequence, rays),
            None => {
                self.lamps_around(&from, sequence, rays, visit);
                self.sky_apart(p, pdf, sequence, rays, visit);
                self.fires_apart_of(p, sequence, rays, visit);
                let leg = self.follow_beside_sky(&from, (wi, pdf), sequence, rays);
                self.leg_brings(leg, None, sequence, rays)
            }
        };
        visit(wi, light / pdf);
        if let Some(weight) = straight {
            // Paths through media find emissive surfaces by chance, and others find those that are near.
            let patches = if scattering.is_some() { Patches::None } else { Patches::Far };
            self.straight_to(self.media(), patches, p, sequence, rays, |_, lamp, illuminance| {
                let near = (lamp.distance / least).min(1.0);
                visit(lamp.wi, illuminance * (weight * near * near));
            });
        }
    }

    /// The sky's image by a direction chosen from its bright parts, weighed against directions that have the density `chance` per steradian.
    fn sky_apart(
        &self,
        p: Vec3A,
        chance: f32,
        sequence: &mut Sequence,
        rays: &mut u32,
        visit: &mut dyn FnMut(Vec3A, Rgb),
    ) {
        if !self.lights.sky.is_sampled() {
            return;
        }
        let [a, b, _, _] = sequence.next4();
        let Some(s) = self.lights.sky.sample([a, b]) else { return };
        let left = self.transmittance(&in_air(p), s.wi, f32::INFINITY, rays);
        if left != Vec3::ZERO && 0.0 < s.pdf_solid_angle {
            visit(s.wi, self.lights.sky.radiance(s.wi) * left / (s.pdf_solid_angle + chance));
        }
    }

    /// One of the lights that media are, chosen by what it brings: rays that look around do not count these.
    fn fires_apart_of(
        &self,
        p: Vec3A,
        sequence: &mut Sequence,
        rays: &mut u32,
        visit: &mut dyn FnMut(Vec3A, Rgb),
    ) {
        let Some(fires) = self.fires() else { return };
        let [u, v, w, _] = sequence.next4();
        let total = pick(
            fires,
            p,
            (1, [u, v, w]),
            |_| 1.0,
            |position, light| {
                let way = position - p;
                let t_max = way.length();
                let wi = way.normalize_or(Vec3A::Y);
                visit(wi, light * self.unblocked(&in_air(p), wi, t_max, rays));
            },
        );
        if !total.is_finite() {
            visit(Vec3A::Y, Vec3::splat(total));
        }
    }

    /// The first surface that light does not pass in a direction from a place in the air.
    #[must_use]
    pub fn meets(&self, origin: Vec3A, direction: Vec3A) -> Option<Met> {
        let ray = Ray { origin, direction, t_max: f32::INFINITY };
        let opaque = |hit: &Hit| self.world.pass(self.scene, hit.triangle, hit.bary) == Vec3::ZERO;
        self.bvh.closest(&ray, opaque).map(|hit: Hit| {
            let normal = self.world.geometric_normal(hit.triangle);
            let double_sided = self.world.material(self.scene, hit.triangle).double_sided;
            Met { distance: hit.t, normal, front: direction.dot(normal) < 0.0, double_sided }
        })
    }

    /// A place of a ball around another, which sees it, through glass too; all of the ball is as likely where nothing is in it.
    pub(crate) fn nearby(&self, p: Vec3A, radius: f32, [a, b, c]: [f32; 3], rays: &mut u32) -> Vec3A {
        let direction = square_to_sphere([a, b]);
        *rays += 1;
        let free = self.meets(p, direction).map_or(radius, |met| radius.min(NEXT_TO * met.distance));
        p + direction * (free * c.cbrt())
    }

    /// Whether one place in the air sees another: nothing opaque is between them.
    #[must_use]
    pub fn sees(&self, from: Vec3A, to: Vec3A) -> bool {
        let way = to - from;
        let t_max = way.length();
        t_max <= 0.0 || !self.blocked(&Ray { origin: from, direction: way / t_max, t_max })
    }
}

/// A direction, all as likely.
fn square_to_sphere([u, v]: [f32; 2]) -> Vec3A {
    let z = 1.0 - 2.0 * u;
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = (2.0 * PI * v).sin_cos();
    Vec3A::new(r * cos, r * sin, z)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_cover_the_sphere() {
        let n = 1 << 12;
        let (mut mean, mut second) = (Vec3::ZERO, Vec3::ZERO);
        for i in 0..n {
            let [a, b, _, _] = Sequence::new(7, i).next4();
            let d = Vec3::from(square_to_sphere([a, b]));
            assert!((d.length() - 1.0).abs() < 1e-5);
            mean += d / n as f32;
            second += d * d / n as f32;
        }
        assert!(mean.length() < 2e-3, "{mean}");
        assert!((second - 1.0 / 3.0).abs().max_element() < 2e-3, "{second}");
    }
}
