//! Light that media scatter, as if nothing bounded them: impulse responses on every way between a vertex and what lights it (\[IR19\]).
//!
//! Where a path's direction finds a lit surface, the surface is a small patch that lights the medium, and the response to it is
//! integrated over its area: of a direction that was chosen by the cosine at the receiver this takes d^2 / (cos_r cos_e), which has no bound
//! where either surface is seen along its plane, and a receiver never finds what shines in its own plane. \[IR19\] moves the origin a
//! little. Here a few places are chosen by area as well, the ends of random chords: lines at random through a ball around the receiver meet every
//! patch of surface in it equally often, however it is turned, and with radii spread evenly the density of places falls with distance as
//! the response does. The balance heuristic (\[Vea97\] eq. 9.8) weighs both ways of finding a patch, so nothing is
//! cut off and every weight is bounded by that of the chords. Directions to the sky are treated alike, with some chosen evenly.

use crate::geom::{Hit, Ray};
use crate::light::punctual::Incident;
use crate::media::{Crossing, Media, Responses};
use crate::sample::Sequence;
use crate::sample::warp::{Frame, cos_hemisphere_pdf};
use crate::scene::model::Rgb;
use crate::transport::direct::Part;
use crate::transport::path::{Kernel, Stage, Vertex, balance};
use glam::{Vec3, Vec3A};
use std::f32::consts::{FRAC_1_PI, PI};

/// Share of vertices that send a chord, and of those that look for the sky in any direction.
const CHORDS: f32 = 0.125;

