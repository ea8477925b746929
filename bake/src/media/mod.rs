//! Participating media: what a ray crosses on its way, in closed form.
//!
//! Media are everywhere, in boxes or in closed meshes, and of constant density, one that falls exponentially with height, or that of a grid
//! of voxels; where they overlap, coefficients add. Lengths are metres relative to [`crate::geom::World::origin`], coefficients per metre.

pub mod boundary;
mod emission;
pub mod lattice;
pub mod march;
mod responses;

use crate::error::Finding;
use crate::scene::model::{Density, Medium, Region, Rgb, Scene, Shell};
use crate::scene::voxels::Voxels;
use boundary::Boundary;
use emission::Emission;
use glam::{Affine3A, Vec3, Vec3A};
use march::March;
pub use responses::{MOST_G, Responses};
use std::cell::RefCell;
use std::f32::consts::FRAC_1_PI;
use std::sync::Arc;

/// All media of a scene.
#[derive(Clone, Debug, Default)]
pub struct Media {
    bodies: Vec<Body>,
    /// Whether they are what [`Media::smoothed`] makes of them.
    smooth: bool,
    small: Small,
    emission: Option<Arc<Emission>>,
    /// See [`Media::hide_fire`].
    fire_hidden: bool,
    undimmed: Option<Arc<Self>>,
}

/// Which of the small kernels run for media; [`Small::default`] runs the general ones, which give the same for any media.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Small {
    /// All channels of each medium are alike: one optical depth, one exponential and one response do for three.
    pub grey: bool,
    /// Nothing scatters forwards or backwards: the phase function is a number, and of light at a node the mean does.
    pub isotropic: bool,
    /// One medium of constant density, not bounded by a mesh: what a ray crosses is one interval in closed form.
    pub constant: bool,
    /// Nothing absorbs: what is lost is what is scattered.
    pub lossless: bool,
}

/// One of them.
#[derive(Clone, Debug)]
struct Body {
    sigma_s: Rgb,
    sigma_a: Rgb,
    emission: Rgb,
    g: f32,
    density: Density,
    shape: Shape,
}

/// Where it is.
#[derive(Clone, Debug)]
enum Shape {
    Everywhere,
    Box {
        min: Vec3A,
        max: Vec3A,
    },
    /// Where the affine map leads into the cube [0, 1]^3.
    Turned(Affine3A),
    Mesh(Boundary),
}

/// What is doubtful about the media of a scene.
#[must_use]
pub fn findings(scene: &Scene) -> Vec<Finding> {
    let mut out = Vec::new();
    for medium in &scene.media {
        let Region::Mesh(shell) = &medium.region else { continue };
        if let Some((edges, at)) = boundary(shell).open_edges() {
            let what = format!(
                "the mesh around the medium is not closed: {edges} edges belong to one triangle, or to two that are turned against \
                 each other, such as the one at {at}"
            );
            let fix = "close the mesh; rays through a hole meet the medium up to the mesh's bounds";
            out.push(Finding::warning(&medium.path, what, fix));
        }
    }
    out
}

fn boundary(shell: &Shell) -> Boundary {
    Boundary::new(shell.positions.clone(), shell.triangles.clone())
}

/// A part of a ray that is inside the same media throughout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Where it begins, metres along the ray.
    pub from: f32,
    /// Where it ends.
    pub to: f32,
    /// One bit for each medium; there are at most [`crate::scene::gltf::MOST_MEDIA`].
    bodies: u64,
}

/// Coefficients at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients {
    /// Scattering.
    pub sigma_s: Rgb,
    /// Scattering and absorption.
    pub sigma_t: Rgb,
    /// Mean cosine of scattering, weighed by the scattering of all channels.
    pub g: f32,
}

/// What a part of a ray crosses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Crossing {
    /// Integral of sigma_t.
    pub optical_depth: Rgb,
    /// Integral of sigma_s.
    pub scattering: Rgb,
    /// Integral of g sigma_s, all channels together.
    pub forward: f32,
}

impl Crossing {
    /// What is left of light.
    #[must_use]
    #[inline]
    pub fn transmittance(&self) -> Rgb {
        attenuated(self.optical_depth)
    }
}

