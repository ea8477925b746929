//! The reference: unbiased paths that scatter in media.
//!
//! On every segment between surfaces light of lamps is scattered towards the ray at a place chosen by equi-angular sampling (\[KF12\]
//! Kulla and Fajardo): from free-flight vertices it would have infinite variance near a lamp. The path itself goes on by free
//! flight in the channel that one of the three, chosen by what they carry, asks for; weights are those of all three together
//! (spectral multiple importance sampling, \[Vea97\] eq. 9.8), so coloured media stay bounded. Light of suns is taken where the path scatters.
//! Emitters and sky are found from there by chance, from surfaces as ever.

use crate::geom::ray::offset_distance;
use crate::light::many::{Among, Chosen};
use crate::light::punctual::Incident;
use crate::light::tree::{FallOff, Receiver};
use crate::media::{Media, Segment};
use crate::sample::Sequence;
use crate::sample::warp::{Frame, cos_hemisphere_pdf, square_to_cos_hemisphere};
use crate::scene::model::Rgb;
use crate::transport::air::{Air, equi_angular, henyey_greenstein_direction};
use crate::transport::direct::Part;
use crate::transport::direct::{FINE, finer};
use crate::transport::encounter::Onward;
use crate::transport::path::{
    DEEP, DEEP_SURVIVAL, Estimate, Kernel, MAX_LAYERS, ROULETTE_BELOW, Vertex, balance,
};
use glam::{Vec3, Vec3A};

/// Up to this many lamps are all asked on each segment; of more, one.
const ALL_LAMPS: usize = 4;

/// Where a path is.
enum Place {
    /// At a surface, which chose the direction by cosine.
    Surface(Vertex),
    /// In a medium.
    Medium,
}

impl Place {
    /// Density per steradian with which the place chose a direction. In media nothing competes with it.
    fn density(&self, direction: Vec3A) -> f32 {
        match self {
            Self::Surface(v) => cos_hemisphere_pdf(direction.dot(v.shading_normal)),
            Self::Medium => 1.0,
        }
    }
}

/// How a segment ended.
enum End {
    /// Scattered there, with this weight; mean cosine of the medium.
    Scattered { at: f32, weight: Rgb, g: f32 },
    /// Went through.
    Through { weight: Rgb },
}

