//! The estimator: a path from the receiver, with next-event estimation at every vertex.
//!
//! What is estimated is `E / pi`, the mean of incident radiance over the cosine-weighted
//! hemisphere. Emission is found in two ways, by choosing points on emitters and by directions that
//! happen to hit them; the balance heuristic (\[Vea97\] Veach, "Robust Monte Carlo Methods for Light
//! Transport Simulation", 1997, eq. 9.8) weighs the two.

use crate::geom::world::SurfacePoint;
use crate::geom::{Bvh, Hit, Ray, World};
use crate::light::fires::Fires;
use crate::light::{Beams, Lights, SkyGuide};
use crate::media::{Media, Responses};
use crate::plan::{MediaMode, Tracing};
use crate::sample::Sequence;
use crate::sample::warp::{Frame, cos_hemisphere_pdf, square_to_cos_hemisphere};
use crate::scene::model::{Rgb, Scene};
use crate::transport::air::Crossed;
use crate::transport::airlight::Links;
use crate::transport::cache::IrradianceCache;
use crate::transport::connect::{Arrival, LightVertex};
use crate::transport::direct::Part;
use crate::transport::encounter::Onward;
use crate::transport::light_grid::LightGrid;
use glam::{Vec3, Vec3A};

/// Throughput below which Russian roulette starts. It is a product of albedos, so the decision does
/// not change with the strength of the lights.
pub(crate) const ROULETTE_BELOW: f32 = 0.25;

/// Reflections after which a path ends with a chance of at least `1 - DEEP_SURVIVAL` each.
pub(crate) const DEEP: u32 = 64;

/// See [`DEEP`]. Where a path loses less than the root of this at each reflection, its weight would grow faster than its chance
/// falls, and a mean of such paths has no variance to speak of: this is beyond what walls are made of.
pub(crate) const DEEP_SURVIVAL: f32 = 0.99;

/// Transparent layers that one ray may cross. Real scenes have a few dozen; the limit ends the
/// walk through degenerate stacks.
pub(crate) const MAX_LAYERS: u32 = 256;

/// Paths of higher numbers send beams of their own: the noise of the shared ones, which no texel's error contains, must
/// stay small beside that of a texel.
const BORROWED: u32 = 256;

/// A ray from a surface: what it finds is weighed against what is chosen there.
const FROM_SURFACE: u8 = 0;

/// A ray from a place in the air: nothing else finds what it finds.
const IN_AIR: u8 = 1;

/// As [`IN_AIR`], but that the image of a sky and lights that media are are chosen as well.
const BESIDE_SKY: u8 = 2;

/// Which path of an estimate is walked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    /// The path itself.
    Whole,
    /// One that goes on from a place that was chosen by area, after so many reflections.
    Branch(u32),
}

impl Stage {
    /// Reflections before its first vertex.
    fn first(self) -> u32 {
        match self {
            Self::Whole => 0,
            Self::Branch(n) => n,
        }
    }
}

/// Everything a path needs. Without `AIR` the compiler knows that there are no media, and leaves out whatever would follow.
#[derive(Clone, Copy, Debug)]
pub struct Kernel<'a, const AIR: bool = true> {
    /// Materials and meshes.
    pub scene: &'a Scene,
    /// Placed triangles.
    pub world: &'a World,
    /// The tree over them.
    pub bvh: &'a Bvh,
    /// What emits.
    pub lights: &'a Lights,
    /// Most reflections that a path may have; `None` leaves the end to Russian roulette.
    pub bounces: Option<u32>,
    /// Paths from the lights that every vertex connects to; without them light is found from the
    /// receiver alone.
    pub beams: Option<&'a Beams>,
    /// Where some of the beams landed: paths of low numbers take these instead of sending beams of their own.
    pub landed: &'a [Option<LightVertex>],
    /// Directions in which the sky is seen; without them the sky is found by chance alone, unless it
    /// is an image.
    pub sky_guide: Option<&'a SkyGuide>,
    /// Where paths may end; without it they go on to the last reflection.
    pub cache: Option<&'a IrradianceCache>,
    /// What weakens light on its way.
    pub media: Option<&'a Media>,
    /// What of it is scattered, as if nothing bounded the media.
    pub responses: Option<&'a Responses>,
    /// What of it is scattered between walls.
    pub grid: Option<&'a LightGrid>,
    /// Media that emit, as many lights; without it directions and places chosen for it find what they emit.
    pub fires: Option<&'a Fires>,
    /// Whether paths scatter in it.
    pub scatters: bool,
    /// Whether many emissive triangles are asked where texels ask lamps, and not by their paths.
    pub emitters_apart: bool,
}