impl<const AIR: bool> Kernel<'_, AIR> {
    /// `E / pi` by a lamp or sun of 1 lux at the vertex, through media and scattered in them; unscattered with the cosine `cos`.
    pub(crate) fn lamp_through(&self, responses: &Responses, at: &Vertex, light: &Incident, cos: f32) -> Rgb {
        let Some(media) = self.media() else { return Vec3::ZERO };
        let air = media.crossing(at.position, light.wi, light.distance);
        let turned = light.wi.dot(at.shading_normal);
        let glow = if light.distance.is_finite() {
            responses.lamp(&air, light.distance, turned) * (light.distance * light.distance)
        } else {
            responses.sun(&air, turned)
        };
        (air.transmittance() * cos + glow) * FRAC_1_PI
    }

    /// `E / pi` by a patch of 1 nit, per area of it, likewise; unscattered with the form factor `clear`, 1 / m^2.
    pub(crate) fn patch_spread(
        &self,
        responses: &Responses,
        at: &Vertex,
        wi: Vec3A,
        distance: f32,
        normal: Vec3A,
        clear: f32,
    ) -> Rgb {
        let Some(media) = self.media() else { return Vec3::ZERO };
        let air = media.crossing(at.position, wi, distance);
        let glow = responses.patch(&air, distance, wi, at.shading_normal, normal);
        (air.transmittance() * clear + glow) * FRAC_1_PI
    }

    /// Weight of light that a direction found at an emitter; densities of that direction and of choosing the emitter, per steradian.
    pub(crate) fn emitter_through(
        &self,
        (media, responses): (&Media, &Responses),
        from: &Vertex,
        wi: Vec3A,
        distance: f32,
        normal: Vec3A,
        [pdf, other]: [f32; 2],
    ) -> Rgb {
        let air = media.crossing(from.position, wi, distance);
        let clear = air.transmittance() * balance(pdf, other);
        clear
            + self.patch_glow(
                responses,
                &air,
                from,
                wi,
                distance,
                normal,
                per_area(pdf + other, wi, normal, distance),
            )
    }

    /// Factors of light from a surface that a direction of density `pdf` found: of what beams find as well, and of the rest.
    pub(crate) fn surface_through(
        &self,
        (media, responses): (&Media, &Responses),
        by_area: Option<&Responses>,
        from: &Vertex,
        wi: Vec3A,
        [distance, pdf]: [f32; 2],
        normal: Vec3A,
    ) -> (Rgb, Rgb) {
        let air = media.crossing(from.position, wi, distance);
        let clear = air.transmittance();
        let density = per_area(pdf, wi, normal, distance);
        let glow = self.patch_glow(responses, &air, from, wi, distance, normal, 1.0);
        let over = |density: f32| if 0.0 < density { clear + glow / density } else { clear };
        let chords = by_area.map_or(0.0, |r| CHORDS * chord_density(r.reach(), distance));
        (over(density), over(density + chords))
    }

    /// What a patch of 1 nit adds by way of the medium, `E / pi` over the density per area of choosing it.
    #[expect(clippy::too_many_arguments, reason = "a segment between two vertices")]
    fn patch_glow(
        &self,
        responses: &Responses,
        air: &Crossing,
        at: &Vertex,
        wi: Vec3A,
        distance: f32,
        normal: Vec3A,
        density: f32,
    ) -> Rgb {
        let glow = responses.patch(air, distance, wi, at.shading_normal, normal);
        if 0.0 < density { glow * (FRAC_1_PI / density) } else { Vec3::ZERO }
    }

    /// Weight of sky that a direction found; densities of that direction and of choosing it by the sky, per steradian.
    pub(crate) fn sky_through(
        &self,
        responses: &Responses,
        from: &Vertex,
        wi: Vec3A,
        [pdf, other]: [f32; 2],
    ) -> Rgb {
        if pdf <= 0.0 {
            return Vec3::ZERO;
        }
        self.sky_spread(responses, from, wi, pdf + other)
    }

    /// `E / pi` by light of 1 nit from a direction, through media and scattered in them, over its density per steradian; `density` leaves out
    /// what [`Kernel::sky_by_chance`] adds.
    pub(crate) fn sky_spread(&self, responses: &Responses, at: &Vertex, wi: Vec3A, density: f32) -> Rgb {
        let Some(media) = self.media() else { return Vec3::ZERO };
        let air = media.crossing(at.position, wi, f32::INFINITY);
        let cos = wi.dot(at.shading_normal);
        let glow = responses.sun(&air, cos) / (density + CHORDS * even_density(at));
        (air.transmittance() * (cos.max(0.0) / density) + glow) * FRAC_1_PI
    }

    /// Light of the sky that media scatter, `E / pi`, from a direction that is chosen evenly, once in a while.
    pub(crate) fn sky_by_chance(
        &self,
        responses: &Responses,
        at: &Vertex,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let (Some(media), false) = (self.media(), self.lights.sky.is_black()) else { return Vec3::ZERO };
        if CHORDS <= sequence.coin() {
            return Vec3::ZERO;
        }
        let [a, b, _, _] = sequence.next4();
        let mut wi = even_direction([a, b]);
        if !at.detached && wi.dot(at.geometric_normal) < 0.0 {
            wi = -wi;
        }
        let radiance = self.lights.sky.radiance(wi);
        let glow = responses.sun(&media.crossing(at.position, wi, f32::INFINITY), wi.dot(at.shading_normal));
        if radiance == Vec3::ZERO || glow == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let density = cos_hemisphere_pdf(wi.dot(at.shading_normal).max(0.0))
            + self.sky_density(at, wi)
            + CHORDS * even_density(at);
        radiance * glow * self.unblocked(at, wi, f32::INFINITY, rays) * (FRAC_1_PI / density)
    }

    /// Light of surfaces that media scatter, `E / pi`, from a place that is chosen by area, once in a while. What surfaces emit is left to
    /// the choice of emitters, and what suns and lamps bring to them straight away to beams, where there are any.
    pub(crate) fn by_area(
        &self,
        responses: &Responses,
        at: &Vertex,
        depth: u32,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let reach = responses.reach();
        let chance = sequence.coin() < CHORDS;
        let Some(media) = self.media().filter(|_| chance && 0.0 < reach) else { return Vec3::ZERO };
        let [a, b, c, d] = sequence.next4();
        let [e, f, g, h] = sequence.next4();
        let lifted = at.position + at.geometric_normal * at.offset;
        let chord = chord(lifted, reach * a, [b, c], [d, e]);
        *rays += 1;
        let Some((hit, n)) = self.one_of_all(&chord, lifted, f) else { return Vec3::ZERO };
        // From above the plane, so that what lies in it is seen from its front.
        let p = chord.origin + chord.direction * hit.t;
        let (place, reflectance) = self.encounter(&hit, (p - lifted).normalize_or_zero()).reflection();
        let d = place.position - at.position;
        let distance = d.length();
        let wi = d / distance;
        if !at.faces(wi, distance) || !wi.is_finite() {
            return Vec3::ZERO;
        }
        let air = media.crossing(at.position, wi, distance);
        let by_cosine = cos_hemisphere_pdf(wi.dot(at.shading_normal).max(0.0));
        let density = per_area(by_cosine, wi, place.geometric_normal, distance)
            + CHORDS * chord_density(reach, distance);
        let glow = self.patch_glow(responses, &air, at, wi, distance, place.geometric_normal, density)
            * (n * reflectance);
        if glow == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let left = self.unblocked(at, wi, distance - 2.0 * place.offset, rays);
        if left == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let mut light = match self.cached(&place, rays) {
            Some(cached) => cached,
            None => {
                let stage = Stage::Branch(depth + 1);
                let path = self.walk_surfaces(&place, [g, h], Part::Area, stage, None, sequence);
                *rays += path.rays;
                path.direct + path.indirect
            }
        };
        if self.beams.is_none() {
            light += self.direct(&place, Part::Small, false, None, sequence, rays).small;
        }
        glow * left * light
    }

    /// One of all places on a chord that shine towards `receiver`, and how many there are.
    fn one_of_all(&self, chord: &Ray, receiver: Vec3A, u: f32) -> Option<(Hit, f32)> {
        let (mut chosen, mut n, mut u) = (None, 0.0, u);
        self.bvh.every(chord, |hit| {
            let p = chord.origin + chord.direction * hit.t;
            let in_front = 0.0 < (receiver - p).dot(self.world.geometric_normal(hit.triangle));
            if in_front || self.world.material(self.scene, hit.triangle).double_sided {
                n += 1.0;
                // Each is as likely as any other, without a list of them.
                if u * n < 1.0 {
                    chosen = Some(*hit);
                    u *= n;
                } else {
                    u = (u * n - 1.0) / (n - 1.0);
                }
            }
        });
        chosen.map(|c| (c, n))
    }
}