impl<const AIR: bool> Kernel<'_, AIR> {
    /// One path through surfaces and media, `E / pi`; see [`Kernel::estimate`].
    pub(crate) fn walk_media(
        &self,
        media: &Media,
        start: &Vertex,
        u: [f32; 2],
        part: Part,
        sequence: &mut Sequence,
    ) -> Estimate {
        let mut out = Estimate::default();
        out.direct = self.direct(start, part, true, None, sequence, &mut out.rays).sum();
        let direction = Frame::new(start.shading_normal).to_world(square_to_cos_hemisphere(u));
        let origin = start.ray(direction, f32::INFINITY).origin;
        self.wander(media, Place::Surface(*start), (origin, direction), sequence, &mut out);
        out
    }

    /// Radiance that arrives at a place in the air from a direction, nits, but for what suns and lamps bring straight away.
    pub(crate) fn arrives_through_media(
        &self,
        media: &Media,
        ray: (Vec3A, Vec3A),
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let mut out = Estimate::default();
        self.wander(media, Place::Medium, ray, sequence, &mut out);
        *rays += out.rays;
        out.direct + out.indirect
    }

    /// A path from a place on in a direction.
    fn wander(
        &self,
        media: &Media,
        mut place: Place,
        (mut origin, mut direction): (Vec3A, Vec3A),
        sequence: &mut Sequence,
        out: &mut Estimate,
    ) {
        let mut segments = Vec::new();
        let mut throughput = Vec3::ONE;
        let (mut reflections, mut travelled, mut layers) = (0u32, 0.0, 0u32);
        // Neither reflected nor scattered yet.
        let mut straight = true;
        // What media emit along the way is found by places that are chosen for it as well, but from where a ray comes that looks out of the air.
        let mut glow_weight = match (&place, self.glowing()) {
            (Place::Surface(v), Some(media)) => {
                balance(place.density(direction), media.emitting_pdf(v.position, direction))
            }
            _ => 1.0,
        };
        for depth in 1u32.. {
            out.rays += 1;
            let ray = crate::geom::Ray { origin, direction, t_max: f32::INFINITY };
            let hit = self.closest(&ray);
            let length = hit.map_or(f32::INFINITY, |h| h.t);
            if media.emits() {
                let emitted = throughput * media.emitted(origin, direction, length) * glow_weight;
                *(if straight { &mut out.direct } else { &mut out.indirect }) += emitted;
            }
            media.segments(origin, direction, length, &mut segments);
            if !segments.is_empty() {
                let air = Air { media, segments: &segments, origin, direction };
                let inscattered = self.lamps_along(&air, sequence, &mut out.rays);
                out.indirect += throughput * inscattered;
                match flight(&air, throughput, sequence) {
                    End::Scattered { at, weight, g } => {
                        throughput *= weight;
                        let p = origin + direction * at;
                        out.indirect +=
                            throughput * self.suns_at(media, p, direction, g, sequence, &mut out.rays);
                        if !survives(&mut throughput, depth, sequence) {
                            break;
                        }
                        let [a, b, _, _] = sequence.next4();
                        let from = direction;
                        direction = henyey_greenstein_direction(from, g, [a, b]);
                        if media.emits() {
                            let u = sequence.next4();
                            out.indirect +=
                                throughput * self.fire_in_air(media, p, (from, g), u, &mut out.rays);
                            let pdf = media.phase(g, from.dot(direction));
                            glow_weight = balance(pdf, media.emitting_pdf(p, direction));
                        }
                        origin = p;
                        place = Place::Medium;
                        straight = false;
                        travelled = 0.0;
                        continue;
                    }
                    End::Through { weight } => throughput *= weight,
                }
                if throughput == Vec3::ZERO {
                    break;
                }
            }
            let pdf = place.density(direction);
            let Some(hit) = hit else {
                let other = match &place {
                    Place::Surface(v) => self.sky_density(v, direction),
                    Place::Medium => 0.0,
                };
                let sky = throughput * self.lights.sky.radiance(direction) * balance(pdf, other);
                *(if straight { &mut out.direct } else { &mut out.indirect }) += sky;
                break;
            };
            travelled += hit.t;
            let met = self.encounter(&hit, direction);
            if met.emits {
                let other = match &place {
                    Place::Surface(v) => {
                        self.lights.emitter_pdf(&self.emitter_receiver(v), hit.triangle, direction, travelled)
                    }
                    Place::Medium => 0.0,
                };
                let emitted = throughput * met.shade.emission * balance(pdf, other);
                *(if straight { &mut out.direct } else { &mut out.indirect }) += emitted;
            }
            match met.onward(sequence) {
                Onward::Absorbed => break,
                Onward::Through { tint, origin: behind } => {
                    throughput *= tint;
                    origin = behind;
                    layers += 1;
                    if layers == MAX_LAYERS {
                        break;
                    }
                    continue;
                }
                Onward::Reflected { vertex, reflectance } => {
                    throughput *= reflectance;
                    if throughput == Vec3::ZERO || self.bounces.is_some_and(|n| n <= reflections) {
                        break;
                    }
                    reflections += 1;
                    let direct = self.direct(&vertex, Part::All, false, None, sequence, &mut out.rays);
                    out.indirect += throughput * direct.sum();
                    if !survives(&mut throughput, depth, sequence) {
                        break;
                    }
                    let [a, b, _, _] = sequence.next4();
                    direction = Frame::new(vertex.shading_normal).to_world(square_to_cos_hemisphere([a, b]));
                    origin = vertex.ray(direction, f32::INFINITY).origin;
                    let at = vertex.position;
                    place = Place::Surface(vertex);
                    if media.emits() {
                        glow_weight = balance(place.density(direction), media.emitting_pdf(at, direction));
                    }
                    straight = false;
                    travelled = 0.0;
                    layers = 0;
                }
            }
        }
    }

    /// Light of lamps that is scattered once towards the ray's origin, nits.
    fn lamps_along(&self, air: &Air<'_>, sequence: &mut Sequence, rays: &mut u32) -> Rgb {
        let lamps = &self.lights.punctual;
        if lamps.is_empty() {
            return Vec3::ZERO;
        }
        let [a, b, _, _] = sequence.next4();
        let (ask, weight) = if lamps.len() <= ALL_LAMPS {
            (0..lamps.len(), 1.0)
        } else if let Some(many) = self.lights.many_lamps().filter(|m| m.knows_media()) {
            let [fine, ..] = sequence.coins(FINE);
            let at = Receiver::in_air(air.origin);
            let chosen = many.one(&at, Among::Lamps, FallOff::Linear, finer(b, fine));
            let Some((Chosen::Lamp(i), chance)) = chosen else { return Vec3::ZERO };
            (i..i + 1, 1.0 / chance)
        } else {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
            let i = ((b * lamps.len() as f32) as usize).min(lamps.len() - 1);
            (i..i + 1, lamps.len() as f32)
        };
        let (from, to) = (air.segments[0].from, air.segments[air.segments.len() - 1].to);
        let mut sum = Vec3::ZERO;
        for (k, i) in ask.enumerate() {
            let u = (a + 0.618_034 * k as f32).fract();
            let to_lamp = lamps[i].position() - air.origin;
            let Some((from, to)) = lamps[i].lit_part(air.origin, air.direction, from, to) else { continue };
            let Some((t, pdf)) = equi_angular(to_lamp, air.direction, from, to, u) else { continue };
            let Some(segment) = air.segments.iter().find(|s| s.from <= t && t <= s.to) else { continue };
            let p = air.origin + air.direction * t;
            let Some(light) = lamps[i].incident(p) else { continue };
            let here = air.media.coefficients(*segment, air.origin, air.direction, t);
            let arriving = self.scattered(air.media, p, air.direction, here.g, &light, rays);
            sum += air.transmittance(t) * here.sigma_s * arriving * (weight / pdf);
        }
        sum
    }

    /// Light of suns at a place where the path scatters, nits per unit of throughput.
    fn suns_at(
        &self,
        media: &Media,
        p: Vec3A,
        direction: Vec3A,
        g: f32,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        if self.lights.suns.is_empty() {
            return Vec3::ZERO;
        }
        let [a, b, _, _] = sequence.next4();
        self.lights
            .suns
            .iter()
            .enumerate()
            .map(|(i, sun)| {
                let shift = i as f32 * 0.618_034;
                let light = sun.sample([(a + shift).fract(), (b + 2.0 * shift).fract()]);
                self.scattered(media, p, direction, g, &light, rays)
            })
            .sum()
    }

    /// Radiance that a place scatters back along `direction`, of a light that it may see, per unit of sigma_s.
    fn scattered(
        &self,
        media: &Media,
        p: Vec3A,
        direction: Vec3A,
        g: f32,
        light: &Incident,
        rays: &mut u32,
    ) -> Rgb {
        let phase = media.phase(g, light.wi.dot(direction));
        let slack = offset_distance((p + light.wi * light.distance).abs().max_element());
        let t_max = if light.distance.is_finite() { light.distance - slack } else { f32::INFINITY };
        let from = Vertex {
            position: p,
            geometric_normal: Vec3A::ZERO,
            shading_normal: Vec3A::ZERO,
            offset: 0.0,
            open: false,
            detached: false,
        };
        let left = media.transmittance(p, light.wi, light.distance);
        if left == Vec3::ZERO {
            return Vec3::ZERO;
        }
        light.illuminance * left * phase * self.unblocked(&from, light.wi, t_max, rays)
    }
}