impl Media {
    /// The media of a scene whose world has its origin at `origin`; `None` if nothing is scattered, absorbed or emitted.
    #[must_use]
    pub fn new(scene: &Scene, origin: Vec3) -> Option<Self> {
        let bodies: Vec<Body> =
            scene.media.iter().filter(|m| m.acts()).map(|m| Body::new(m, origin)).collect();
        let emission = Emission::new(&bodies).map(Arc::new);
        let mut media = Self { bodies, emission, ..Self::default() };
        media.small = media.smallest();
        media.undimmed = media.without_loss().map(Arc::new);
        (!media.is_empty()).then_some(media)
    }

    /// The small kernels that are right for them.
    #[must_use]
    pub fn smallest(&self) -> Small {
        let b = &self.bodies;
        let one = |b: &Body| matches!(b.density, Density::Constant) && !matches!(b.shape, Shape::Mesh(_));
        Small {
            grey: self.channels() == 1,
            isotropic: b.iter().all(|b| b.sigma_s == Vec3::ZERO || b.g == 0.0),
            constant: b.len() == 1 && b.iter().all(one),
            lossless: b.iter().all(|b| b.sigma_a == Vec3::ZERO),
        }
    }

    /// Which of the small kernels run.
    #[must_use]
    pub fn small(&self) -> Small {
        self.small
    }

    /// Leaves out small kernels that are not in `among`.
    pub fn allow(&mut self, among: Small) {
        self.small = Small {
            grey: self.small.grey && among.grey,
            isotropic: self.small.isotropic && among.isotropic,
            constant: self.small.constant && among.constant,
            lossless: self.small.lossless && among.lossless,
        };
    }

