//! Next-event estimation: light straight from the lights at one vertex.
//!
//! Lights fall in strata that are each sampled once: punctual lights, suns, emissive triangles and
//! the sky; of many lamps and triangles texels ask a few at once. Candela and lux never meet in one distribution, so probabilities do not depend on the
//! unit of length.

use crate::geom::ray::offset_distance;
use crate::geom::world::{SurfacePoint, luminance};
use crate::geom::{Hit, Ray};
use crate::light::Selection;
use crate::light::beams::Source;
use crate::light::emitters::EmitterSample;
use crate::light::many::{Among, Chosen, EVERY_LAMP};
use crate::light::punctual::Incident;
use crate::light::tree::Receiver;
use crate::media::{Media, Responses};
use crate::sample::Sequence;
use crate::sample::warp::cos_hemisphere_pdf;
use crate::scene::model::Rgb;
use crate::transport::connect::Arrival;
use crate::transport::path::{Kernel, Vertex};
use glam::{Vec3, Vec3A};
use std::f32::consts::FRAC_1_PI;

/// See [`Kernel::least_cosine`].
const LEAST_COSINE: f32 = 0.1;

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

/// `E / pi` straight from the lights, nits.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Direct {
    /// Of suns and lamps.
    pub(crate) small: Rgb,
    /// Of emitters and sky.
    pub(crate) area: Rgb,
}

impl Direct {
    /// Of all lights.
    pub(crate) fn sum(self) -> Rgb {
        self.small + self.area
    }
}

/// What of a light counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Share {
    /// All.
    All,
    /// What media scatter: the game adds the rest.
    Scattered,
}

/// Fraction of the golden ratio: what several lights that share numbers shift them by.
const GOLDEN: f32 = 0.618_034;

/// Who asks lamps.
#[derive(Clone, Copy)]
struct Asked<'a> {
    vertex: &'a Vertex,
    receiver: bool,
    arrival: Option<Arrival>,
    /// How many of many are asked.
    n: usize,
}

/// Numbers that make the choice among many lights finer.
pub(crate) const FINE: u32 = 8;

/// The first 23 bits of a number, which is all that Sobol points have, with 24 more: in a tree of a million lights the first ones are used up on the way down.
pub(crate) fn finer(u: f32, more: f32) -> f64 {
    (f64::from((u * 8_388_608.0).floor()) + f64::from(more)) / 8_388_608.0
}

/// The next numbers; where lights that are not there are asked for all the same, others, so that the path's stay what they are.
fn numbers(there: bool, sequence: &mut Sequence) -> [f32; 4] {
    if there { sequence.next4() } else { sequence.fork().next4() }
}

/// What media leave of light along a segment; apart, so that scenes without media carry nothing of it.
#[inline(never)]
fn weakened(left: Rgb, media: &Media, from: Vec3A, wi: Vec3A, t_max: f32) -> Rgb {
    if left == Vec3::ZERO { left } else { left * media.transmittance(from, wi, t_max.max(0.0)) }
}

/// Metres to a light. One that lies on a surface must not be hidden by that surface's rounding.
fn up_to(vertex: &Vertex, light: &Incident) -> f32 {
    let slack = offset_distance((vertex.position + light.wi * light.distance).abs().max_element());
    if light.distance.is_finite() { light.distance - slack } else { f32::INFINITY }
}