/// A chord of the ball of `radius` around a point: every line through it is as likely as any other.
fn chord(centre: Vec3A, radius: f32, u: [f32; 2], v: [f32; 2]) -> Ray {
    let direction = even_direction(u);
    let (aside, half) = (radius * v[0].sqrt(), radius * (1.0 - v[0]).sqrt());
    let (sin, cos) = (2.0 * PI * v[1]).sin_cos();
    let origin = centre + Frame::new(direction).to_world(Vec3A::new(aside * cos, aside * sin, -half));
    Ray { origin, direction, t_max: 2.0 * half }
}

/// Ends of chords per area of surface at a distance: 1 / (2 pi r^2) of one ball of radius r (a line meets a patch by the mean of its cosine,
/// one half), with radii spread evenly up to `reach`.
fn chord_density(reach: f32, distance: f32) -> f32 {
    if distance < reach { (1.0 / distance - 1.0 / reach) / (2.0 * PI * reach) } else { 0.0 }
}

/// A direction, all alike.
fn even_direction(u: [f32; 2]) -> Vec3A {
    let z = 1.0 - 2.0 * u[0];
    let (sin, cos) = (2.0 * PI * u[1]).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3A::new(r * cos, r * sin, z)
}

/// Density of directions that are chosen evenly from all that the vertex faces, per steradian.
fn even_density(at: &Vertex) -> f32 {
    if at.detached { 0.25 * FRAC_1_PI } else { 0.5 * FRAC_1_PI }
}

/// A density per steradian as one per area at `distance`.
fn per_area(density: f32, wi: Vec3A, normal: Vec3A, distance: f32) -> f32 {
    density * (-wi.dot(normal)).max(0.0) / (distance * distance)
}