/// Where a path starts or turns.
#[derive(Clone, Copy, Debug)]
pub struct Vertex {
    /// Metres, relative to [`World::origin`].
    pub position: Vec3A,
    /// Unit normal of the plane, on the side that is lit.
    pub geometric_normal: Vec3A,
    /// Unit normal that the cosine refers to, on the same side.
    pub shading_normal: Vec3A,
    /// How far off the plane rays start, metres.
    pub offset: f32,
    /// So much bright sky is seen from here that directions by cosine find the light: neither beams nor the
    /// guide to the sky are worth their rays.
    pub open: bool,
    /// Not on any surface: media are lit from behind as well.
    pub detached: bool,
}

/// One sample of what arrives at a point.
#[derive(Clone, Copy, Debug, Default)]
pub struct Estimate {
    /// Light that comes from a light straight away, `E / pi`, nits.
    pub direct: Rgb,
    /// Light that was reflected at least once, `E / pi`, nits.
    pub indirect: Rgb,
    /// Rays traced, shadow rays included.
    pub rays: u32,
}

/// What a ray that looks around met.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum First {
    /// The sky.
    #[default]
    Nothing,
    /// A front side.
    Front,
    /// The back of a surface that has only a front.
    Back,
    /// The back of a double-sided surface.
    DoubleSidedBack,
}

impl Vertex {
    /// A point on the front side of its surface.
    #[must_use]
    pub fn front(at: &SurfacePoint) -> Self {
        Self {
            position: at.position,
            geometric_normal: at.geometric_normal,
            shading_normal: at.shading_normal,
            offset: at.offset,
            open: false,
            detached: false,
        }
    }

    /// The same point on the other side of its surface.
    #[must_use]
    pub fn turned(&self) -> Self {
        Self { geometric_normal: -self.geometric_normal, shading_normal: -self.shading_normal, ..*self }
    }

    /// Whether light from this direction and distance is not kept off by the vertex's own surface; what lies in its plane is not.
    pub(crate) fn faces(&self, wi: Vec3A, distance: f32) -> bool {
        let cos = wi.dot(self.geometric_normal);
        0.0 <= cos || self.detached || self.below() < cos * distance
    }

    /// Places this high over the plane, which is below it, still count as in the plane, metres.
    pub(crate) fn below(&self) -> f32 {
        -0.5 * self.offset
    }

    pub(crate) fn ray(&self, direction: Vec3A, t_max: f32) -> Ray {
        Ray { origin: self.position + self.geometric_normal * self.offset, direction, t_max }
    }
}

impl<'a> Kernel<'a> {
    /// The kernel before anything is learnt.
    #[must_use]
    pub fn new(scene: &'a Scene, tracing: &'a Tracing, bounces: Option<u32>, media: MediaMode) -> Self {
        Self {
            scene,
            world: &tracing.world,
            bvh: &tracing.bvh,
            lights: &tracing.lights,
            bounces,
            beams: None,
            landed: &[],
            sky_guide: None,
            cache: None,
            media: tracing.media.as_ref().filter(|m| media != MediaMode::Off || m.is_empty()),
            responses: tracing.responses.as_ref().filter(|_| media == MediaMode::Table),
            grid: None,
            fires: tracing
                .fires
                .as_ref()
                .filter(|fires| matches!(media, MediaMode::Attenuate | MediaMode::Bounded) && !fires.waits())
                // Whoever has a kernel may ask them.
                .inspect(|fires| {
                    fires.shadows();
                }),
            scatters: media == MediaMode::Reference && tracing.media.as_ref().is_some_and(|m| !m.is_empty()),
            emitters_apart: false,
        }
    }

    /// The same for scenes without media, where there are none: the answers are the same bits in fewer instructions.
    #[inline]
    pub(crate) fn without_air(&self) -> Option<Kernel<'a, false>> {
        if cfg!(feature = "media") && self.media.is_some() {
            return None;
        }
        Some(Kernel {
            scene: self.scene,
            world: self.world,
            bvh: self.bvh,
            lights: self.lights,
            bounces: self.bounces,
            beams: self.beams,
            landed: self.landed,
            sky_guide: self.sky_guide,
            cache: self.cache,
            media: None,
            responses: None,
            grid: None,
            fires: None,
            scatters: false,
            emitters_apart: self.emitters_apart,
        })
    }
}

