//! Participating media: what a ray crosses on its way, in closed form.
//!
//! Media are everywhere or in boxes, and of constant density or one that falls exponentially with height; where they overlap,
//! coefficients add. Lengths are metres relative to [`crate::geom::World::origin`], coefficients per metre.

pub mod boundary;
pub mod march;
mod responses;

use crate::scene::model::{Density, Medium, Region, Rgb, Scene};
use glam::{Affine3A, Vec3, Vec3A};
pub use responses::Responses;

/// All media of a scene.
#[derive(Clone, Debug)]
pub struct Media {
    bodies: Vec<Medium>,
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
        let mut bodies = scene.media.clone();
        bodies.retain(|b| b.sigma_s + b.sigma_a != Vec3::ZERO);
        for b in &mut bodies {
            match &mut b.region {
                Region::Everywhere => {}
                Region::Box { min, max } => {
                    *min -= origin;
                    *max -= origin;
                }
                Region::Turned { unit_from_world } => {
                    *unit_from_world *= Affine3A::from_translation(origin);
                }
            }
            if let Density::Height { base, .. } = &mut b.density {
                *base -= origin.y;
            }
        }
        (!bodies.is_empty()).then_some(Self { bodies })
    }

    /// Optical depth of a ray's first `t_max` metres, channel by channel; infinite where a medium goes on for ever.
    #[must_use]
    pub fn optical_depth(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Rgb {
        let mut depth = Vec3::ZERO;
        for b in &self.bodies {
            let (from, to) = overlap(&b.region, origin, direction, t_max);
            if from < to {
                depth += along(b.sigma_s + b.sigma_a, metres(b.density, origin, direction, from, to));
            }
        }
        depth
    }

    /// What a ray's first `t_max` metres cross.
    #[must_use]
    pub fn crossing(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Crossing {
        let mut out = Crossing::default();
        for b in &self.bodies {
            let (from, to) = overlap(&b.region, origin, direction, t_max);
            if from < to {
                let metres = metres(b.density, origin, direction, from, to);
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
        let spans: Vec<(f32, f32)> =
            self.bodies.iter().map(|b| overlap(&b.region, origin, direction, t_max)).collect();
        let mut ends: Vec<f32> = spans.iter().filter(|s| s.0 < s.1).flat_map(|s| [s.0, s.1]).collect();
        ends.sort_by(f32::total_cmp);
        ends.dedup();
        for pair in ends.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            let inside = |s: &(f32, f32)| s.0 <= from && to <= s.1;
            let bodies = spans.iter().enumerate().filter(|(_, s)| inside(s)).fold(0, |m, (i, _)| m | 1 << i);
            if bodies != 0 {
                out.push(Segment { from, to, bodies });
            }
        }
    }

    fn inside(&self, segment: Segment) -> impl Iterator<Item = &Medium> {
        self.bodies.iter().enumerate().filter(move |(i, _)| segment.bodies >> i & 1 == 1).map(|(_, b)| b)
    }

    /// Optical depth from the beginning of a segment of a ray to a place in it.
    #[must_use]
    pub fn depth_within(&self, segment: Segment, origin: Vec3A, direction: Vec3A, to: f32) -> Rgb {
        self.inside(segment)
            .map(|b| along(b.sigma_s + b.sigma_a, metres(b.density, origin, direction, segment.from, to)))
            .sum()
    }

    /// Coefficients at a place in a segment of a ray.
    #[must_use]
    pub fn coefficients(&self, segment: Segment, origin: Vec3A, direction: Vec3A, t: f32) -> Coefficients {
        let (mut sigma_s, mut sigma_t, mut forward) = (Vec3::ZERO, Vec3::ZERO, 0.0);
        for b in self.inside(segment) {
            let density = density(b.density, origin.y + direction.y * t);
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

fn density(density: Density, y: f32) -> f32 {
    match density {
        Density::Constant => 1.0,
        Density::Height { base, falloff } => (-(y - base) / falloff).exp(),
    }
}

/// Metres of density 1 that a part of a ray is worth: the integral of the density.
fn metres(of: Density, origin: Vec3A, direction: Vec3A, from: f32, to: f32) -> f32 {
    let Density::Height { falloff, .. } = of else { return to - from };
    let rate = direction.y / falloff;
    let length = to - from;
    // From the denser end, so that nothing overflows on the way to it.
    let dense = density(of, origin.y + direction.y * if 0.0 <= rate { from } else { to });
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

/// From where to where a ray is inside a region; the first is not below the second if it never is.
fn overlap(region: &Region, origin: Vec3A, direction: Vec3A, t_max: f32) -> (f32, f32) {
    match region {
        Region::Everywhere => (0.0, t_max),
        Region::Box { min, max } => slabs(*min, *max, origin, direction, t_max),
        Region::Turned { unit_from_world } => {
            let origin = unit_from_world.transform_point3a(origin);
            // Not normalised, so that lengths along the ray stay what they are.
            let direction = unit_from_world.transform_vector3a(direction);
            slabs(Vec3::ZERO, Vec3::ONE, origin, direction, t_max)
        }
    }
}

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
}