/// Russian roulette by what is left of the throughput.
fn survives(throughput: &mut Rgb, depth: u32, sequence: &mut Sequence) -> bool {
    let limit = if depth < DEEP { 1.0 } else { DEEP_SURVIVAL };
    let survival = (throughput.max_element() / ROULETTE_BELOW).min(limit);
    if survival < 1.0 {
        if survival <= sequence.next4()[2] {
            return false;
        }
        *throughput /= survival;
    }
    true
}

impl Air<'_> {
    /// Where the path scatters in a segment in which a grid and other media overlap: null-collision tracking (\[WMHL65\] Woodcock
    /// et al.) brick by brick. `parts` is room.
    fn track(
        &self,
        segment: Segment,
        channel: usize,
        parts: &mut Vec<(f32, f32, f32)>,
        sequence: &mut Sequence,
    ) -> Option<f32> {
        self.media.majorants(segment, self.origin, self.direction, channel, parts);
        for &(from, to, most) in parts.iter().filter(|part| 0.0 < part.2) {
            let mut t = from;
            loop {
                let [a, b, _, _] = sequence.next4();
                t -= (1.0 - a).ln() / most;
                if to <= t {
                    break;
                }
                let here = self.media.coefficients(segment, self.origin, self.direction, t);
                if b * most < here.sigma_t[channel] {
                    return Some(t);
                }
            }
        }
        None
    }
}