impl<'a, const AIR: bool> Kernel<'a, AIR> {
    /// Whether the compiler lets media in.
    const MEDIA: bool = AIR && cfg!(feature = "media");

    /// What weakens light on its way.
    #[inline(always)]
    #[must_use]
    pub fn media(&self) -> Option<&'a Media> {
        if Self::MEDIA { self.media } else { None }
    }

    /// Media that emit.
    #[inline(always)]
    pub(crate) fn glowing(&self) -> Option<&'a Media> {
        self.media().filter(|m| m.emits())
    }

    /// The same as many lights, likewise.
    #[inline(always)]
    pub(crate) fn fires(&self) -> Option<&'a Fires> {
        if Self::MEDIA { self.fires } else { None }
    }

    /// What of it is scattered by tables, likewise.
    #[inline(always)]
    pub(crate) fn responses(&self) -> Option<&'a Responses> {
        if Self::MEDIA { self.responses } else { None }
    }

    /// What of it is scattered between walls, likewise.
    #[inline(always)]
    pub(crate) fn grid(&self) -> Option<&'a LightGrid> {
        if Self::MEDIA { self.grid } else { None }
    }

    /// Whether paths scatter, likewise.
    #[inline(always)]
    pub(crate) fn scatters(&self) -> bool {
        Self::MEDIA && self.scatters
    }
}

