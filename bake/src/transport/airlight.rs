//! Light that media scatter towards a ray: the rung `bounded`.
//!
//! What arrives in the media the light grid knows ([`super::light_grid`]) but for what suns, lamps and emissive surfaces bring straight away. Along every ray
//! the means of the grid's cells in which nothing stands are summed, with those suns that the whole cell sees. What they do not know is
//! found out now and then at one place that free flight finds: there one of the nodes that see the place says what arrives, suns are looked
//! at, and the difference to what the cell knew is weighed up. So the sum takes most of the noise and none of the light: however coarse the grid is, light that is
//! scattered once has the right mean, and what is dark inside of things stays so exactly. Light of lamps and small emissive
//! surfaces is gathered apart, [`super::lamps`]. It comes to the places where it is scattered through media that let their forward peak
//! pass ([`crate::media::Media::smoothed`]): what was scattered before by a small angle counts as not scattered.
//!
//! What was tried (`bake run --quality medium`; noise: root of the mean squared difference of two seeds but for the worst hundredth of the texels, as a part of the mean; time: of the
//! whole bake over `--media off`, which has a noise of 4.9 % in the hall and 1.0 % in Sponza, 512 x 512 texels, in haze of 0.02/m under sun and sky). What is built has
//! 7.9 % in the hall.
//!
//! - One place on each ray for the grid's light and one for a lamp, both now and then: 14.0 % at 1.16 in the hall, 1.6 % at 1.06 in Sponza. In rooms with a lamp
//!   the variance of that has no bound.
//! - Finding out twice as often what cells do not know: in the hall from 7.4 to 6.4 % for 10 % of the time. Sponza, without lamps: from 1.6 % (as often as light is
//!   lost) to 1.3 (twice) and 1.0 % (eight times), for 6 % of the time.
//! - Finding it out less often where nothing stands and no shadow ends: nothing gained, most cells not being of this kind.
//! - Cells that know the mean of their nodes' directional bands as well: no less noise at g = 0.3.
//! - Cells in which something stands that know what all of their nodes see: noise less by 2 to 5 %, but the insides of small bodies were
//!   no longer exactly dark, which is how they are told.
//! - The mean of a cell taken for all of a quarter of the ray, weighed exactly, instead of places that free flight finds in each quarter: 1.15 to 1.4 times the noise between
//!   grey walls.
//! - Two places in place of four: the same noise, no time saved.

use crate::geom::Ray;
use crate::geom::ray::offset_distance;
use crate::geom::world::pack;
use crate::light::Sun;
use crate::media::Media;
use crate::sample::Sequence;
use crate::scene::model::Rgb;
use crate::transport::air::{Crossed, Way, henyey_greenstein_direction};
use crate::transport::direct::Part;
use crate::transport::light_grid::{Inside, LightGrid, Seen, dot, even, scattering};
use crate::transport::path::{Kernel, Leg, Stage, Vertex};
use glam::{Vec3, Vec3A};

/// Rays find out what cells do not know as often as light is scattered or absorbed on them, times this: the thinner the media, the less they cost.
const EAGER: f32 = 3.0;

/// The same where there are lamps: their light, which is gathered apart, takes its share of the time.
const EAGER_BESIDE_LAMPS: f32 = 1.0;

/// Share of places at which a ray asks what the cell believes to know.
const DOUBT: f32 = 1.0 / 8.0;

/// Where a path from a node reaches into the grid: light that this node gets from another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Link {
    /// The other node.
    pub(crate) node: u32,
    /// Direction of the ray that its light is scattered into, as [`pack`] has it.
    pub(crate) direction: u32,
    /// How much of that arrives.
    pub(crate) weight: Rgb,
    /// Mean cosine.
    pub(crate) g: f32,
}

/// One of the links of a path, each chosen as often as it weighs; where media are coloured, one for each channel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Links {
    /// What of the light at the path's present vertex arrives.
    pub(crate) throughput: Rgb,
    chosen: [Option<Link>; 3],
    total: [f32; 3],
    /// What all links together weigh, channel by channel.
    pub(crate) expected: Rgb,
}

impl Links {
    pub(crate) fn new() -> Self {
        Self { throughput: Vec3::ONE, chosen: [None; 3], total: [0.0; 3], expected: Vec3::ZERO }
    }

    fn offer(&mut self, channel: usize, link: Link, u: f32) {
        let weight = link.weight.max_element();
        if 0.0 < weight && weight.is_finite() {
            self.total[channel] += weight;
            if u * self.total[channel] < weight {
                self.chosen[channel] = Some(link);
            }
        }
    }