    /// Whether there are none, and nothing weakens light.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bodies.is_empty()
    }

    /// Media that let the forward peak of the phase function pass as if it were not scattered, which leaves a phase function of three bands
    /// (delta-M, \[Wis77\]): of the Henyey-Greenstein function with g > 0 the share g^3 goes on, and what is left has the bands
    /// (g^l - g^3) / (1 - g^3). Light that was scattered more than once has the same bands 0 to 3 as in the media themselves.
    #[must_use]
    pub fn smoothed(&self) -> Self {
        let bodies = self.bodies.iter().map(|b| {
            let peak = b.g.max(0.0).powi(3);
            let g = if 0.0 < b.g { (b.g - peak) / (1.0 - peak) } else { b.g };
            Body { sigma_s: b.sigma_s * (1.0 - peak), g, ..b.clone() }
        });
        Self { bodies: bodies.collect(), smooth: true, ..self.clone() }
    }

    /// Bands 1 and 2 of the phase function with the mean cosine `g`.
    #[must_use]
    #[inline]
    pub fn bands(&self, g: f32) -> [f32; 2] {
        if !self.smooth || g <= 0.0 {
            return [g, g * g];
        }
        // Of [`Media::smoothed`] band 1 is a = (h + h^2) / (1 + h + h^2) where h is what g was, and band 2 h^2 / (1 + h + h^2).
        let h = 0.5 * ((1.0 + 4.0 * g / (1.0 - g)).sqrt() - 1.0);
        [g, h * h * (1.0 - g)]
    }

    /// Phase function, per steradian; `x` is the cosine between the directions of travel.
    #[must_use]
    #[inline]
    pub fn phase(&self, g: f32, x: f32) -> f32 {
        if self.small.isotropic {
            return 0.25 * FRAC_1_PI;
        }
        if !self.smooth || g <= 0.0 {
            return henyey_greenstein(g, x);
        }
        let [a, b] = self.bands(g);
        0.25 * FRAC_1_PI * (1.0 + 3.0 * a * x + 2.5 * b * (3.0 * x * x - 1.0))
    }

    /// Lower and upper corner of what holds them; `None` if that has no end.
    #[must_use]
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let mut all = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for b in &self.bodies {
            let (min, max) = b.bounds()?;
            all = (all.0.min(min), all.1.max(max));
        }
        Some(all)
    }

    /// The mean cosine farthest from 0 of what scatters.
    #[must_use]
    pub fn most_forward(&self) -> f32 {
        self.bodies.iter().filter(|b| b.sigma_s != Vec3::ZERO).map(|b| b.g.abs()).fold(0.0, f32::max)
    }

    /// Channels that have to be followed apart: 1 where all scatter and lose alike, else 3.
    #[must_use]
    pub fn channels(&self) -> usize {
        let grey = self.bodies.iter().all(|b| is_grey(b.sigma_s) && is_grey(b.sigma_a));
        if grey { 1 } else { 3 }
    }

    /// Whether any of them scatters light.
    #[must_use]
    pub fn scatters(&self) -> bool {
        self.bodies.iter().any(|b| b.sigma_s != Vec3::ZERO)
    }

    /// What a ray's first `t_max` metres cross, where it is one homogeneous medium and no more: from where to where, and its
    /// coefficients. `None` if it may be more; nothing crossed has no length.
    #[must_use]
    #[inline]
    pub fn plain(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Option<(f32, f32, Coefficients)> {
        if !self.small.constant {
            return None;
        }
        let [b] = self.bodies.as_slice() else { return None };
        let (from, to) = b.span(origin, direction, t_max)?;
        Some((from, to, Coefficients { sigma_s: b.sigma_s, sigma_t: b.sigma_s + b.sigma_a, g: b.g }))
    }

    /// Bytes that grids of voxels hold.
    #[must_use]
    pub fn bytes(scene: &Scene) -> u64 {
        let grids = scene.media.iter().map(|m| match &m.density {
            Density::Voxels { values, .. } => values.memory() as u64,
            Density::Constant | Density::Height { .. } => 0,
        });
        grids.sum()
    }

    /// Optical depth of a ray's first `t_max` metres, channel by channel; infinite where a medium goes on for ever.
    #[must_use]
    #[inline]
    pub fn optical_depth(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Rgb {
        if let Some((from, to, c)) = self.plain(origin, direction, t_max) {
            return self.along(c.sigma_t, to - from);
        }
        let mut depth = Vec3::ZERO;
        for b in &self.bodies {
            let metres = b.metres(origin, direction, t_max);
            if 0.0 < metres {
                depth += self.along(b.sigma_s + b.sigma_a, metres);
            }
        }
        depth
    }

    /// What a ray's first `t_max` metres cross.
    #[must_use]
    pub fn crossing(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Crossing {
        let mut out = Crossing::default();
        for b in &self.bodies {
            let metres = b.metres(origin, direction, t_max);
            if 0.0 < metres {
                let scattering = self.along(b.sigma_s, metres);
                let lossless = self.small.lossless;
                out.optical_depth +=
                    if lossless { scattering } else { scattering + self.along(b.sigma_a, metres) };
                out.scattering += scattering;
                out.forward += if b.g == 0.0 { 0.0 } else { b.g * scattering.element_sum() };
            }
        }
        out
    }

    /// What is left of light along a ray's first `t_max` metres.
    #[must_use]
    pub fn transmittance(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Rgb {
        self.attenuated(self.optical_depth(origin, direction, t_max))
    }

    /// [`along`], once where all channels are alike.
    #[inline]
    pub(crate) fn along(&self, sigma: Rgb, length: f32) -> Rgb {
        if self.small.grey {
            Vec3::splat(if 0.0 < sigma.x { sigma.x * length } else { 0.0 })
        } else {
            along(sigma, length)
        }
    }

    /// What an optical depth leaves of light.
    #[inline]
    pub(crate) fn attenuated(&self, depth: Rgb) -> Rgb {
        if self.small.grey { Vec3::splat((-depth.x).exp()) } else { attenuated(depth) }
    }

    /// The segments of a ray's first `t_max` metres that hold a medium, in order.
    pub fn segments(&self, origin: Vec3A, direction: Vec3A, t_max: f32, out: &mut Vec<Segment>) {
        out.clear();
        let mut spans: Vec<(usize, f32, f32)> = Vec::new();
        for (i, b) in self.bodies.iter().enumerate() {
            b.parts(origin, direction, t_max, |from, to| spans.push((i, from, to)));
        }
        let mut ends: Vec<f32> = spans.iter().flat_map(|s| [s.1, s.2]).collect();
        ends.sort_by(f32::total_cmp);
        ends.dedup();
        for pair in ends.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            let inside = |s: &&(usize, f32, f32)| s.1 <= from && to <= s.2;
            let bodies = spans.iter().filter(inside).fold(0, |m, (i, ..)| m | 1 << i);
            if bodies != 0 {
                out.push(Segment { from, to, bodies });
            }
        }
    }

    fn inside(&self, segment: Segment) -> impl Iterator<Item = &Body> {
        self.bodies.iter().enumerate().filter(move |(i, _)| segment.bodies >> i & 1 == 1).map(|(_, b)| b)
    }

    /// Optical depth from the beginning of a segment of a ray to a place in it.
    #[must_use]
    pub fn depth_within(&self, segment: Segment, origin: Vec3A, direction: Vec3A, to: f32) -> Rgb {
        self.inside(segment)
            .map(|b| along(b.sigma_s + b.sigma_a, metres(&b.density, origin, direction, segment.from, to)))
            .sum()
    }

    /// The place in a segment up to which the optical depth of one channel is `wanted`, exactly; `None` where several media of
    /// which one is a grid overlap, or none is a grid.
    #[must_use]
    pub fn place_in_grid(
        &self,
        segment: Segment,
        origin: Vec3A,
        direction: Vec3A,
        channel: usize,
        wanted: f32,
    ) -> Option<f32> {
        let mut inside = self.inside(segment);
        let (Some(b), None) = (inside.next(), inside.next()) else { return None };
        let Density::Voxels { values, voxels_from_world } = &b.density else { return None };
        let march = march(values, voxels_from_world, origin, direction);
        let amount = wanted / (b.sigma_s + b.sigma_a)[channel];
        Some(march.reach(segment.from, segment.to, amount).unwrap_or(segment.to))
    }

    /// Whether a segment holds a grid and more.
    #[must_use]
    pub fn is_mixed(&self, segment: Segment) -> bool {
        let grids = |b: &&Body| matches!(b.density, Density::Voxels { .. });
        1 < segment.bodies.count_ones() && self.inside(segment).any(|b| grids(&b))
    }

    /// Parts of a segment with a bound of sigma_t in one channel that holds throughout each, in order: the bricks of its grids.
    pub fn majorants(
        &self,
        segment: Segment,
        origin: Vec3A,
        direction: Vec3A,
        channel: usize,
        out: &mut Vec<(f32, f32, f32)>,
    ) {
        out.clear();
        out.push((segment.from, segment.to, 0.0));
        for b in self.inside(segment) {
            let sigma = (b.sigma_s + b.sigma_a)[channel];
            let Density::Voxels { values, voxels_from_world } = &b.density else {
                for part in out.iter_mut() {
                    let ends = [part.0, part.1].map(|t| density(&b.density, origin + direction * t));
                    part.2 += sigma * ends[0].max(ends[1]);
                }
                continue;
            };
            // Cuts the parts at the bricks' ends; beside the grid it adds nothing.
            let (mut parts, mut k, mut end) = (Vec::with_capacity(2 * out.len()), 0, segment.from);
            let mut cut = |from: f32, to: f32, more: f32| {
                while k < out.len() && out[k].0 < to {
                    let (a, z) = (out[k].0.max(from), out[k].1.min(to));
                    if a < z {
                        parts.push((a, z, out[k].2 + more));
                    }
                    if to < out[k].1 {
                        break;
                    }
                    k += 1;
                }
            };
            march(values, voxels_from_world, origin, direction).bricks(
                segment.from,
                segment.to,
                |from, to, _, most| {
                    cut(end, from, 0.0);
                    cut(from, to, sigma * most);
                    end = to;
                },
            );
            cut(end, segment.to, 0.0);
            *out = parts;
        }
    }

    /// Coefficients at a place in a segment of a ray.
    #[must_use]
    pub fn coefficients(&self, segment: Segment, origin: Vec3A, direction: Vec3A, t: f32) -> Coefficients {
        let (mut sigma_s, mut sigma_t, mut forward) = (Vec3::ZERO, Vec3::ZERO, 0.0);
        for b in self.inside(segment) {
            let density = density(&b.density, origin + direction * t);
            sigma_s += b.sigma_s * density;
            sigma_t += (b.sigma_s + b.sigma_a) * density;
            forward += b.g * b.sigma_s.element_sum() * density;
        }
        let weight = sigma_s.element_sum();
        Coefficients { sigma_s, sigma_t, g: if 0.0 < weight { forward / weight } else { 0.0 } }
    }
}

/// Henyey-Greenstein phase function, per steradian; `x` is the cosine between the directions of travel.
#[inline]
pub(crate) fn henyey_greenstein(g: f32, x: f32) -> f32 {
    // Backward scattering is forward scattering turned around; there nothing cancels at the peak.
    let (g, x) = if g < 0.0 { (-g, -x) } else { (g, x) };
    let d = (1.0 - g) * (1.0 - g) + 2.0 * g * (1.0 - x).max(0.0);
    0.25 * FRAC_1_PI * ((1.0 - g) * (1.0 + g)) / (d * d.sqrt())
}

/// Whether all channels are alike.
#[inline]
pub(crate) fn is_grey(v: Rgb) -> bool {
    v.x == v.y && v.y == v.z
}

/// What an optical depth leaves of light.
#[inline]
pub(crate) fn attenuated(depth: Rgb) -> Rgb {
    if is_grey(depth) { Vec3::splat((-depth.x).exp()) } else { (-depth).exp() }
}

impl Body {
    fn new(medium: &Medium, origin: Vec3) -> Self {
        let moved = |to: Affine3A| to * Affine3A::from_translation(origin);
        let shape = match &medium.region {
            Region::Everywhere => Shape::Everywhere,
            Region::Box { min, max } => {
                Shape::Box { min: (*min - origin).into(), max: (*max - origin).into() }
            }
            Region::Turned { unit_from_world } => Shape::Turned(moved(*unit_from_world)),
            Region::Mesh(shell) => Shape::Mesh(boundary(shell).moved(origin)),
        };
        let density = match &medium.density {
            Density::Constant => Density::Constant,
            Density::Height { base, falloff } => Density::Height { base: base - origin.y, falloff: *falloff },
            Density::Voxels { values, voxels_from_world } => {
                Density::Voxels { values: Arc::clone(values), voxels_from_world: moved(*voxels_from_world) }
            }
        };
        let Medium { sigma_s, sigma_a, emission, g, .. } = *medium;
        Self { sigma_s, sigma_a, emission, g, density, shape }
    }

    /// Lower and upper corner; `None` without end.
    fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let of = |corners: &mut dyn Iterator<Item = Vec3>| {
            corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), c| (a.min(c), b.max(c)))
        };
        let cube = |size: Vec3, world_from: Affine3A| {
            of(&mut (0..8u8).map(|i| {
                let bit = |k: u8| f32::from(i >> k & 1);
                world_from.transform_point3(Vec3::new(bit(0), bit(1), bit(2)) * size)
            }))
        };
        let shape = match &self.shape {
            Shape::Everywhere => None,
            Shape::Box { min, max } => Some(((*min).into(), (*max).into())),
            Shape::Turned(unit_from_world) => Some(cube(Vec3::ONE, unit_from_world.inverse())),
            Shape::Mesh(boundary) => Some(boundary.bounds()),
        };
        let grid = match &self.density {
            Density::Constant | Density::Height { .. } => None,
            Density::Voxels { values, voxels_from_world } => {
                Some(cube(values.size().as_vec3(), voxels_from_world.inverse()))
            }
        };
        match (shape, grid) {
            (Some(a), Some(b)) => Some((a.0.max(b.0), a.1.min(b.1))),
            (a, b) => a.or(b),
        }
    }

    /// From where to where a ray's first `t_max` metres are inside, of no length where they never are; `None` for meshes.
    #[inline]
    fn span(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Option<(f32, f32)> {
        let (from, to) = match &self.shape {
            Shape::Everywhere => (0.0, t_max),
            Shape::Box { min, max } => slabs(*min, *max, origin, direction, t_max),
            Shape::Turned(unit_from_world) => turned(unit_from_world, origin, direction, t_max),
            Shape::Mesh(_) => return None,
        };
        Some(if from < to { (from, to) } else { (0.0, 0.0) })
    }

    /// Metres of density 1 that a ray's first `t_max` metres are worth.
    #[inline]
    fn metres(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> f32 {
        let mut sum = 0.0;
        self.parts(origin, direction, t_max, |from, to| {
            sum += metres(&self.density, origin, direction, from, to);
        });
        sum
    }

    /// The parts of a ray's first `t_max` metres that are inside, in order.
    #[inline]
    fn parts(&self, origin: Vec3A, direction: Vec3A, t_max: f32, mut visit: impl FnMut(f32, f32)) {
        let Some((from, to)) = self.span(origin, direction, t_max) else {
            if let Shape::Mesh(boundary) = &self.shape {
                meshed(boundary, origin, direction, t_max, &mut visit);
            }
            return;
        };
        if from < to {
            visit(from, to);
        }
    }
}

/// [`slabs`] of a box that is turned.
fn turned(unit_from_world: &Affine3A, origin: Vec3A, direction: Vec3A, t_max: f32) -> (f32, f32) {
    let origin = unit_from_world.transform_point3a(origin);
    // Not normalised, so that lengths along the ray stay what they are.
    let direction = unit_from_world.transform_vector3a(direction);
    slabs(Vec3A::ZERO, Vec3A::ONE, origin, direction, t_max)
}

fn meshed(boundary: &Boundary, origin: Vec3A, direction: Vec3A, t_max: f32, visit: &mut dyn FnMut(f32, f32)) {
    PARTS.with_borrow_mut(|parts| {
        parts.clear();
        boundary.inside(origin, direction, t_max, parts);
        parts.iter().for_each(|p| visit(p.0, p.1));
    });
}

thread_local! {
    /// Room for the parts of a ray that are inside a mesh.
    static PARTS: RefCell<Vec<(f32, f32)>> = const { RefCell::new(Vec::new()) };
}

fn density(density: &Density, p: Vec3A) -> f32 {
    match density {
        Density::Constant => 1.0,
        Density::Height { base, falloff } => (-(p.y - base) / falloff).exp(),
        Density::Voxels { values, voxels_from_world } => values.at(voxels_from_world.transform_point3a(p)),
    }
}

fn march<'a>(values: &'a Voxels, voxels_from_world: &Affine3A, origin: Vec3A, direction: Vec3A) -> March<'a> {
    let origin = voxels_from_world.transform_point3a(origin);
    March::new(values, origin, voxels_from_world.transform_vector3a(direction))
}