impl<const AIR: bool> Kernel<'_, AIR> {
    /// Light straight from the lights at `vertex`, one sample. At the receiver the unscattered part of lights is left out
    /// that the game adds. `arrival` says how the vertex was found, where connecting to beams could have found it as well.
    pub(crate) fn direct(
        &self,
        vertex: &Vertex,
        part: Part,
        receiver: bool,
        arrival: Option<Arrival>,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Direct {
        let lights = self.lights;
        let mut out = Direct::default();
        let (small, area) = (part != Part::Area, part != Part::Small);
        let punctual = small && !lights.small.no_lamps;
        // Many emissive triangles are asked where lamps are, with as many samples as these get.
        let apart = receiver && self.emitters_apart();
        let emitters = !lights.small.no_emission && if apart { small } else { area };
        if punctual || emitters {
            let fine = sequence.coins(FINE);
            let there =
                (punctual && !lights.punctual.is_empty()) || (emitters && !lights.emitters.is_empty());
            let [a, b, c, d] = numbers(there, sequence);
            let n = if receiver && part == Part::Small { lights.asked_at_once } else { 1 };
            if punctual
                && receiver
                && let Some(grid) = &lights.lamp_grid
            {
                let [u, v, w, _] = sequence.next4();
                let seen = |wi, t_max, rays: &mut u32| self.transmittance(vertex, wi, t_max, rays);
                out.small += self.lit_by(grid, vertex, (n, [u, v, w]), &seen, rays);
            }
            if punctual {
                let at = Asked { vertex, receiver, arrival, n };
                out.small += self.punctual(&at, finer(a, fine[0]), rays);
            }
            if emitters {
                out.area += self.emitters(vertex, n, finer(b, fine[1]), [c, d], rays);
            }
        }
        let suns = small && !lights.small.no_suns;
        let sky = area && (!lights.small.no_image || self.sky_guide.is_some()) && !vertex.open;
        if suns || sky {
            let seen = sky && (lights.sky.is_sampled() || self.sky_guide.is_some());
            let [a, b, c, d] = numbers((suns && !lights.suns.is_empty()) || seen, sequence);
            let asked = if suns { lights.suns.as_slice() } else { &[] };
            for (i, sun) in asked.iter().enumerate() {
                let Some(share) = self.share(receiver && sun.indirect_only) else { continue };
                // Several suns share two numbers, each shifted by another multiple of the golden ratio.
                let shift = i as f32 * GOLDEN;
                let u = [(a + shift).fract(), (b + 2.0 * shift).fract()];
                let light = sun.sample(u);
                let weight = self.chance_weight(arrival, vertex, Source::Sun(i), &light);
                out.small += self.lit(vertex, &light, share, rays) * weight;
            }
            if sky {
                out.area += self.sky(vertex, [c, d], rays);
            }
        }
        if area && let Some(responses) = self.responses() {
            out.area += self.sky_by_chance(responses, vertex, sequence, rays);
        }
        if let Some(media) = self.glowing() {
            let asked = if receiver && self.fires_apart() { small } else { area };
            match self.fires() {
                Some(fires) if asked => {
                    let [u, v, w, _] = sequence.next4();
                    let seen = |wi, t_max, rays: &mut u32| self.unblocked(vertex, wi, t_max, rays);
                    out.area += self.lit_by(fires, vertex, (1, [u, v, w]), &seen, rays);
                }
                None if area => out.area += self.fire(media, vertex, sequence.next4(), rays),
                _ => {}
            }
        }
        out
    }

    /// Whether texels gather the light straight from emissive triangles with that of lamps.
    pub(crate) fn emitters_apart(&self) -> bool {
        self.emitters_apart && self.lights.emitters_by == Selection::Tree
    }

    /// Whether texels gather the light straight from fires with that of lamps.
    pub(crate) fn fires_apart(&self) -> bool {
        self.emitters_apart && self.fires().is_some()
    }

    /// What counts of a light of which the game may add the unscattered part; `None` if nothing does.
    fn share(&self, of_the_game: bool) -> Option<Share> {
        match (of_the_game, self.responses()) {
            (false, _) => Some(Share::All),
            (true, Some(_)) => Some(Share::Scattered),
            (true, None) => None,
        }
    }

    fn punctual(&self, at: &Asked<'_>, u: f64, rays: &mut u32) -> Rgb {
        let Asked { vertex, receiver, arrival, n } = *at;
        let list = &self.lights.punctual;
        // What the grid holds is asked of it.
        let by_grid = receiver && self.lights.lamp_grid.is_some();
        let share = |i: usize| {
            if by_grid && list[i].suits_grid() { None } else { self.share(receiver && list[i].indirect_only) }
        };
        if self.lights.small.one_lamp && !by_grid {
            return self.only_lamp(at, rays);
        }
        let by = self.lights.lamps_by;
        if by == Selection::All || (by == Selection::Weighed && receiver && list.len() <= EVERY_LAMP) {
            return (0..list.len())
                .filter_map(|i| Some((i, share(i)?, list[i].incident(vertex.position)?)))
                .map(|(i, share, light)| {
                    let weight = self.chance_weight(arrival, vertex, Source::Punctual(i), &light);
                    self.lit(vertex, &light, share, rays) * weight
                })
                .sum();
        }
        if let Some(many) = self.lights.many_lamps() {
            let among = match (receiver && self.responses().is_none(), by_grid) {
                (true, true) => Among::BesideGrid,
                (true, false) => Among::BakedLamps,
                (false, _) => Among::Lamps,
            };
            let mut sum = Vec3::ZERO;
            many.several(&self.emitter_receiver(vertex), among, n, u, &mut |light, _, chance| {
                let Chosen::Lamp(i) = light else { return };
                if let Some((share, light)) = share(i).zip(list[i].incident(vertex.position)) {
                    let weight = self.chance_weight(arrival, vertex, Source::Punctual(i), &light);
                    sum += self.lit(vertex, &light, share, rays) * (weight / chance);
                }
            });
            return sum;
        }
        let weight = |i: usize| {
            if share(i).is_none() {
                return 0.0;
            }
            match list[i].incident(vertex.position) {
                Some(light) => {
                    luminance(light.illuminance) * self.least_cosine(vertex, light.wi, light.distance)
                }
                None => 0.0,
            }
        };
        let total: f32 = (0..list.len()).map(weight).sum();
        if total <= 0.0 {
            return Vec3::ZERO;
        }
        if !total.is_finite() {
            // Nothing can be chosen by such weights: it is for the gate to count.
            return Vec3::splat(total);
        }
        #[expect(clippy::cast_possible_truncation, reason = "24 bits are enough for a few")]
        let mut rest = u as f32 * total;
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
        let Some((share, light)) = share(i).zip(list[i].incident(vertex.position)) else { return Vec3::ZERO };
        let weight = self.chance_weight(arrival, vertex, Source::Punctual(i), &light);
        self.lit(vertex, &light, share, rays) * (weight / probability)
    }

    /// Light of the one lamp that there is: what choosing it among others gives, which it has no need of.
    fn only_lamp(&self, at: &Asked<'_>, rays: &mut u32) -> Rgb {
        let Asked { vertex, receiver, arrival, .. } = *at;
        let lamp = &self.lights.punctual[0];
        let asked = self.share(receiver && lamp.indirect_only).zip(lamp.incident(vertex.position));
        let Some((share, light)) = asked else { return Vec3::ZERO };
        if !receiver {
            let weight = luminance(light.illuminance) * self.least_cosine(vertex, light.wi, light.distance);
            if !(0.0 < weight && weight.is_finite()) {
                return Vec3::ZERO;
            }
        }
        let weight = self.chance_weight(arrival, vertex, Source::Punctual(0), &light);
        self.lit(vertex, &light, share, rays) * weight
    }

    /// The cosine that a light's weight counts with; by way of media it also brings light where it is low.
    fn least_cosine(&self, vertex: &Vertex, wi: Vec3A, distance: f32) -> f32 {
        let cos = wi.dot(vertex.shading_normal).max(0.0);
        if self.responses().is_some() && vertex.faces(wi, distance) { cos.max(LEAST_COSINE) } else { cos }
    }

    /// A light without area, as far as it is not shadowed.
    #[inline(always)]
    fn lit(&self, vertex: &Vertex, light: &Incident, share: Share, rays: &mut u32) -> Rgb {
        match self.responses().filter(|_| vertex.faces(light.wi, light.distance)) {
            None => {
                let cos = light.wi.dot(vertex.shading_normal);
                if cos <= 0.0 {
                    return Vec3::ZERO;
                }
                let left = self.unblocked(vertex, light.wi, up_to(vertex, light), rays);
                let left = match self.media() {
                    None => left,
                    Some(media) => weakened(left, media, vertex.position, light.wi, up_to(vertex, light)),
                };
                light.illuminance * (cos * FRAC_1_PI) * left
            }
            Some(responses) => self.lit_through(responses, vertex, light, share, rays),
        }
    }

    /// The same by way of media as tables see them.
    #[inline(never)]
    fn lit_through(
        &self,
        responses: &Responses,
        vertex: &Vertex,
        light: &Incident,
        share: Share,
        rays: &mut u32,
    ) -> Rgb {
        let cos = light.wi.dot(vertex.shading_normal);
        let cos = if share == Share::All { cos.max(0.0) } else { 0.0 };
        let left = self.unblocked(vertex, light.wi, up_to(vertex, light), rays);
        if left == Vec3::ZERO {
            return left;
        }
        light.illuminance * left * self.lamp_through(responses, vertex, light, cos)
    }

    /// How emitters see a vertex: by way of media they light it from its plane and, where it has no surface, from behind as well.
    pub(crate) fn emitter_receiver(&self, vertex: &Vertex) -> Receiver {
        let below = match self.responses() {
            None => 0.0,
            // Where the two planes differ what is below one of them may light the medium over the other.
            Some(_) if vertex.detached || vertex.shading_normal != vertex.geometric_normal => {
                f32::NEG_INFINITY
            }
            Some(_) => vertex.below(),
        };
        Receiver { position: vertex.position, normal: vertex.shading_normal, below }
    }

    fn emitters(&self, vertex: &Vertex, n: usize, u: f64, v: [f32; 2], rays: &mut u32) -> Rgb {
        let (lights, at) = (self.lights, self.emitter_receiver(vertex));
        let emitters = &lights.emitters;
        if lights.emitters_by == Selection::All {
            let each = (0..emitters.len()).filter_map(|k| emitters.sample_on(k, 1.0, &at, v));
            return each.map(|s| self.emitter(vertex, &s, rays)).sum();
        }
        let Some(many) = lights.many_emitters() else {
            #[expect(clippy::cast_possible_truncation, reason = "24 bits are enough for a few")]
            let sample = emitters.sample(&at, u as f32, v);
            return sample.map_or(Vec3::ZERO, |s| self.emitter(vertex, &s, rays));
        };
        let (mut sum, mut v) = (Vec3::ZERO, v);
        many.several(&at, Among::Emitters, n, u, &mut |light, one, chance| {
            let Chosen::Emitter(k) = light else { return };
            // Weighed as if it had been chosen alone, as light that is found by chance is.
            if let Some(s) = emitters.sample_on(k, one, &at, v) {
                sum += self.emitter(vertex, &s, rays) * (one / chance);
            }
            v = [(v[0] + GOLDEN).fract(), (v[1] + 2.0 * GOLDEN).fract()];
        });
        sum
    }

    /// Light of a point on an emissive triangle.
    fn emitter(&self, vertex: &Vertex, s: &EmitterSample, rays: &mut u32) -> Rgb {
        let cos = s.wi.dot(vertex.shading_normal);
        let responses = self.responses().filter(|_| vertex.faces(s.wi, s.distance));
        if (cos <= 0.0 || s.pdf_solid_angle <= 0.0) && responses.is_none() {
            return Vec3::ZERO;
        }
        let emission = self.world.shade(self.scene, s.triangle, s.bary).emission;
        if emission == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let at = self.world.point(s.triangle, s.bary);
        let cos = cos.max(0.0);
        let by_cosine = cos_hemisphere_pdf(cos);
        let Some(responses) = responses else {
            let weight = 1.0 / (s.pdf_solid_angle + by_cosine);
            let left = self.unblocked_from(&at, s.wi, vertex, rays);
            let left = match self.media() {
                Some(media) if left != Vec3::ZERO => {
                    left * media.transmittance(vertex.position, s.wi, (s.distance - 2.0 * at.offset).max(0.0))
                }
                _ => left,
            };
            return emission * left * (cos * FRAC_1_PI * weight);
        };
        let facing = -s.wi.dot(at.geometric_normal);
        let both = self.world.material(self.scene, s.triangle).double_sided;
        // What is seen along its plane lights the medium all the same.
        if !both && facing * s.distance < vertex.below() {
            return Vec3::ZERO;
        }
        let left = self.unblocked_from(&at, s.wi, vertex, rays);
        if left == Vec3::ZERO {
            return left;
        }
        let normal = if facing < 0.0 && both { -at.geometric_normal } else { at.geometric_normal };
        let turn = facing.abs() / (s.distance * s.distance);
        let spread = self.patch_spread(responses, vertex, s.wi, s.distance, normal, cos * turn);
        emission * left * spread / (s.pdf_area + by_cosine * turn)
    }

    fn sky(&self, vertex: &Vertex, u: [f32; 2], rays: &mut u32) -> Rgb {
        let Some((wi, pdf)) = self.sky_direction(vertex, u) else { return Vec3::ZERO };
        let cos = wi.dot(vertex.shading_normal);
        let radiance = self.lights.sky.radiance(wi);
        let responses = self.responses().filter(|_| vertex.faces(wi, f32::INFINITY));
        if (cos <= 0.0 && responses.is_none()) || pdf <= 0.0 || radiance == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let cos = cos.max(0.0);
        let by_cosine = cos_hemisphere_pdf(cos);
        let Some(responses) = responses else {
            let seen = self.transmittance(vertex, wi, f32::INFINITY, rays);
            return radiance * seen * (cos * FRAC_1_PI / (pdf + by_cosine));
        };
        let left = self.unblocked(vertex, wi, f32::INFINITY, rays);
        if left == Vec3::ZERO {
            return left;
        }
        radiance * left * self.sky_spread(responses, vertex, wi, pdf + by_cosine)
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
    #[inline(always)]
    pub(crate) fn transmittance(&self, from: &Vertex, wi: Vec3A, t_max: f32, rays: &mut u32) -> Rgb {
        let left = self.unblocked(from, wi, t_max, rays);
        match self.media() {
            None => left,
            Some(media) => weakened(left, media, from.position, wi, t_max),
        }
    }

    /// What surfaces leave of light along a segment.
    #[inline(always)]
    pub(crate) fn unblocked(&self, from: &Vertex, wi: Vec3A, t_max: f32, rays: &mut u32) -> Rgb {
        // Rays start off the plane, so they are shorter by up to as much.
        let t_max = t_max - from.offset;
        self.unblocked_along(&from.ray(wi, t_max), rays)
    }

    /// What surfaces leave of light from a point on a surface that is seen in the direction `wi`.
    fn unblocked_from(&self, at: &SurfacePoint, wi: Vec3A, to: &Vertex, rays: &mut u32) -> Rgb {
        let lit = if wi.dot(at.geometric_normal) <= 0.0 { at.geometric_normal } else { -at.geometric_normal };
        let origin = to.ray(wi, f32::INFINITY).origin;
        // Off both surfaces: were it only off one, a thin tube's near side would hide a part of what it shows.
        let way = at.position + lit * at.offset - origin;
        let t_max = way.length();
        self.unblocked_along(&Ray { origin, direction: way / t_max, t_max }, rays)
    }

    fn unblocked_along(&self, ray: &Ray, rays: &mut u32) -> Rgb {
        if ray.t_max.is_nan() || ray.t_max <= 0.0 {
            return Vec3::ONE;
        }
        *rays += 1;
        let mut left = Vec3::ONE;
        let blocked = self.bvh.occluded(ray, |hit| {
            left *= self.world.pass(self.scene, hit.triangle, hit.bary);
            left == Vec3::ZERO
        });
        if blocked { Vec3::ZERO } else { left }
    }
}
