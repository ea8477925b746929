//! Light of lamps and small emissive surfaces that media scatter once.
//!
//! Seen from a receiver it is brightest next to the lamp: radiance grows like the inverse of the sine of the angle between the ray and the lamp, and by
//! rays that follow the cosine its variance has no bound. So the first leg of a receiver's light is gathered by rays of their own, [`Kernel::lamps_through_air`]:
//! their angle from the lamp is uniform, which cancels the sine, and the place on them is equi-angular (\[KF12\]), which cancels the square of the
//! distance. Where the receiver is outside of a spot's cone, rays start at the lamp and fill the cone, and the place on them is equi-angular as the
//! receiver sees it. Vertices behind the first do so now and then, [`Kernel::lamps_now_and_then`].
//!
//! Whether a light is seen from a place the cell of the light grid mostly knows, all of its nodes being of one opinion; where they are
//! not, a ray asks, and elsewhere one does now and then, with the difference weighed up, so that the mean is right however coarse the grid is.

use crate::geom::Ray;
use crate::geom::ray::offset_distance;
use crate::geom::world::luminance;
use crate::light::emitters::{Group, GroupSample};
use crate::light::many::{Among, Chosen};
use crate::light::punctual::{Incident, Punctual};
use crate::light::tree::{FallOff, Receiver};
use crate::light::{ManyLights, Selection};
use crate::media::Media;
use crate::sample::Sequence;
use crate::sample::warp::{Frame, square_to_cone};
use crate::scene::model::Rgb;
use crate::transport::air::{Crossed, Way, equi_angular};
use crate::transport::airlight::{in_air, reach};
use crate::transport::direct::{FINE, finer};
use crate::transport::encounter::Onward;
use crate::transport::light_grid::LightGrid;
use crate::transport::path::{Kernel, MAX_LAYERS, Vertex};
use glam::{Vec3, Vec3A};
use std::f32::consts::{FRAC_1_PI, PI};

/// So many lights' weights fit on the stack.
const FEW: usize = 16;

/// Vertices behind the first are asked for lamps' light in the air as often as light is lost on the way to the nearest lamp, times this.
const EAGER: f32 = 0.25;

/// And at least so often.
const LEAST: f32 = 1.0 / 16.0;

/// Which of the small emissive surfaces are asked for their light straight away.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Patches {
    /// None: paths find them by chance.
    None,
    /// All.
    All,
    /// Those that are far away: paths find the others.
    Far,
}

/// What brings light straight to a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Straight {
    /// A sun or a lamp.
    Punctual,
    /// A small emissive surface.
    Patch,
}

/// A lamp, or a place on an emissive surface that stands for all of it, with its number among the lights that media see.
enum Lamp<'a> {
    Punctual(usize, &'a Punctual),
    Patch(usize, GroupSample),
}

impl Lamp<'_> {
    fn position(&self) -> Vec3A {
        match self {
            Self::Punctual(_, lamp) => lamp.position(),
            Self::Patch(_, at) => at.position,
        }
    }
}