    /// The links that stand for all of them: the first for all channels, or each for one.
    pub(crate) fn chosen(&self) -> [Option<Link>; 3] {
        std::array::from_fn(|k| {
            let link = self.chosen[k]?;
            Some(Link { weight: link.weight * (self.total[k] / link.weight.max_element()), ..link })
        })
    }
}

/// Numbers that choose the node of a landing, channel by channel.
const LANDINGS: [u32; 3] = [1, 4, 5];

/// Numbers that choose where a ray asks the cells what they know.
const KNOWN: u32 = 7;

impl<const AIR: bool> Kernel<'_, AIR> {
    /// Lamps and emissive surfaces, and behind them suns: the numbers by which the grid's cells know them.
    pub(crate) fn air_lights(&self) -> usize {
        let l = self.lights;
        l.punctual.len() + l.emitters.groups().len() + l.suns.len()
    }

    /// Suns by their number, the direction towards their middle and their illuminance, lux.
    pub(crate) fn suns_of_air(&self) -> Vec<(usize, Vec3A, Rgb)> {
        let first = self.air_lights() - self.lights.suns.len();
        let of = |(i, sun): (usize, &Sun)| (first + i, sun.frame().z, sun.sample([0.5; 2]).illuminance);
        self.lights.suns.iter().enumerate().map(of).collect()
    }

    /// Whether a light of a number is seen from a place, for the grid: by one ray, emissive surfaces by four.
    pub(crate) fn looks(&self, p: Vec3A, light: usize, sequence: &mut Sequence) -> Seen {
        let l = self.lights;
        let groups = l.emitters.groups();
        let mut seen = [false; 3];
        let mut ask = |wi: Vec3A, distance: f32| {
            let left = self.unblocked(&in_air(p), wi, distance, &mut 0);
            let k = if left == Vec3::ONE {
                1
            } else if left == Vec3::ZERO {
                0
            } else {
                2
            };
            seen[k] = true;
        };
        if light < l.punctual.len() {
            let d = l.punctual[light].position() - p;
            ask(d.normalize_or_zero(), reach(p, d));
        } else if light < l.punctual.len() + groups.len() {
            let group = &groups[light - l.punctual.len()];
            for _ in 0..4 {
                let [a, b, c, _] = sequence.next4();
                let at = l.emitters.sample_group(group, a, [b, c]);
                let d = at.position - p;
                ask(d.normalize_or_zero(), d.length() - 2.0 * self.world.point(at.triangle, at.bary).offset);
            }
        } else {
            let [a, b, _, _] = sequence.next4();
            ask(l.suns[light - l.punctual.len() - groups.len()].sample([a, b]).wi, f32::INFINITY);
        }
        match seen {
            [true, false, false] => Seen::Nowhere,
            [false, true, false] => Seen::Everywhere,
            _ => Seen::Perhaps,
        }
    }

    /// Radiance that media scatter into the first `length` metres of a ray, which they cross, towards its origin, nits; that of
    /// lamps is left out.
    ///
    /// What the grid's cells know of it is summed along the ray; what they do not know is found out at one place, now and then.
    pub(crate) fn airlight(
        &self,
        (media, grid): (&Media, &LightGrid),
        (origin, direction, length): (Vec3A, Vec3A, f32),
        crossed: &Crossed,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let Some(way) = Way::across(media, (origin, direction, length), crossed) else { return Vec3::ZERO };
        let [u, coin, v, _] = sequence.coins(KNOWN);
        let places = way.places(crossed, u);
        let phase = places.as_ref().map_or(0.0, |p| grid.phase_of_sun(direction, p.g));
        let known = places.as_ref().map_or(Vec3::ZERO, |p| {
            grid.known_along(phase, origin + direction * p.first, direction * p.step, &p.weights)
        });
        let eager = if self.has_lamps_in_air() { EAGER_BESIDE_LAMPS } else { EAGER };
        let chance = (eager * crossed.gone).min(1.0);
        if chance < 1.0 && chance <= coin {
            return known;
        }
        let mut rest = Vec3::ZERO;
        if let Some(landing) = way.land(v) {
            let p = origin + direction * landing.at;
            let at = grid.inside(p);
            let [b, c, d, _] = sequence.coins(LANDINGS[0]);
            let arrives = match self.node(grid, p, at, [b, c, d], rays) {
                Some(node) if media.small().isotropic => even(grid.light(node)),
                Some(node) => dot(grid.light(node), &scattering(direction, media.bands(landing.g))),
                None => self.unseen(p, direction, landing.g, [b, c], sequence, rays),
            };
            let suns = self.suns_in_air((media, grid), (p, at), direction, landing.g, sequence, rays);
            let known = if places.is_some() { grid.known(at.cell, phase) } else { Vec3::ZERO };
            rest += landing.weight * (arrives + suns - known);
        }
        known + rest / chance
    }

    /// As [`Kernel::airlight`], for a path from a node that has come so far: the light that the grid holds is left out and said in `links` instead.
    pub(crate) fn airlight_linked(
        &self,
        (media, grid): (&Media, &LightGrid),
        (origin, direction, length): (Vec3A, Vec3A, f32),
        (links, so_far): (&mut Links, Rgb),
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let Some(way) = Way::new(media, origin, direction, length) else { return Vec3::ZERO };
        let mut sum = Vec3::ZERO;
        let [u, ..] = sequence.next4();
        // Links are exact channel by channel, and together with their noise in common they would not be.
        let channels = media.channels();
        for (channel, purpose) in LANDINGS.into_iter().enumerate().take(channels) {
            let landing = if channels == 1 { way.land(u) } else { way.land_in(channel, u) };
            let Some(landing) = landing else { continue };
            let p = origin + direction * landing.at;
            let at = grid.inside(p);
            let [b, c, d, e] = sequence.coins(purpose);
            let arrives = match self.node(grid, p, at, [b, c, d], rays) {
                #[expect(clippy::cast_possible_truncation, reason = "fewer nodes than 2^32")]
                Some(node) => {
                    let weight = so_far * landing.weight;
                    links.expected += weight;
                    let link = Link { node: node as u32, direction: pack(direction), weight, g: landing.g };
                    links.offer(channel, link, e);
                    Vec3::ZERO
                }
                None => self.unseen(p, direction, landing.g, [b, c], sequence, rays),
            };
            let suns = self.suns_in_air((media, grid), (p, at), direction, landing.g, sequence, rays);
            sum += landing.weight * (arrives + suns);
        }
        sum
    }

    /// What surfaces send to a place that no node sees, a corner or a corridor finer than the grid.
    fn unseen(
        &self,
        p: Vec3A,
        direction: Vec3A,
        g: f32,
        u: [f32; 2],
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let wi = henyey_greenstein_direction(direction, g, u);
        Kernel { grid: None, ..*self }.arrives(&in_air(p), wi, None, sequence, rays)
    }

    /// Mean radiance over all directions at a place, of the nodes around that see it, by trilinear weights, nits; black where none does.
    pub(crate) fn mean_around(&self, grid: &LightGrid, p: Vec3A) -> Rgb {
        let at = grid.inside(p);
        let (mut sum, mut all) = (Vec3::ZERO, 0.0);
        for k in 0..8 {
            let side = |axis: usize| if k >> axis & 1 == 1 { at.part[axis] } else { 1.0 - at.part[axis] };
            let weight = side(0) * side(1) * side(2);
            let node = grid.corner(at, k);
            let d = grid.node(node) - p;
            let t_max = d.length();
            let ray = Ray { origin: p, direction: d / t_max.max(1e-30), t_max };
            if 0.0 < weight && !(grid.is_occupied(at.cell) && self.blocked(&ray)) {
                sum += weight * even(grid.light(node));
                all += weight;
            }
        }
        if 0.0 < all { sum / all } else { Vec3::ZERO }
    }

    /// One of the nodes around a place that see it, each as likely as trilinear interpolation weighs it.
    fn node(&self, grid: &LightGrid, p: Vec3A, at: Inside, u: [f32; 3], rays: &mut u32) -> Option<usize> {
        let end = |k: usize| usize::from(u[k] < at.part[k]);
        let corner = end(0) | end(1) << 1 | end(2) << 2;
        let first = grid.corner(at, corner);
        if !grid.is_occupied(at.cell) {
            return Some(first);
        }
        let mut sees = |node: usize| {
            let d = grid.node(node) - p;
            let t_max = d.length();
            *rays += 1;
            !self.blocked(&Ray { origin: p, direction: d / t_max.max(1e-30), t_max })
        };
        if sees(first) {
            return Some(first);
        }
        let mut weights: [f32; 8] = std::array::from_fn(|k| {
            let side = |axis: usize| if k >> axis & 1 == 1 { at.part[axis] } else { 1.0 - at.part[axis] };
            side(0) * side(1) * side(2)
        });
        weights[corner] = 0.0;
        // A number that the first choice has left.
        let mut v = (u[0] * 7.0 + u[1] * 5.0 + u[2] * 3.0).fract();
        for _ in 0..7 {
            let total: f32 = weights.iter().sum();
            if total <= 0.0 {
                return None;
            }
            let mut rest = v * total;
            let k = weights
                .iter()
                .position(|w| {
                    rest -= w;
                    rest < 0.0
                })
                .unwrap_or(7);
            let node = grid.corner(at, k);
            if 0.0 < weights[k] && sees(node) {
                return Some(node);
            }
            weights[k] = 0.0;
            v = (v * 9.0 + 0.618_034).fract();
        }
        None
    }

    /// A place in the box around a node that is nearer to it than to others, if the node sees it: what a node knows is a mean over its surroundings, for next to
    /// lamps light has no bound.
    pub(crate) fn near_node(&self, grid: &LightGrid, node: usize, u: [f32; 3], rays: &mut u32) -> Vec3A {
        let p = grid.node(node);
        let near = grid.near(node, u);
        let d = near - p;
        let t_max = d.length();
        let free = !grid.is_occupied(grid.inside(near).cell) || {
            *rays += 1;
            !self.blocked(&Ray { origin: p, direction: d / t_max.max(1e-30), t_max })
        };
        if free { near } else { p }
    }

    /// How much of a light's rays gets to a place: by what the grid knows, by a ray where it does not, and by one now and then where it does.
    pub(crate) fn seen(
        &self,
        grid: &LightGrid,
        at: Inside,
        light: usize,
        coin: f32,
        ask: impl FnOnce() -> Rgb,
    ) -> Rgb {
        let known = match grid.seen(at.cell, light) {
            Seen::Perhaps => return ask(),
            Seen::Everywhere => Vec3::ONE,
            Seen::Nowhere => Vec3::ZERO,
        };
        if coin < DOUBT { known + (ask() - known) / DOUBT } else { known }
    }

    /// Light of suns that a place scatters along `direction`, per unit of sigma_s.
    fn suns_in_air(
        &self,
        (media, grid): (&Media, &LightGrid),
        (p, at): (Vec3A, Inside),
        direction: Vec3A,
        g: f32,
        sequence: &Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let suns = &self.lights.suns;
        if suns.is_empty() {
            return Vec3::ZERO;
        }
        let first = self.lights.punctual.len() + self.lights.emitters.groups().len();
        let [a, b, c, _] = sequence.coins(3);
        let mut sum = Vec3::ZERO;
        for (i, sun) in suns.iter().enumerate() {
            let shift = i as f32 * 0.618_034;
            let light = sun.sample([(a + shift).fract(), (b + 2.0 * shift).fract()]);
            let left = self.seen(grid, at, first + i, (c + shift).fract(), || {
                self.unblocked(&in_air(p), light.wi, f32::INFINITY, rays)
            });
            if left != Vec3::ZERO {
                let phase = media.phase(g, light.wi.dot(direction));
                let through = grid.media().transmittance(p, light.wi, f32::INFINITY);
                sum += light.illuminance * left * through * phase;
            }
        }
        sum
    }

    /// Radiance that arrives at a place in the air from `wi`, but for what suns, lamps and emitters bring straight away. With
    /// `links` the light of the grid is left out and said there.
    pub(crate) fn arrives(
        &self,
        from: &Vertex,
        wi: Vec3A,
        mut links: Option<&mut Links>,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let leg = self.follow_in_air(from, wi, links.as_deref_mut(), sequence, rays);
        self.leg_brings(leg, links, sequence, rays)
    }

    /// Radiance that a leg brings to its beginning, with what is reflected at its end.
    pub(crate) fn leg_brings(
        &self,
        leg: Leg,
        mut links: Option<&mut Links>,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Rgb {
        let mut sum = leg.emitted + leg.airlight;
        if self.bounces == Some(0) {
            return sum;
        }
        if let Some((next, reflectance)) = leg.next {
            let far = self.cache.is_some_and(|cache| cache.near() <= leg.travelled);
            let light = match if far { self.cached(&next, rays) } else { None } {
                Some(cached) => cached + self.direct(&next, Part::Small, false, None, sequence, rays).small,
                None => {
                    let [a, b, _, _] = sequence.next4();
                    if let Some(links) = links.as_deref_mut() {
                        links.throughput = reflectance * leg.rest;
                    }
                    let path =
                        self.walk_surfaces(&next, [a, b], Part::All, Stage::Branch(1), links, sequence);
                    *rays += path.rays;
                    path.direct + path.indirect
                }
            };
            sum += reflectance * leg.rest * light;
        }
        sum
    }
}

/// A place that is not on a surface.
pub(crate) fn in_air(p: Vec3A) -> Vertex {
    Vertex {
        position: p,
        geometric_normal: Vec3A::ZERO,
        shading_normal: Vec3A::ZERO,
        offset: 0.0,
        open: false,
        detached: true,
    }
}

/// How far a ray to a lamp at `p + d` may go without meeting what the lamp lies on.
pub(crate) fn reach(p: Vec3A, d: Vec3A) -> f32 {
    d.length() - offset_distance((p + d).abs().max_element())
}