impl<const AIR: bool> Kernel<'_, AIR> {
    /// The kernel without anything that was learnt: what it finds does not depend on the seed of a pilot.
    #[must_use]
    pub fn plain(&self) -> Self {
        Self { beams: None, landed: &[], sky_guide: None, cache: None, ..*self }
    }

    /// The kernel without media: for questions whose answer must not depend on what becomes of these.
    #[must_use]
    pub fn in_clear_air(&self) -> Self {
        let media = self.media.and_then(Media::undimmed);
        Self { media, responses: None, grid: None, fires: None, scatters: false, ..*self }
    }

    /// See [`Kernel::estimate`].
    pub(crate) fn whole(&self, start: &Vertex, u: [f32; 2], sequence: &mut Sequence) -> Estimate {
        let mut rays = 0;
        let lamps = self.lamps_through_air(start, sequence, &mut rays);
        let out = self.walk(start, u, Part::All, sequence);
        Estimate { indirect: out.indirect + lamps, rays: out.rays + rays, ..out }
    }

    /// Whether there is anything that [`Kernel::small`] finds.
    pub(crate) fn has_small(&self) -> bool {
        self.lights.has_small() || self.has_lamps_in_air() || self.emitters_apart() || self.fires_apart()
    }

    /// See [`Kernel::small`].
    pub(crate) fn small_part(&self, at: &Vertex, sequence: &mut Sequence) -> Estimate {
        let mut out = Estimate::default();
        if self.lights.has_small() || self.emitters_apart() || self.fires_apart() {
            out.direct = self.direct(at, Part::Small, true, None, sequence, &mut out.rays).sum();
        }
        out.indirect = self.lamps_through_air(at, sequence, &mut out.rays);
        out
    }

    /// See [`Kernel::arriving`].
    pub(crate) fn arriving_part(&self, start: &Vertex, u: [f32; 2], sequence: &mut Sequence) -> Estimate {
        self.walk(start, u, Part::Area, sequence)
    }

    fn walk(&self, start: &Vertex, u: [f32; 2], part: Part, sequence: &mut Sequence) -> Estimate {
        if self.scatters()
            && let Some(media) = self.media()
        {
            return self.walk_media(media, start, u, part, sequence);
        }
        self.walk_surfaces(start, u, part, Stage::Whole, None, sequence)
    }

    /// A path whose legs lead from surface to surface.
    pub(crate) fn walk_surfaces(
        &self,
        start: &Vertex,
        u: [f32; 2],
        part: Part,
        stage: Stage,
        mut links: Option<&mut Links>,
        sequence: &mut Sequence,
    ) -> Estimate {
        // What of the light at the first vertex arrives where links are asked for.
        let arrives = links.as_deref().map_or(Vec3::ONE, |l| l.throughput);
        let mut out = Estimate::default();
        let mut vertex = *start;
        let mut throughput = Vec3::ONE;
        // Of light that suns and lamps bring to the vertex straight away.
        let mut lit = Vec3::ONE;
        let mut turn = u;
        let mut arrival = None;
        let mut beam = LazyBeam::new(sequence);
        let first = stage.first();
        for depth in first.. {
            let part = if depth == first { part } else { Part::All };
            let direct = self.direct(&vertex, part, depth == 0, arrival, sequence, &mut out.rays);
            let connects = !vertex.open || self.responses().is_some();
            let reflects = self.bounces.is_none_or(|n| depth < n);
            if connects
                && reflects
                && let Some(light) = beam.get(self, &mut out.rays)
            {
                out.indirect += throughput * self.connect(&vertex, light, &mut out.rays);
            }
            let by_area = self.responses().filter(|_| stage == Stage::Whole && reflects);
            if let Some(responses) = by_area {
                out.indirect += throughput * self.by_area(responses, &vertex, depth, sequence, &mut out.rays);
            }
            let wi = Frame::new(vertex.shading_normal).to_world(square_to_cos_hemisphere(turn));
            if let Some(links) = links.as_deref_mut() {
                links.throughput = arrives * throughput;
            }
            if stage != Stage::Whole || 0 < depth {
                out.indirect += throughput * self.lamps_now_and_then(&vertex, sequence, &mut out.rays);
            }
            let leg = self.follow(&vertex, wi, by_area, links.as_deref_mut(), sequence, &mut out.rays);
            out.indirect += throughput * leg.airlight;
            if depth == 0 {
                out.direct = direct.small + direct.area + leg.emitted;
            } else {
                out.indirect += lit * direct.small + throughput * (direct.area + leg.emitted);
            }
            let Some((next, reflectance)) = leg.next else { break };
            arrival = connects.then_some(leg.arrival);
            if !reflects {
                break;
            }
            lit = throughput * reflectance * leg.lit;
            throughput *= reflectance * leg.rest;
            if self.beams.is_none() || !connects {
                lit = throughput;
            }
            if self.responses().is_some_and(|r| r.is_too_much(throughput)) {
                break;
            }
            if let Some(cache) = self.cache
                && cache.near() <= leg.travelled
                && let Some(cached) = self.cached(&next, &mut out.rays)
            {
                let small = self.direct(&next, Part::Small, false, arrival, sequence, &mut out.rays).small;
                out.indirect += throughput * cached + lit * small;
                break;
            }
            let [a, b, c, _] = sequence.next4();
            let strongest = throughput.max_element();
            // A path inside a closed body of albedo 1 would never get weaker, so depth counts as well.
            let limit = if depth < DEEP { 1.0 } else { DEEP_SURVIVAL };
            // One of many short paths, whose mean counts.
            let below = if stage == Stage::Whole { ROULETTE_BELOW } else { 1.0 };
            let survival = (strongest / below).min(limit);
            if survival < 1.0 {
                if survival <= c {
                    break;
                }
                throughput /= survival;
                lit /= survival;
            }
            vertex = next;
            turn = [a, b];
        }
        out
    }

    /// What a ray from `from` meets in the direction that `u` chooses by cosine, how far away, and in
    /// which direction.
    #[must_use]
    pub fn look(&self, from: &Vertex, u: [f32; 2]) -> (First, f32, Vec3A) {
        let wi = Frame::new(from.shading_normal).to_world(square_to_cos_hemisphere(u));
        let Some(hit) = self.closest(&from.ray(wi, f32::INFINITY)) else {
            return (First::Nothing, f32::INFINITY, wi);
        };
        let front = wi.dot(self.world.geometric_normal(hit.triangle)) < 0.0;
        let double_sided = self.world.material(self.scene, hit.triangle).double_sided;
        let first = match (front, double_sided) {
            (true, _) => First::Front,
            (false, true) => First::DoubleSidedBack,
            (false, false) => First::Back,
        };
        (first, hit.t, wi)
    }

    /// Whether a ray from a place in the air meets the back of a surface that has only a front.
    pub(crate) fn meets_back(&self, origin: Vec3A, direction: Vec3A) -> bool {
        self.closest(&Ray { origin, direction, t_max: f32::INFINITY }).is_some_and(|hit| {
            let double_sided = self.world.material(self.scene, hit.triangle).double_sided;
            !double_sided && 0.0 < direction.dot(self.world.geometric_normal(hit.triangle))
        })
    }

    /// Follows a ray through whatever lets light pass, to the next reflection or the sky. `by_area` says that [`Kernel::by_area`]
    /// may find its end as well. With `links` the grid's
    /// light is left out and said there.
    fn follow(
        &self,
        from: &Vertex,
        wi: Vec3A,
        by_area: Option<&Responses>,
        links: Option<&mut Links>,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Leg {
        let pdf = cos_hemisphere_pdf(wi.dot(from.shading_normal));
        self.follow_on::<FROM_SURFACE>((from, wi, pdf), by_area, links, sequence, rays)
    }

    /// As [`Kernel::follow`] from a place in the air, whose rays alone find the sky and wide emitters, and do not count others.
    pub(crate) fn follow_in_air(
        &self,
        from: &Vertex,
        wi: Vec3A,
        links: Option<&mut Links>,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Leg {
        self.follow_on::<IN_AIR>((from, wi, 1.0), None, links, sequence, rays)
    }

    /// The same where the image of a sky is asked apart as well, and small emissive surfaces that are far away alone; `wi` was chosen with this density per steradian.
    pub(crate) fn follow_beside_sky(
        &self,
        from: &Vertex,
        (wi, pdf): (Vec3A, f32),
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Leg {
        self.follow_on::<BESIDE_SKY>((from, wi, pdf), None, None, sequence, rays)
    }

    fn follow_on<const HOW: u8>(
        &self,
        (from, wi, pdf): (&Vertex, Vec3A, f32),
        by_area: Option<&Responses>,
        mut links: Option<&mut Links>,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> Leg {
        let mut ray = from.ray(wi, f32::INFINITY);
        let mut travelled = 0.0;
        let mut leg = Leg {
            emitted: Vec3::ZERO,
            airlight: Vec3::ZERO,
            next: None,
            lit: Vec3::ONE,
            rest: Vec3::ONE,
            arrival: Arrival { density: 0.0 },
            travelled: 0.0,
        };
        // What surfaces on the way leave of light, and what media do where they only take.
        let (mut through, mut clear) = (Vec3::ONE, Vec3::ONE);
        let spread = self.media().zip(self.responses());
        // Weight of what media emit against places that are chosen for it.
        let mut by_chance = None;
        for _ in 0..MAX_LAYERS {
            *rays += 1;
            let hit = self.closest(&ray);
            if let Some(media) = self.glowing().filter(|_| HOW == IN_AIR || self.fires().is_none()) {
                let t = hit.map_or(f32::INFINITY, |h| h.t);
                let before = if spread.is_none() { clear } else { self.weaken(from.position, wi, travelled) };
                let weight = *by_chance.get_or_insert_with(|| match HOW {
                    FROM_SURFACE => balance(pdf, media.emitting_pdf(from.position, wi)),
                    _ => 1.0,
                });
                leg.emitted += through * before * media.emitted(ray.origin, wi, t) * weight;
            }
            if let (Some(media), None) = (self.media(), spread) {
                let part = (ray.origin, wi, hit.map_or(f32::INFINITY, |h| h.t));
                let (airlight, left) =
                    self.cross(media, part, through * clear, links.as_deref_mut(), sequence, rays);
                leg.airlight += airlight;
                clear *= left;
            }
            let Some(hit) = hit else {
                if self.lights.small.black_sky {
                    return leg;
                }
                let sky = through * self.lights.sky.radiance(wi);
                let other = match HOW {
                    FROM_SURFACE => self.sky_density(from, wi),
                    BESIDE_SKY => self.lights.sky.pdf(wi),
                    _ => 0.0,
                };
                leg.emitted += sky
                    * match spread {
                        None => clear * balance(pdf, other),
                        Some((_, responses)) => self.sky_through(responses, from, wi, [pdf, other]),
                    };
                return leg;
            };
            travelled += hit.t;
            leg.travelled = travelled;
            let met = self.encounter(&hit, wi);
            let shines = met.emits && !self.lights.small.no_emission;
            let apart = HOW != FROM_SURFACE && shines && self.lights.emitters.is_grouped(hit.triangle);
            let near =
                HOW == BESIDE_SKY && apart && self.lights.emitters.is_near(hit.triangle, from.position);
            if shines && (!apart || near) {
                let other = if HOW == FROM_SURFACE {
                    self.lights.emitter_pdf(&self.emitter_receiver(from), hit.triangle, wi, travelled)
                } else {
                    0.0
                };
                let emission = through * met.shade.emission;
                leg.emitted += emission
                    * match spread {
                        None => clear * balance(pdf, other),
                        Some(spread) => {
                            let densities = [pdf, other];
                            self.emitter_through(spread, from, wi, travelled, met.normal(), densities)
                        }
                    };
            }
            match met.onward(sequence) {
                Onward::Absorbed => return leg,
                Onward::Through { tint, origin } => {
                    through *= tint;
                    ray.origin = origin;
                }
                Onward::Reflected { vertex, reflectance } => {
                    let cos = -wi.dot(vertex.shading_normal);
                    leg.arrival = Arrival { density: pdf * cos.max(0.0) / (travelled * travelled) };
                    let reflectance = through * reflectance;
                    leg.next = (reflectance != Vec3::ZERO).then_some((vertex, reflectance));
                    (leg.lit, leg.rest) = match spread {
                        None => (clear, clear),
                        Some(spread) => {
                            let far = [travelled, pdf];
                            self.surface_through(spread, by_area, from, wi, far, vertex.geometric_normal)
                        }
                    };
                    return leg;
                }
            }
        }
        leg
    }

    /// What media scatter into a part of a ray, of which `before` is left in front of it, and what they leave of light; apart, so that
    /// scenes without media carry nothing of it.
    #[inline(never)]
    fn cross(
        &self,
        media: &Media,
        part: (Vec3A, Vec3A, f32),
        before: Rgb,
        links: Option<&mut Links>,
        sequence: &mut Sequence,
        rays: &mut u32,
    ) -> (Rgb, Rgb) {
        let crossed = Crossed::new(media, part);
        let Some(grid) = self.grid() else { return (Vec3::ZERO, crossed.left) };
        let air = (media, grid);
        let airlight = match links {
            Some(links) => {
                let so_far = links.throughput * before;
                self.airlight_linked(air, part, (links, so_far), sequence, rays)
            }
            None => self.airlight(air, part, &crossed, sequence, rays),
        };
        (before * airlight, crossed.left)
    }

    /// The nearest hit that is not a hole.
    #[must_use]
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        self.bvh.closest(ray, |hit| self.world.pass(self.scene, hit.triangle, hit.bary) != Vec3::ONE)
    }
}

/// The beam that a path's vertices connect to, followed when the first of them asks.
struct LazyBeam {
    sequence: Sequence,
    beam: Option<Option<LightVertex>>,
}

impl LazyBeam {
    /// The beam has numbers of its own, so that those of the path do not depend on whether it is used.
    fn new(sequence: &Sequence) -> Self {
        Self { sequence: sequence.fork(), beam: None }
    }

    fn get<const AIR: bool>(&mut self, kernel: &Kernel<'_, AIR>, rays: &mut u32) -> Option<&LightVertex> {
        let found = || {
            let n = kernel.landed.len();
            if n == 0 || BORROWED <= self.sequence.index() {
                return kernel.beam(&mut self.sequence, rays);
            }
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
            let k = (self.sequence.next4()[0] * n as f32) as usize;
            kernel.landed[k.min(n - 1)]
        };
        self.beam.get_or_insert_with(found).as_ref()
    }
}

/// Weight of the one of two ways to sample that was taken, from their densities: \[Vea97\] eq. 9.8. A
/// direction within the surface's plane has density 0 and brings nothing.
pub(crate) fn balance(taken: f32, other: f32) -> f32 {
    if 0.0 < taken { taken / (taken + other) } else { 0.0 }
}

/// A ray's way from one reflection to the next.
pub(crate) struct Leg {
    /// Emission met on the way, weighted against next-event estimation, nits.
    pub(crate) emitted: Rgb,
    /// What media scatter into the way, nits.
    pub(crate) airlight: Rgb,
    /// Where light was reflected and by how much, or `None` if it left or was absorbed.
    pub(crate) next: Option<(Vertex, Rgb)>,
    /// What media make of light that suns and lamps bring to that place straight away, which beams find as well.
    lit: Rgb,
    /// What they make of the rest.
    pub(crate) rest: Rgb,
    /// How likely the place of the reflection was found.
    arrival: Arrival,
    /// Length of the way, metres.
    pub(crate) travelled: f32,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_finite_at_the_ends() {
        assert_eq!(balance(0.0, 0.0), 0.0, "along the surface, nothing else samples");
        assert_eq!(balance(0.0, 1.0), 0.0);
        assert_eq!(balance(1.0, 0.0), 1.0);
        assert!(balance(1.0, f32::MAX) < 1e-30);
        assert_eq!(balance(0.25, 0.75), 0.25);
    }
}