impl<const AIR: bool> Kernel<'_, AIR> {
    /// Whether there are lights of the kind that [`Kernel::lamps_through_air`] gathers.
    pub(crate) fn has_lamps_in_air(&self) -> bool {
        let l = self.lights;
        self.grid().is_some() && !(l.punctual.is_empty() && l.emitters.groups().is_empty())
    }

    /// Light of lamps and small emissive surfaces that media scatter between a vertex and what it sees, `E / pi`, nits. What passes from there on
    /// is left to paths.
    pub(crate) fn lamps_through_air(&self, at: &Vertex, sequence: &mut Sequence, rays: &mut u32) -> Rgb {
        let mut sum = Vec3::ZERO;
        self.lamps_around(at, sequence, rays, &mut |_, light| sum += light);
        sum
    }

    /// The same with the direction that it comes from; at a place in the air the light is that of all directions, nits times steradian.
    pub(crate) fn lamps_around(
        &self,
        at: &Vertex,
        sequence: &mut Sequence,
        rays: &mut u32,
        visit: &mut dyn FnMut(Vec3A, Rgb),
    ) {
        let Some((media, grid)) = self.media().zip(self.grid()).filter(|_| self.has_lamps_in_air()) else {
            return;
        };
        let (lamps, groups) = (&self.lights.punctual, self.lights.emitters.groups());
        let weigh = |i: usize| -> f32 {
            let (power, d) = match lamps.get(i) {
                Some(lamp) => {
                    let d = lamp.position() - at.position;
                    (luminance(lamp.mean_intensity() + lamp.intensity_towards(at.position)), d.length())
                }
                None => {
                    let group = &groups[i - lamps.len()];
                    (group.intensity, (group.centre - at.position).length().max(group.radius))
                }
            };
            power / d
        };
        let [fine, ..] = sequence.coins(FINE);
        let [a, u, v, w] = sequence.next4();
        let emitters = &self.lights.emitters;
        let (lamp, chance) = match self.tree_in_media() {
            // What is chosen is one triangle, which media know by the surface that it belongs to.
            Some(many) => {
                let place = Receiver::in_air(at.position);
                match many.one(&place, Among::InMedia, FallOff::Linear, finer(a, fine)) {
                    Some((Chosen::Lamp(i), chance)) => (Lamp::Punctual(i, &lamps[i]), chance),
                    Some((Chosen::Emitter(k), chance)) => {
                        let [_, c, d, _] = sequence.next4();
                        let Some(group) = emitters.group_of(k) else { return };
                        (Lamp::Patch(lamps.len() + group, emitters.point_on(k, 1.0, [c, d])), chance)
                    }
                    None => return,
                }
            }
            None => {
                let Some((i, chance)) = choose(lamps.len() + groups.len(), weigh, a) else { return };
                match lamps.get(i) {
                    Some(lamp) => (Lamp::Punctual(i, lamp), chance),
                    None => {
                        let [b, c, d, _] = sequence.next4();
                        (Lamp::Patch(i, emitters.sample_group(&groups[i - lamps.len()], b, [c, d])), chance)
                    }
                }
            }
        };
        let visit = &mut |wi, light: Rgb| visit(wi, light / chance);
        match &lamp {
            Lamp::Punctual(_, lamp) if !lamp.shines_on(at.position) => {
                self.through_cone((media, grid), at, lamp, [u, v, w], (sequence, rays), visit)
            }
            lamp => self.around((media, grid), at, lamp, [u, v, w], (sequence, rays), visit),
        }
    }

    /// The tree, if all lamps and emissive surfaces that media see as lamps are in it.
    fn tree_in_media(&self) -> Option<&ManyLights> {
        let l = self.lights;
        let lamps = l.punctual.is_empty() || l.lamps_by == Selection::Tree;
        let groups = l.emitters.groups().is_empty() || l.emitters_by == Selection::Tree;
        l.many.as_ref().filter(|many| lamps && groups && many.knows_media())
    }

    /// By a ray from the receiver whose angle from the lamp is uniform.
    fn around(
        &self,
        (media, grid): (&Media, &LightGrid),
        at: &Vertex,
        lamp: &Lamp<'_>,
        [u, v, w]: [f32; 3],
        (sequence, rays): (&mut Sequence, &mut u32),
        visit: &mut dyn FnMut(Vec3A, Rgb),
    ) {
        let axis = (lamp.position() - at.position).normalize_or_zero();
        if axis == Vec3A::ZERO {
            return;
        }
        let ((sin, cos), (y, x)) = ((PI * u).sin_cos(), (2.0 * PI * v).sin_cos());
        let mut wi = Frame::new(axis).to_world(Vec3A::new(sin * x, sin * y, cos));
        // Over the density, which is 1 / (2 pi^2 sin).
        let mut weight = 2.0 * PI * PI * sin;
        if is_surface(at) {
            // Of a direction and its opposite one is above the surface, and has the density of both.
            if wi.dot(at.shading_normal) < 0.0 {
                wi = -wi;
            }
            weight *= 0.5;
        }
        weight *= counts(at, wi);
        if weight <= 0.0 {
            return;
        }
        let mut ray = at.ray(wi, f32::INFINITY);
        let mut left = Vec3::splat(weight);
        for _ in 0..MAX_LAYERS {
            *rays += 1;
            let hit = self.closest(&ray);
            let length = hit.map_or(f32::INFINITY, |h| h.t);
            if let Some(way) = Way::new(media, ray.origin, wi, length) {
                let light = left
                    * self.scattered_once((media, grid), &way, (ray.origin, wi), lamp, (w, sequence), rays);
                visit(wi, light);
            }
            let Some(hit) = hit.filter(|h| self.world.pass(self.scene, h.triangle, h.bary) != Vec3::ZERO)
            else {
                break;
            };
            let Onward::Through { tint, origin } = self.encounter(&hit, wi).onward(sequence) else { break };
            left *= tint * Crossed::new(media, (ray.origin, wi, length)).left;
            ray.origin = origin;
        }
    }

    /// By a ray from a spot within its cone.
    fn through_cone(
        &self,
        (media, grid): (&Media, &LightGrid),
        at: &Vertex,
        lamp: &Punctual,
        [u, v, w]: [f32; 3],
        (sequence, rays): (&mut Sequence, &mut u32),
        visit: &mut dyn FnMut(Vec3A, Rgb),
    ) {
        let Some((axis, one_minus_cos)) = lamp.cone() else { return };
        let direction = Frame::new(axis).to_world(square_to_cone([u, v], one_minus_cos));
        // Off what the lamp may lie on.
        let off = offset_distance(lamp.position().abs().max_element());
        let origin = lamp.position() + direction * off;
        let mut ray = Ray { origin, direction, t_max: f32::INFINITY };
        // Over the density of the direction.
        let mut left = Vec3::splat(2.0 * PI * one_minus_cos);
        for _ in 0..MAX_LAYERS {
            *rays += 1;
            let hit = self.closest(&ray);
            let length = hit.map_or(f32::INFINITY, |h| h.t);
            if let Some(way) = Way::new(media, ray.origin, direction, length) {
                let found = self.scattered_to((media, grid), &way, (&ray, lamp), at, w, rays);
                if let Some((wi, light)) = found {
                    visit(wi, left * light);
                }
            }
            let Some(hit) = hit.filter(|h| self.world.pass(self.scene, h.triangle, h.bary) != Vec3::ZERO)
            else {
                break;
            };
            let Onward::Through { tint, origin } = self.encounter(&hit, direction).onward(sequence) else {
                break;
            };
            left *= tint * Crossed::new(grid.media(), (ray.origin, direction, length)).left;
            ray.origin = origin;
        }
    }

    /// What of a lamp's ray is scattered to a receiver at one place, and the direction in which that lies, per density of the ray's direction.
    fn scattered_to(
        &self,
        (media, grid): (&Media, &LightGrid),
        way: &Way<'_>,
        (ray, lamp): (&Ray, &Punctual),
        at: &Vertex,
        u: f32,
        rays: &mut u32,
    ) -> Option<(Vec3A, Rgb)> {
        let (from, to) = way.span();
        let (t, pdf) = equi_angular(at.position - ray.origin, ray.direction, from, to, u)?;
        let p = ray.origin + ray.direction * t;
        let d = p - at.position;
        let distance = d.length();
        let wi = d / distance;
        let weight = counts(at, wi);
        if weight <= 0.0 || !weight.is_finite() {
            return None;
        }
        let (light, here) = (lamp.incident(p)?, way.coefficients(t)?);
        let seen = self.unblocked(at, wi, distance, rays);
        if seen == Vec3::ZERO {
            return None;
        }
        // The lamp's intensity along the ray; its distance cancels against that of the place.
        let intensity = light.illuminance * (light.distance * light.distance);
        let phase = media.phase(here.g, light.wi.dot(wi));
        let through = grid.media().transmittance(ray.origin, ray.direction, t)
            * media.transmittance(at.position, wi, distance);
        let weight = weight * phase / (pdf * distance * distance);
        Some((wi, intensity * seen * through * here.sigma_s * weight))
    }

    /// As [`Kernel::lamps_through_air`] where the light is one part of many: as often as it is lost on the way to the nearest lamp.
    pub(crate) fn lamps_now_and_then(&self, at: &Vertex, sequence: &mut Sequence, rays: &mut u32) -> Rgb {
        let Some(media) = self.media().filter(|_| self.has_lamps_in_air()) else { return Vec3::ZERO };
        let (lamps, groups) = (&self.lights.punctual, self.lights.emitters.groups());
        let all = lamps.iter().map(Punctual::position).chain(groups.iter().map(|g| g.centre));
        let nearest = self.tree_in_media().and_then(|many| many.nearest(at.position));
        let d = nearest.or_else(|| {
            all.map(|p| p - at.position).min_by(|a, b| a.length_squared().total_cmp(&b.length_squared()))
        });
        let Some(d) = d else { return Vec3::ZERO };
        let length = d.length();
        let crossed = Crossed::new(media, (at.position, d / length.max(f32::MIN_POSITIVE), length));
        let chance = (EAGER * crossed.gone).clamp(LEAST, 1.0);
        if chance < 1.0 && chance <= sequence.coin() {
            return Vec3::ZERO;
        }
        self.lamps_through_air(at, sequence, rays) / chance
    }

    /// Light of a lamp that is scattered into a ray, from one place on it that `u` chooses.
    fn scattered_once(
        &self,
        (media, grid): (&Media, &LightGrid),
        way: &Way<'_>,
        (origin, direction): (Vec3A, Vec3A),
        lamp: &Lamp<'_>,
        (u, sequence): (f32, &Sequence),
        rays: &mut u32,
    ) -> Rgb {
        let (mut from, mut to) = way.span();
        if let Lamp::Punctual(_, lamp) = lamp {
            let Some(lit) = lamp.lit_part(origin, direction, from, to) else { return Vec3::ZERO };
            (from, to) = lit;
        }
        let Some((t, pdf)) = equi_angular(lamp.position() - origin, direction, from, to, u) else {
            return Vec3::ZERO;
        };
        let p = origin + direction * t;
        // Light at the place, the number of the lamp, and how far rays may go that ask for it.
        let (index, light, distance) = match lamp {
            Lamp::Punctual(i, lamp) => {
                let Some(light) = lamp.incident(p) else { return Vec3::ZERO };
                (*i, light, reach(p, light.wi * light.distance))
            }
            Lamp::Patch(i, at) => {
                let Some((light, reach)) = self.patch_at(at, p) else { return Vec3::ZERO };
                (*i, light, reach)
            }
        };
        let Some(here) = way.coefficients(t) else { return Vec3::ZERO };
        let [coin, ..] = sequence.coins(2);
        let left = self
            .seen(grid, grid.inside(p), index, coin, || self.unblocked(&in_air(p), light.wi, distance, rays));
        if left == Vec3::ZERO {
            return Vec3::ZERO;
        }
        let phase = media.phase(here.g, light.wi.dot(direction));
        let through = way.transmittance(t) * grid.media().transmittance(p, light.wi, light.distance);
        light.illuminance * left * through * here.sigma_s * (phase / pdf)
    }

    /// What a place on an emissive surface, which stands for all of it, brings to a place in the air, and how far a ray may go that asks for it.
    fn patch_at(&self, at: &GroupSample, p: Vec3A) -> Option<(Incident, f32)> {
        let d = at.position - p;
        let distance = d.length();
        let wi = d / distance;
        let cos = -wi.dot(at.normal);
        let cos = if at.both_sides { cos.abs() } else { cos };
        if !(0.0 < cos && wi.is_finite()) {
            return None;
        }
        let emission = self.world.shade(self.scene, at.triangle, at.bary).emission;
        let illuminance = emission * (cos / (distance * distance * at.pdf));
        let offset = self.world.point(at.triangle, at.bary).offset;
        Some((Incident { wi, distance, illuminance }, distance - 2.0 * offset))
    }

    /// Light that comes straight to a place in the air, what it is of, where it is and an illuminance each, lux: of suns, of lamps and, as `patches` says, of emissive surfaces that grids do not hold.
    /// Media weaken it. Lights whose direct part the game adds are left out. Of many one stands for all.
    pub(crate) fn straight_to(
        &self,
        media: Option<&Media>,
        patches: Patches,
        p: Vec3A,
        sequence: &mut Sequence,
        rays: &mut u32,
        mut visit: impl FnMut(Straight, &Incident, Rgb),
    ) {
        let l = self.lights;
        let mut see = |of: Straight, light: &Incident, reach: f32, weight: f32, rays: &mut u32| {
            let left = self.unblocked(&in_air(p), light.wi, reach, rays);
            if left != Vec3::ZERO {
                let through = media.map_or(Vec3::ONE, |m| m.transmittance(p, light.wi, light.distance));
                visit(of, light, light.illuminance * left * through * weight);
            }
        };
        let [a, b, c, d] = sequence.next4();
        let [e, f, _, _] = sequence.next4();
        for sun in l.suns.iter().filter(|s| !s.indirect_only) {
            see(Straight::Punctual, &sun.sample([a, b]), f32::INFINITY, 1.0, rays);
        }
        let lamps =
            || l.punctual.iter().filter(|lamp| !lamp.indirect_only).filter_map(|lamp| lamp.incident(p));
        let place = Receiver::in_air(p);
        let fine = sequence.coins(FINE);
        if let Some(many) = l.many_lamps() {
            let chosen = many.one(&place, Among::BakedLamps, FallOff::Square, finer(c, fine[0]));
            if let Some((Chosen::Lamp(i), chance)) = chosen
                && !l.punctual[i].indirect_only
                && let Some(light) = l.punctual[i].incident(p)
            {
                see(Straight::Punctual, &light, reach(p, light.wi * light.distance), 1.0 / chance, rays);
            }
        } else if l.punctual.len() <= FEW {
            for light in lamps() {
                see(Straight::Punctual, &light, reach(p, light.wi * light.distance), 1.0, rays);
            }
        } else {
            let all: f32 = lamps().map(|light| luminance(light.illuminance)).sum();
            let mut rest = c * all;
            for light in lamps() {
                let weight = luminance(light.illuminance);
                rest -= weight;
                if rest < 0.0 {
                    let far = reach(p, light.wi * light.distance);
                    see(Straight::Punctual, &light, far, all / weight, rays);
                    break;
                }
            }
        }
        if patches == Patches::None {
            return;
        }
        let counts = |g: &Group| patches == Patches::All || !g.is_near(p);
        if let Some(many) = l.many_emitters() {
            let chosen = many.one(&place, Among::EmittersInMedia, FallOff::Square, finer(d, fine[1]));
            if let Some((Chosen::Emitter(k), chance)) = chosen
                && l.emitters.group_of(k).is_some_and(|g| counts(&l.emitters.groups()[g]))
            {
                let [w, ..] = sequence.next4();
                let at = l.emitters.point_on(k, 1.0, [f, w]);
                if let Some((light, reach)) = self.patch_at(&at, p) {
                    see(Straight::Patch, &light, reach, 1.0 / chance, rays);
                }
            }
            return;
        }
        let groups = l.emitters.groups();
        let weigh = |g: &Group| {
            let far = (g.centre - p).length_squared().max(g.radius * g.radius);
            if counts(g) { g.intensity / far } else { 0.0 }
        };
        if let Some((i, chance)) =
            choose(groups.len(), |i| weigh(&groups[i]), d).filter(|c| counts(&groups[c.0]))
        {
            let [w, ..] = sequence.next4();
            let at = l.emitters.sample_group(&groups[i], e, [f, w]);
            if let Some((light, reach)) = self.patch_at(&at, p) {
                see(Straight::Patch, &light, reach, 1.0 / chance, rays);
            }
        }
    }
}

