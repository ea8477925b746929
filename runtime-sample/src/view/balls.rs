//! Spheres that move about, lit by probes alone.

use std::{f32::consts::TAU, str::FromStr};

use anyhow::{Context, ensure};
use glam::Vec3;

use super::camera::Pose;
use crate::files::{bake::Bake, scene::Scene};

/// A sphere that goes to and fro. Places are relative to the middle of the scene.
#[derive(Clone, Debug)]
pub(crate) struct Ball {
    /// Where it begins, metres.
    pub(crate) from: Vec3,
    /// Where it turns back.
    pub(crate) to: Vec3,
    /// Metres.
    pub(crate) radius: f32,
    /// Linear.
    pub(crate) albedo: Vec3,
    /// Seconds until it is back.
    pub(crate) period: f32,
}

/// A sphere as the command line has it: `X,Y,Z,RADIUS` or `X,Y,Z,RADIUS,ALBEDO`, metres in the scene's axes.
#[derive(Clone, Debug)]
pub(crate) struct Still {
    centre: [f64; 3],
    radius: f32,
    albedo: f32,
}

impl FromStr for Still {
    type Err = anyhow::Error;

    fn from_str(text: &str) -> anyhow::Result<Self> {
        let shape = "a sphere is X,Y,Z,RADIUS or X,Y,Z,RADIUS,ALBEDO in metres, such as 1,0.5,-2,0.3";
        let numbers: Vec<f64> =
            text.split(',').map(|n| n.trim().parse()).collect::<Result<_, _>>().context(shape)?;
        ensure!(
            (4..=5).contains(&numbers.len()) && numbers.iter().all(|n| n.is_finite()) && 0.0 < numbers[3],
            "{shape}"
        );
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
        let single = |i: usize| numbers.get(i).map(|n| *n as f32);
        Ok(Self {
            centre: [numbers[0], numbers[1], numbers[2]],
            radius: single(3).unwrap_or(1.0),
            albedo: single(4).unwrap_or(1.0),
        })
    }
}

impl Still {
    /// That sphere.
    pub(crate) fn ball(&self, bake: &Bake) -> Ball {
        let at = (glam::DVec3::from(self.centre) - bake.scene.origin).as_vec3();
        Ball { from: at, to: at, radius: self.radius, albedo: Vec3::splat(self.albedo), period: 1.0 }
    }
}

impl Ball {
    /// Where it is after some seconds.
    pub(crate) fn at(&self, seconds: f32) -> Vec3 {
        self.from.lerp(self.to, 0.5 - 0.5 * (TAU * seconds / self.period).cos())
    }
}

/// Albedos: white, grey, red.
const ALBEDOS: [Vec3; 3] = [Vec3::splat(0.9), Vec3::splat(0.45), Vec3::new(0.75, 0.12, 0.08)];

/// Three spheres ahead of a camera whose ways are free; fewer where there is no room.
pub(crate) fn placed(scene: &Scene, pose: &Pose) -> Vec<Ball> {
    let eye = (pose.eye - scene.origin).as_vec3();
    let [right, up, forward] = pose.axes();
    let reach = pose.focus.min(scene.radius);
    // Beside and above the middle of the picture, and how far ahead, in parts of the way to what is there.
    let places = [[-0.28, -0.12, 0.45], [0.25, -0.05, 0.6], [0.0, -0.2, 0.35]];
    let ways = [forward, right, -right, -forward, up];
    let mut balls: Vec<Ball> = Vec::new();
    for (i, ([x, y, ahead], albedo)) in places.into_iter().zip(ALBEDOS).enumerate() {
        let radius = 0.035 * reach;
        // Higher and nearer, if there is no room.
        let tries = [[0.0, 1.0], [0.15, 1.0], [0.0, 0.6], [0.2, 0.6], [0.1, 0.35]];
        let place = tries
            .map(|[higher, part]| eye + (forward + right * x + up * (y + higher)) * (ahead * part * reach));
        let seen = |p: &Vec3| scene.meets(eye, *p - eye).is_none_or(|t| 1.0 < t) && roomy(scene, *p, radius);
        let Some(from) = place.into_iter().find(seen) else { continue };
        let free = |way: &&Vec3| clear(scene, from, **way * (0.3 * reach), radius);
        let way = ways.iter().cycle().skip(i).take(ways.len()).find(free);
        let to = way.map_or(from, |w| from + *w * (0.3 * reach));
        let period = 6.0 + 1.5 * i as f32;
        balls.push(Ball { from, to, radius, albedo, period });
    }
    balls
}

/// Whether nothing is nearer than a radius, along six rays.
fn roomy(scene: &Scene, p: Vec3, radius: f32) -> bool {
    Vec3::AXES
        .into_iter()
        .flat_map(|a| [a, -a])
        .all(|d| scene.meets(p, d * (1.2 * radius)).is_none_or(|t| 1.0 < t))
}

/// Whether a sphere can go along `way`, and there is room where it ends.
fn clear(scene: &Scene, from: Vec3, way: Vec3, radius: f32) -> bool {
    let (a, b) = way.normalize_or_zero().any_orthonormal_pair();
    let sides = [Vec3::ZERO, a, -a, b, -b];
    sides.iter().all(|s| scene.meets(from + *s * radius, way * 1.1).is_none_or(|t| 1.0 < t))
        && roomy(scene, from + way, radius)
}

/// Corners of the unit sphere and its triangles, `rings` from pole to pole.
pub(crate) fn sphere(rings: u32) -> (Vec<[f32; 3]>, Vec<u32>) {
    let sides = 2 * rings;
    let mut corners = Vec::new();
    let mut triangles = Vec::new();
    for i in 0..=rings {
        let (s, c) = (TAU * 0.5 * i as f32 / rings as f32).sin_cos();
        for j in 0..=sides {
            let (y, x) = (TAU * j as f32 / sides as f32).sin_cos();
            corners.push([s * x, c, -s * y]);
            if i < rings && j < sides {
                let at = i * (sides + 1) + j;
                let below = at + sides + 1;
                triangles.extend([at, below, at + 1, at + 1, below, below + 1]);
            }
        }
    }
    (corners, triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spheres_of_the_command_line() {
        let still: Still = "1, -2,3.5,0.25".parse().expect("a sphere");
        assert_eq!((still.centre, still.radius, still.albedo), ([1.0, -2.0, 3.5], 0.25, 1.0));
        for wrong in ["", "1,2,3", "1,2,3,0", "1,2,3,x", "1,2,3,1,1,1", "nan,0,0,1"] {
            assert!(wrong.parse::<Still>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn triangles_of_spheres_face_outwards() {
        let (corners, triangles) = sphere(6);
        for t in triangles.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2].map(|i| Vec3::from(corners[t[i] as usize]));
            let out = (b - a).cross(c - a).dot(a + b + c);
            assert!(-1e-6 < out, "{a} {b} {c}");
        }
    }

    #[test]
    fn balls_go_to_and_fro() {
        let ball = Ball { from: Vec3::ZERO, to: Vec3::X, radius: 0.1, albedo: Vec3::ONE, period: 4.0 };
        assert!(ball.at(0.0).abs_diff_eq(Vec3::ZERO, 1e-6) && ball.at(2.0).abs_diff_eq(Vec3::X, 1e-6));
    }
}