/// Metres of density 1 that a part of a ray is worth: the integral of the density.
#[inline]
fn metres(of: &Density, origin: Vec3A, direction: Vec3A, from: f32, to: f32) -> f32 {
    if matches!(of, Density::Constant) { to - from } else { uneven_metres(of, origin, direction, from, to) }
}

fn uneven_metres(of: &Density, origin: Vec3A, direction: Vec3A, from: f32, to: f32) -> f32 {
    let falloff = match of {
        Density::Constant => return to - from,
        Density::Height { falloff, .. } => falloff,
        Density::Voxels { values, voxels_from_world } => {
            return march(values, voxels_from_world, origin, direction).integral(from, to);
        }
    };
    let rate = direction.y / falloff;
    let length = to - from;
    // From the denser end, so that nothing overflows on the way to it.
    let dense = density(of, origin + direction * if 0.0 <= rate { from } else { to });
    let turns = rate.abs() * length;
    if length == f32::INFINITY {
        return if 0.0 < rate { dense / rate } else { f32::INFINITY };
    }
    dense * length * if turns == 0.0 { 1.0 } else { -(-turns).exp_m1() / turns }
}

/// sigma x length where either may be 0 and the length infinite.
#[must_use]
pub fn along(sigma: Rgb, length: f32) -> Rgb {
    Vec3::select(sigma.cmpgt(Vec3::ZERO), sigma * length, Vec3::ZERO)
}