/// Whether a vertex is on a surface or given with a normal, and not in the air.
fn is_surface(at: &Vertex) -> bool {
    at.shading_normal != Vec3A::ZERO
}

/// How much light from a direction counts: for surfaces by its cosine over pi, in the air alike.
fn counts(at: &Vertex, wi: Vec3A) -> f32 {
    if !is_surface(at) {
        1.0
    } else if wi.dot(at.geometric_normal) < 0.0 && !at.detached {
        0.0
    } else {
        wi.dot(at.shading_normal) * FRAC_1_PI
    }
}

/// One of `n` in proportion to its weight, and the probability of that.
fn choose(n: usize, weigh: impl Fn(usize) -> f32, u: f32) -> Option<(usize, f32)> {
    if n <= 1 {
        return (n == 1).then_some((0, 1.0));
    }
    // Few are weighed once, many twice.
    let mut weights = [0.0; FEW];
    let total: f32 = if n <= FEW {
        weights[..n].iter_mut().enumerate().for_each(|(i, w)| *w = weigh(i));
        weights.iter().sum()
    } else {
        (0..n).map(&weigh).sum()
    };
    if !(0.0 < total && total.is_finite()) {
        return None;
    }
    let mut rest = u * total;
    let mut chosen = None;
    for i in 0..n {
        let w = weights.get(i).filter(|_| n <= FEW).copied().unwrap_or_else(|| weigh(i));
        if 0.0 < w {
            chosen = Some((i, w / total));
            rest -= w;
            if rest < 0.0 {
                break;
            }
        }
    }
    chosen
}
