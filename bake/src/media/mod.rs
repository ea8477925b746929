//! Participating media: what a ray crosses on its way, in closed form.
//!
//! Media are everywhere, in boxes or in closed meshes, and of constant density, one that falls exponentially with height, or that of a grid
//! of voxels; where they overlap, coefficients add. Lengths are metres relative to [`crate::geom::World::origin`], coefficients per metre.

pub mod boundary;
pub mod march;
mod responses;

use crate::error::Finding;
use crate::scene::model::{Density, Medium, Region, Rgb, Scene, Shell};
use crate::scene::voxels::Voxels;
use boundary::Boundary;
use glam::{Affine3A, Vec3, Vec3A};
use march::March;
pub use responses::{MOST_G, Responses};
use std::cell::RefCell;
use std::sync::Arc;

/// All media of a scene.
#[derive(Clone, Debug)]
pub struct Media {
    bodies: Vec<Body>,
}

/// One of them.
#[derive(Clone, Debug)]
struct Body {
    sigma_s: Rgb,
    sigma_a: Rgb,
    g: f32,
    density: Density,
    shape: Shape,
}

/// Where it is.
#[derive(Clone, Debug)]
enum Shape {
    Everywhere,
    Box {
        min: Vec3,
        max: Vec3,
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
        left(self.optical_depth)
    }
}

