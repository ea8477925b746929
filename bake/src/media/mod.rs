//! Participating media: what a ray crosses on its way, in closed form.
//!
//! Media are homogeneous, everywhere or in boxes; where they overlap, coefficients add. Lengths are metres relative to
//! [`crate::geom::World::origin`], coefficients per metre.

use crate::scene::model::{Medium, Region, Rgb, Scene};
use glam::{Affine3A, Vec3, Vec3A};

/// All media of a scene.
#[derive(Clone, Debug)]
pub struct Media {
    bodies: Vec<Medium>,
}

/// A part of a ray where nothing changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Where it begins, metres along the ray.
    pub from: f32,
    /// Where it ends.
    pub to: f32,
    /// Scattering.
    pub sigma_s: Rgb,
    /// Scattering and absorption.
    pub sigma_t: Rgb,
    /// Mean cosine of scattering, weighed by the scattering of all channels.
    pub g: f32,
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
                    *unit_from_world = *unit_from_world * Affine3A::from_translation(origin);
                }
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
                depth += along(b.sigma_s + b.sigma_a, to - from);
            }
        }
        depth
    }

    /// What is left of light along a ray's first `t_max` metres.
    #[must_use]
    pub fn transmittance(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Rgb {
        (-self.optical_depth(origin, direction, t_max)).exp()
    }

    /// The segments of a ray's first `t_max` metres that hold a medium, in order, without gaps of their own.
    pub fn segments(&self, origin: Vec3A, direction: Vec3A, t_max: f32, out: &mut Vec<Segment>) {
        out.clear();
        let spans: Vec<(f32, f32)> =
            self.bodies.iter().map(|b| overlap(&b.region, origin, direction, t_max)).collect();
        let mut ends: Vec<f32> = spans.iter().filter(|s| s.0 < s.1).flat_map(|s| [s.0, s.1]).collect();
        ends.sort_by(f32::total_cmp);
        ends.dedup();
        for pair in ends.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            let (mut sigma_s, mut sigma_t, mut forward) = (Vec3::ZERO, Vec3::ZERO, 0.0);
            for (b, span) in self.bodies.iter().zip(&spans) {
                if span.0 <= from && to <= span.1 {
                    sigma_s += b.sigma_s;
                    sigma_t += b.sigma_s + b.sigma_a;
                    forward += b.g * b.sigma_s.element_sum();
                }
            }
            if sigma_t != Vec3::ZERO {
                let weight = sigma_s.element_sum();
                let g = if 0.0 < weight { forward / weight } else { 0.0 };
                out.push(Segment { from, to, sigma_s, sigma_t, g });
            }
        }
    }
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
        let mut s = Vec::new();
        m.segments([-1.0, 1.5, 1.5].into(), [1.0, 0.0, 0.0].into(), 100.0, &mut s);
        let of: Vec<(f32, f32, f32)> = s.iter().map(|s| (s.from, s.to, s.sigma_t.x)).collect();
        assert_eq!(of, [(1.0, 2.0, 0.75), (2.0, 3.0, 1.0), (3.0, 6.0, 0.25)]);
        assert!((s[1].g - 0.125 / 0.75).abs() < 1e-7);
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