/// From where to where a ray is inside a box; the first is not below the second if it never is.
#[inline]
fn slabs(min: Vec3A, max: Vec3A, origin: Vec3A, direction: Vec3A, t_max: f32) -> (f32, f32) {
    let inverse = direction.recip();
    if !inverse.is_finite() {
        return slabs_along_faces(min, max, origin, direction, t_max);
    }
    let (a, b) = ((min - origin) * inverse, (max - origin) * inverse);
    (a.min(b).max_element().max(0.0), a.max(b).min_element().min(t_max))
}

/// [`slabs`] for rays that may be parallel to faces.
#[cold]
fn slabs_along_faces(min: Vec3A, max: Vec3A, origin: Vec3A, direction: Vec3A, t_max: f32) -> (f32, f32) {
    let (mut from, mut to) = (0.0f32, t_max);
    for axis in 0..3 {
        let (o, d) = (origin[axis], direction[axis]);
        if d == 0.0 {
            // Within a face counts as outside on one side and inside on the other, so that boxes which touch do not overlap.
            if o < min[axis] || max[axis] <= o {
                return (0.0, 0.0);
            }
            continue;
        }
        let (a, b) = ((min[axis] - o) / d, (max[axis] - o) / d);
        from = from.max(a.min(b));
        to = to.min(a.max(b));
    }
    (from, to)
}

#[cfg(test)]
mod tests;