impl Media {
    /// The media of a scene whose world has its origin at `origin`; `None` if nothing is scattered or absorbed.
    #[must_use]
    pub fn new(scene: &Scene, origin: Vec3) -> Option<Self> {
        let bodies: Vec<Body> = scene
            .media
            .iter()
            .filter(|m| m.sigma_s + m.sigma_a != Vec3::ZERO)
            .map(|m| Body::new(m, origin))
            .collect();
        (!bodies.is_empty()).then_some(Self { bodies })
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
        let [b] = self.bodies.as_slice() else { return None };
        if !matches!(b.density, Density::Constant) || matches!(b.shape, Shape::Mesh(_)) {
            return None;
        }
        let mut ends = (0.0, 0.0);
        b.parts(origin, direction, t_max, |from, to| ends = (from, to));
        Some((ends.0, ends.1, Coefficients { sigma_s: b.sigma_s, sigma_t: b.sigma_s + b.sigma_a, g: b.g }))
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
    pub fn optical_depth(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Rgb {
        let mut depth = Vec3::ZERO;
        for b in &self.bodies {
            let metres = b.metres(origin, direction, t_max);
            if 0.0 < metres {
                depth += along(b.sigma_s + b.sigma_a, metres);
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
                let scattering = along(b.sigma_s, metres);
                out.optical_depth += scattering + along(b.sigma_a, metres);
                out.scattering += scattering;
                out.forward += if b.g == 0.0 { 0.0 } else { b.g * scattering.element_sum() };
            }
        }
        out
    }

    /// What is left of light along a ray's first `t_max` metres.
    #[must_use]
    pub fn transmittance(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Rgb {
        left(self.optical_depth(origin, direction, t_max))
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

/// What an optical depth leaves of light.
#[inline]
fn left(depth: Rgb) -> Rgb {
    if depth.x == depth.y && depth.y == depth.z { Vec3::splat((-depth.x).exp()) } else { (-depth).exp() }
}

impl Body {
    fn new(medium: &Medium, origin: Vec3) -> Self {
        let moved = |to: Affine3A| to * Affine3A::from_translation(origin);
        let shape = match &medium.region {
            Region::Everywhere => Shape::Everywhere,
            Region::Box { min, max } => Shape::Box { min: *min - origin, max: *max - origin },
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
        Self { sigma_s: medium.sigma_s, sigma_a: medium.sigma_a, g: medium.g, density, shape }
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
            Shape::Box { min, max } => Some((*min, *max)),
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
        let (from, to) = match &self.shape {
            Shape::Everywhere => (0.0, t_max),
            Shape::Box { min, max } => slabs(*min, *max, origin, direction, t_max),
            Shape::Turned(unit_from_world) => {
                let origin = unit_from_world.transform_point3a(origin);
                // Not normalised, so that lengths along the ray stay what they are.
                let direction = unit_from_world.transform_vector3a(direction);
                slabs(Vec3::ZERO, Vec3::ONE, origin, direction, t_max)
            }
            Shape::Mesh(boundary) => {
                return PARTS.with_borrow_mut(|parts| {
                    parts.clear();
                    boundary.inside(origin, direction, t_max, parts);
                    parts.iter().for_each(|p| visit(p.0, p.1));
                });
            }
        };
        if from < to {
            visit(from, to);
        }
    }
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
fn metres(of: &Density, origin: Vec3A, direction: Vec3A, from: f32, to: f32) -> f32 {
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
fn slabs(min: Vec3, max: Vec3, origin: Vec3A, direction: Vec3A, t_max: f32) -> (f32, f32) {
    let inverse = direction.recip();
    if !inverse.is_finite() {
        return slabs_along_faces(min, max, origin, direction, t_max);
    }
    let (a, b) = ((Vec3A::from(min) - origin) * inverse, (Vec3A::from(max) - origin) * inverse);
    (a.min(b).max_element().max(0.0), a.max(b).min_element().min(t_max))
}

/// [`slabs`] for rays that may be parallel to faces.
#[cold]
fn slabs_along_faces(min: Vec3, max: Vec3, origin: Vec3A, direction: Vec3A, t_max: f32) -> (f32, f32) {
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
mod tests {
    use super::*;
    use glam::vec3;

    fn body(sigma_s: f32, sigma_a: f32, g: f32, region: Region) -> Medium {
        Medium {
            path: String::new(),
            sigma_s: Vec3::splat(sigma_s),
            sigma_a: Vec3::splat(sigma_a),
            density: Density::Constant,
            g,
            region,
        }
    }

    fn cube(min: f32, max: f32) -> Region {
        Region::Box { min: Vec3::splat(min), max: Vec3::splat(max) }
    }

    fn media(bodies: Vec<Medium>) -> Media {
        Media::new(&Scene { media: bodies, ..Scene::default() }, Vec3::ZERO).expect("media")
    }

    fn depth(m: &Media, origin: [f32; 3], direction: [f32; 3], t_max: f32) -> f32 {
        m.optical_depth(origin.into(), direction.into(), t_max).x
    }

    #[test]
    fn depths_are_lengths_times_coefficients() {
        let m = media(vec![body(0.5, 0.25, 0.0, cube(0.0, 2.0)), body(0.25, 0.0, 0.5, cube(1.0, 5.0))]);
        assert_eq!(depth(&m, [-1.0, 1.5, 1.5], [1.0, 0.0, 0.0], f32::INFINITY), 0.75 * 2.0 + 0.25 * 4.0);
        assert_eq!(depth(&m, [1.5, 1.5, 1.5], [1.0, 0.0, 0.0], 1.0), 0.75 * 0.5 + 0.25);
        assert_eq!(depth(&m, [6.0, 1.5, 1.5], [1.0, 0.0, 0.0], f32::INFINITY), 0.0, "behind");
        assert_eq!(depth(&m, [0.5, 0.5, 0.5], [0.0, 1.0, 0.0], 0.0), 0.0, "no length");
        let (o, d) = (Vec3A::new(-1.0, 1.5, 1.5), Vec3A::X);
        let mut s = Vec::new();
        m.segments(o, d, 100.0, &mut s);
        let of: Vec<(f32, f32, f32)> = s
            .iter()
            .map(|s| (s.from, s.to, m.coefficients(*s, o, d, 0.5 * (s.from + s.to)).sigma_t.x))
            .collect();
        assert_eq!(of, [(1.0, 2.0, 0.75), (2.0, 3.0, 1.0), (3.0, 6.0, 0.25)]);
        assert!((m.coefficients(s[1], o, d, 2.5).g - 0.125 / 0.75).abs() < 1e-7);
        assert_eq!(m.depth_within(s[1], o, d, 2.5).x, 0.5);
    }

    /// Against sums over small steps, upwards, downwards, level and nearly so; and without end.
    #[test]
    fn height_fog_is_integrated() {
        let mut fog = body(0.3, 0.0, 0.0, Region::Everywhere);
        fog.density = Density::Height { base: 1.0, falloff: 2.5 };
        let m =
            Media::new(&Scene { media: vec![fog], ..Scene::default() }, vec3(0.0, 4.0, 0.0)).expect("media");
        for y in [-0.8f32, -1e-6, 0.0, 1e-4, 0.6, 1.0] {
            let direction = Vec3A::new((1.0 - y * y).sqrt(), y, 0.0);
            let origin = Vec3A::new(3.0, -2.0, 7.0);
            let n = 100_000;
            let step = 12.0 / f64::from(n);
            let want: f64 = (0..n)
                .map(|i| {
                    let height = 2.0 + f64::from(y) * (f64::from(i) + 0.5) * step;
                    0.3 * (-(height - 1.0) / 2.5).exp() * step
                })
                .sum();
            let got = f64::from(m.optical_depth(origin, direction, 12.0).x);
            assert!((got / want - 1.0).abs() < 2e-5, "{y}: {got} {want}");
        }
        let up = m.optical_depth(Vec3A::new(0.0, -2.0, 0.0), Vec3A::Y, f32::INFINITY).x;
        assert!((up / (0.3 * 2.5 * (-1.0f32 / 2.5).exp()) - 1.0).abs() < 1e-5);
        for direction in [Vec3A::X, Vec3A::NEG_Y] {
            assert_eq!(m.transmittance(Vec3A::ZERO, direction, f32::INFINITY), Vec3::ZERO);
        }
        // From far above, where the density is less than any number, down to where it is not.
        let down = m.optical_depth(Vec3A::new(0.0, 997.0, 0.0), Vec3A::NEG_Y, 1000.0).x;
        assert!((down / (0.3 * 2.5) - 1.0).abs() < 1e-3, "{down}");
    }

    /// Rays in a face, along an edge, from a corner; nothing is counted twice where boxes touch.
    #[test]
    fn grazing_rays_are_inside_once_or_not_at_all() {
        let right = Region::Box { min: vec3(2.0, 0.0, 0.0), max: vec3(4.0, 2.0, 2.0) };
        let m = media(vec![body(1.0, 0.0, 0.0, cube(0.0, 2.0)), body(1.0, 0.0, 0.0, right)]);
        // In the plane x = 2 between both: of one of them.
        assert_eq!(depth(&m, [2.0, -1.0, 1.0], [0.0, 1.0, 0.0], f32::INFINITY), 2.0);
        assert_eq!(depth(&m, [-1.0, 1.0, 1.0], [1.0, 0.0, 0.0], f32::INFINITY), 4.0);
        for origin in [[0.0, 0.0, 0.0], [2.0, 2.0, 2.0], [0.0, 2.0, 1.0]] {
            for direction in [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.8, 0.0], [-0.6, 0.0, 0.8]] {
                let d = depth(&m, origin, direction, f32::INFINITY);
                assert!((0.0..=5.0).contains(&d), "{origin:?} {direction:?}: {d}");
            }
        }
    }

    #[test]
    fn turned_boxes_are_where_they_are() {
        // The cube [0, 1]^3, twice as long along x, turned by 90 degrees about z, and moved.
        let world_from_unit = Affine3A::from_translation(vec3(5.0, 0.0, 0.0))
            * Affine3A::from_rotation_z(std::f32::consts::FRAC_PI_2)
            * Affine3A::from_scale(vec3(2.0, 1.0, 1.0));
        let region = Region::Turned { unit_from_world: world_from_unit.inverse() };
        let scene = Scene { media: vec![body(1.0, 0.0, 0.0, region)], ..Scene::default() };
        let origin = vec3(0.25, 0.5, -8.0);
        let m = Media::new(&scene, origin).expect("media");
        let at = |p: [f32; 3]| Vec3A::from(Vec3::from(p) - origin);
        let depth = |p, d: [f32; 3]| m.optical_depth(at(p), d.into(), f32::INFINITY).x;
        assert!((depth([4.5, -3.0, 0.5], [0.0, 1.0, 0.0]) - 2.0).abs() < 1e-5);
        assert!((depth([0.0, 1.0, 0.5], [1.0, 0.0, 0.0]) - 1.0).abs() < 1e-5);
        assert_eq!(depth([5.5, -3.0, 0.5], [0.0, 1.0, 0.0]), 0.0);
        let d = vec3(0.0, 0.6, 0.8);
        assert!((depth([4.5, 1.0, 0.0], d.to_array()) - 1.25).abs() < 1e-5, "from inside, through a side");
    }

    #[test]
    fn endless_media_swallow_everything_or_nothing() {
        let mut fog = body(0.0, 0.0, 0.0, Region::Everywhere);
        fog.sigma_a = vec3(0.0, 1e-9, 1e6);
        let m = media(vec![fog]);
        let t = m.transmittance(Vec3A::ZERO, Vec3A::X, f32::INFINITY);
        assert_eq!(t, vec3(1.0, 0.0, 0.0));
        let t = m.transmittance(Vec3A::ZERO, Vec3A::X, 1.0);
        assert!(t.x == 1.0 && t.y == 1.0 && t.z == 0.0);
        assert!(Media::new(&Scene::default(), Vec3::ZERO).is_none());
        let clear = Scene { media: vec![body(0.0, 0.0, 0.0, Region::Everywhere)], ..Scene::default() };
        assert!(Media::new(&clear, Vec3::ZERO).is_none(), "what does nothing costs nothing");
    }

    /// Lengths by 2^k and coefficients by 2^-k give the same depth to the bit.
    #[test]
    fn scaling_is_exact() {
        let at = |k: f32| {
            let m = media(vec![
                body(0.3 / k, 0.07 / k, 0.0, cube(-0.7 * k, 1.3 * k)),
                body(0.011 / k, 0.0, 0.0, Region::Everywhere),
            ]);
            m.optical_depth(Vec3A::new(-3.1, 0.2, 0.1) * k, Vec3A::new(0.96, 0.0, 0.28), 17.3 * k)
        };
        assert_eq!(at(1.0), at(1024.0));
        assert_eq!(at(1.0), at(1.0 / 4096.0));
    }

    /// The corners and sides of a box from 0 to `size`.
    fn shell(size: Vec3, closed: bool) -> Region {
        let positions =
            (0..8u8).map(|i| vec3(f32::from(i & 1), f32::from(i >> 1 & 1), f32::from(i >> 2)) * size);
        let sides: [[u32; 4]; 6] =
            [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let n = if closed { 6 } else { 5 };
        let triangles = sides[..n].iter().flat_map(|s| [[s[0], s[1], s[2]], [s[0], s[2], s[3]]]).collect();
        Region::Mesh(Arc::new(Shell { positions: positions.collect(), triangles }))
    }

    fn grid(size: [u32; 3], values: &[f32], side: f32) -> Density {
        let values = Voxels::dense(size.into(), values, 1 << 20).expect("a grid");
        Density::Voxels {
            values: Arc::new(values),
            voxels_from_world: Affine3A::from_scale(Vec3::splat(1.0 / side)),
        }
    }

    /// Meshes and grids that say the same as a box give the same depths and segments, wherever the world's origin is.
    #[test]
    fn a_box_is_a_box_as_mesh_and_grid() {
        let of = |region: Region, density: Density| {
            let medium = Medium { density, ..body(0.4, 0.1, 0.2, region) };
            let scene = Scene { media: vec![medium], ..Scene::default() };
            Media::new(&scene, vec3(0.5, -1.0, 0.25)).expect("media")
        };
        let size = vec3(2.0, 1.0, 3.0);
        let cuboid = Region::Box { min: Vec3::ZERO, max: size };
        let all = [
            of(cuboid.clone(), Density::Constant),
            of(shell(size, true), Density::Constant),
            of(Region::Everywhere, grid([4, 2, 6], &[1.0; 48], 0.5)),
            of(shell(size, true), grid([4, 2, 6], &[1.0; 48], 0.5)),
        ];
        let mut met = 0;
        for i in 0..2000u32 {
            let u = |d| sobol_burley::sample(i, d, 3) - 0.5;
            let origin = Vec3A::new(6.0 * u(0), 6.0 * u(1), 6.0 * u(2));
            let direction = Vec3A::new(u(3), u(4), u(5)).normalize();
            let depth = |m: &Media| m.crossing(origin, direction, 4.0);
            let want = depth(&all[0]);
            met += u32::from(want.optical_depth != Vec3::ZERO);
            for m in &all[1..] {
                let got = depth(m);
                assert!(
                    (got.optical_depth - want.optical_depth).abs().max_element() < 2e-6,
                    "{got:?} {want:?}"
                );
                assert!((got.forward - want.forward).abs() < 2e-6);
                let mut segments = Vec::new();
                m.segments(origin, direction, 4.0, &mut segments);
                let sum: Vec3 = segments.iter().map(|s| m.depth_within(*s, origin, direction, s.to)).sum();
                assert!((sum - want.optical_depth).abs().max_element() < 4e-6);
            }
        }
        assert!(100 < met, "{met}");
    }

    /// Bounds hold everywhere, cover the segment, and the place that is found is the one that was wanted.
    #[test]
    fn bounds_hold_and_places_are_found() {
        let values: Vec<f32> =
            (0..16 * 12 * 20u16).map(|i| f32::from(i.wrapping_mul(7919) % 64) / 64.0).collect();
        let clouds = Medium {
            density: grid([16, 12, 20], &values, 0.25),
            ..body(0.4, 0.1, 0.2, Region::Box { min: Vec3::ZERO, max: vec3(4.0, 3.0, 5.0) })
        };
        let mut haze = body(0.2, 0.0, 0.0, cube(-1.0, 3.0));
        haze.density = Density::Height { base: 0.0, falloff: 1.5 };
        let m = media(vec![clouds, haze]);
        let (mut segments, mut parts) = (Vec::new(), Vec::new());
        let (mut mixed, mut alone) = (0, 0);
        for i in 0..300u32 {
            let u = |d| sobol_burley::sample(i, d, 5);
            let origin = Vec3A::new(8.0 * u(0) - 2.0, 8.0 * u(1) - 2.0, 8.0 * u(2) - 2.0);
            let direction = (Vec3A::new(2.0, 1.5, 2.5) * 1.2 * u(3) - origin).normalize();
            m.segments(origin, direction, 20.0, &mut segments);
            for &s in &segments {
                m.majorants(s, origin, direction, 0, &mut parts);
                assert_eq!((parts[0].0, parts[parts.len() - 1].1), (s.from, s.to));
                assert!(parts.windows(2).all(|p| p[0].1 == p[1].0));
                // What is as short as the rounding of places may belong to a neighbour.
                for (k, &(from, to, most)) in (0..).zip(&parts).filter(|(_, p)| 1e-4 < p.1 - p.0) {
                    let t = from + (to - from) * sobol_burley::sample(k, 4, i);
                    assert!(m.coefficients(s, origin, direction, t).sigma_t.x <= most * 1.000_01);
                }
                mixed += usize::from(m.is_mixed(s));
                let depth = m.depth_within(s, origin, direction, s.to).x;
                if let Some(t) =
                    m.place_in_grid(s, origin, direction, 0, 0.4 * depth).filter(|_| 1e-3 < depth)
                {
                    alone += 1;
                    let got = m.depth_within(s, origin, direction, t).x;
                    assert!((got / (0.4 * depth) - 1.0).abs() < 1e-3, "{got} {depth}");
                }
            }
        }
        assert!(30 < mixed && 30 < alone, "{mixed} {alone}");
    }

    #[test]
    fn open_meshes_are_named() {
        let scene = |closed| Scene {
            media: vec![Medium { path: "cloud".into(), ..body(1.0, 0.0, 0.0, shell(Vec3::ONE, closed)) }],
            ..Scene::default()
        };
        assert_eq!(findings(&scene(true)), []);
        let found = findings(&scene(false));
        assert!(
            found.len() == 1 && found[0].path == "cloud" && found[0].what.contains("4 edges"),
            "{found:?}"
        );
    }
}