/// Free flight: where the path scatters, or that it does not.
fn flight(air: &Air<'_>, throughput: Rgb, sequence: &mut Sequence) -> End {
    let [a, b, _, _] = sequence.next4();
    let chances = throughput / throughput.element_sum();
    let channel = if a < chances.x {
        0
    } else if a < chances.x + chances.y {
        1
    } else {
        2
    };
    let mut wanted = -(1.0 - b).ln();
    let mut depth = Vec3::ZERO;
    let mut parts = Vec::new();
    for &s in air.segments {
        let here = air.depth(s, s.to);
        let at = if air.media.is_mixed(s) {
            // What was wanted stays as long as before: an exponential has no memory.
            air.track(s, channel, &mut parts, sequence)
        } else {
            let at = (wanted < here[channel]).then(|| air.place(s, channel, wanted));
            wanted -= here[channel];
            at
        };
        if let Some(at) = at {
            let left = (-(depth + air.depth(s, at))).exp();
            let c = air.media.coefficients(s, air.origin, air.direction, at);
            // Densities of a place in each channel.
            let density = chances.dot(c.sigma_t * left);
            let weight = if 0.0 < density { c.sigma_s * left / density } else { Vec3::ZERO };
            return End::Scattered { at, weight, g: c.g };
        }
        depth += here;
    }
    let left = (-depth).exp();
    let chance = chances.dot(left);
    End::Through { weight: if 0.0 < chance { left / chance } else { Vec3::ZERO } }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::media::henyey_greenstein;
    use crate::scene::model::{Density, Medium, Region, Scene};
    use glam::vec3;
    use std::f32::consts::PI;

    fn sequences() -> impl Iterator<Item = Sequence> {
        (0..20_000).map(|i| Sequence::new(7, i))
    }

    /// Directions have the mean cosine g, and as many of them go forward as the density says.
    #[test]
    fn scattered_directions_follow_the_phase_function() {
        let axis = vec3(0.36, -0.48, 0.8).normalize().into();
        for g in [-0.95, -0.5, -5e-4, 0.0, 5e-4, 0.3, 0.9f32] {
            let (mut mean, mut half, mut n) = (0.0f64, 0.0f64, 0.0f64);
            for mut s in sequences() {
                let [a, b, _, _] = s.next4();
                let d = henyey_greenstein_direction(axis, g, [a, b]);
                assert!((d.length() - 1.0).abs() < 1e-5);
                let cos = f64::from(d.dot(axis));
                mean += cos;
                half += f64::from(u8::from(0.0 < cos));
                n += 1.0;
            }
            assert!((mean / n - f64::from(g)).abs() < 2e-3, "g {g}: mean cosine {}", mean / n);
            // Midpoints over the cosine, of the density over the forward half.
            let m = 20_000;
            let density = |i: i32| henyey_greenstein(g, (i as f32 + 0.5) / m as f32);
            let want: f64 = (0..m).map(|i| f64::from(density(i)) * 2.0 * f64::from(PI) / f64::from(m)).sum();
            assert!((half / n - want).abs() < 3e-3, "g {g}: {} forward, {want} wanted", half / n);
        }
    }

    /// The density belongs to the places: the mean of its inverse is the length, of f / pdf the integral of f.
    #[test]
    fn equi_angular_places_have_their_density() {
        for (lamp, from, to) in [
            (vec3(0.0, 0.5, 2.0), 0.0, 5.0),
            (vec3(0.0, 0.01, 2.0), 1.0, 3.0),
            (vec3(1.0, 0.0, -3.0), 0.0, 4.0),
        ] {
            let lamp = Vec3A::from(lamp);
            let (mut length, mut light, mut n) = (0.0f64, 0.0f64, 0.0f64);
            for mut s in sequences() {
                let (t, pdf) = equi_angular(lamp, Vec3A::Z, from, to, s.next4()[0]).expect("a place");
                assert!(from <= t && t <= to);
                length += f64::from(pdf).recip();
                light += f64::from((lamp - Vec3A::Z * t).length_squared() * pdf).recip();
                n += 1.0;
            }
            assert!((length / n / f64::from(to - from) - 1.0).abs() < 0.02, "{lamp}: {}", length / n);
            let aside = f64::from(lamp.truncate().length());
            let angle = |t: f32| (f64::from(t - lamp.z) / aside).atan();
            let want = (angle(to) - angle(from)) / aside;
            assert!((light / n / want - 1.0).abs() < 1e-3, "{lamp}: {} {want}", light / n);
        }
        // Through the lamp, from the lamp, without a length.
        assert!(equi_angular(Vec3A::Z * 2.0, Vec3A::Z, 0.0, 5.0, 0.3).is_none());
        assert!(equi_angular(Vec3A::ZERO, Vec3A::Z, 0.0, 5.0, 0.3).is_none());
        assert!(equi_angular(Vec3A::X, Vec3A::Z, 1.0, 1.0, 0.3).is_none());
        assert!(equi_angular(Vec3A::X, Vec3A::Z, 0.0, f32::INFINITY, 0.999).is_some());
    }

    /// In the mean a path goes through with the transmittance of each channel, and scatters with the albedo of the rest,
    /// whatever channel it carries most of.
    #[test]
    fn free_flight_keeps_the_energy_of_every_channel() {
        let body = |sigma_s, sigma_a, density, z: [f32; 2], g| Medium {
            path: String::new(),
            sigma_s,
            sigma_a,
            emission: Vec3::ZERO,
            density,
            g,
            region: Region::Box { min: vec3(-9.0, -9.0, z[0]), max: vec3(9.0, 9.0, z[1]) },
        };
        let bodies = vec![
            body(vec3(0.1, 0.5, 2.0), vec3(0.0, 0.5, 0.5), Density::Constant, [0.5, 1.5], 0.0),
            body(vec3(1.0, 1.0, 0.0), vec3(1.0, 0.0, 4.0), Density::Constant, [2.0, 2.25], 0.5),
            // Five times as dense at its end as at its beginning.
            body(
                vec3(0.2, 0.4, 0.8),
                vec3(0.0, 0.2, 0.0),
                Density::Height { base: -2.0, falloff: 0.5 / 4f32.ln() },
                [3.0, 4.0],
                0.25,
            ),
        ];
        let media =
            Media::new(&Scene { media: bodies.clone(), ..Scene::default() }, Vec3::ZERO).expect("media");
        let (origin, direction) = (Vec3A::ZERO, Vec3A::new(0.0, -0.5, 0.75f32.sqrt()));
        let mut segments = Vec::new();
        media.segments(origin, direction, f32::INFINITY, &mut segments);
        let air = Air { media: &media, segments: &segments, origin, direction };
        let (mut through, mut scattered) = (Vec3::ONE, Vec3::ZERO);
        for (s, b) in segments.iter().zip(&bodies) {
            let left = (-air.depth(*s, s.to)).exp();
            scattered += through * (1.0 - left) * b.sigma_s / (b.sigma_s + b.sigma_a);
            through *= left;
        }
        for throughput in [Vec3::ONE, vec3(1.0, 0.1, 0.01), vec3(0.0, 0.0, 3.0)] {
            let (mut went, mut stayed, mut n) = (Vec3::ZERO, Vec3::ZERO, 0.0);
            for mut s in sequences() {
                match flight(&air, throughput, &mut s) {
                    End::Through { weight } => went += weight,
                    End::Scattered { at, weight, g } => {
                        let i = segments.iter().position(|s| s.from <= at && at <= s.to).expect("inside");
                        assert!((g - bodies[i].g).abs() < 1e-6);
                        stayed += weight;
                    }
                }
                n += 1.0;
            }
            // Channels that carry nothing need not be right.
            let carried = Vec3::select(throughput.cmpgt(Vec3::ZERO), Vec3::ONE, Vec3::ZERO);
            let off = (went / n - through) * carried;
            assert!(off.abs().max_element() < 0.02, "{throughput}: {} {through}", went / n);
            let off = (stayed / n - scattered) * carried;
            assert!(off.abs().max_element() < 0.03, "{throughput}: {} {scattered}", stayed / n);
        }
    }

    #[test]
    fn endless_media_always_scatter() {
        let fog = Medium {
            path: String::new(),
            sigma_s: vec3(0.1, 0.0, 0.0),
            sigma_a: vec3(0.0, 0.0, 1.0),
            emission: Vec3::ZERO,
            density: Density::Constant,
            g: 0.0,
            region: Region::Everywhere,
        };
        let media = Media::new(&Scene { media: vec![fog], ..Scene::default() }, Vec3::ZERO).expect("media");
        let mut segments = Vec::new();
        media.segments(Vec3A::ZERO, Vec3A::X, f32::INFINITY, &mut segments);
        let air = Air { media: &media, segments: &segments, origin: Vec3A::ZERO, direction: Vec3A::X };
        for mut s in sequences().take(2000) {
            match flight(&air, Vec3::ONE, &mut s) {
                End::Scattered { at, weight, .. } => assert!(at.is_finite() && weight.is_finite()),
                // The green channel meets nothing.
                End::Through { weight } => assert!(weight.x == 0.0 && weight.z == 0.0 && weight.is_finite()),
            }
        }
    }
}
