//! Maps from the unit square to directions and points, each with its density.

use glam::Vec3A;
use std::f32::consts::{FRAC_1_PI, PI};

/// Concentric map of the unit square to the unit disc, uniform by area.
///
/// \[SC97\] Shirley & Chiu, "A low distortion map between disk and square", JGT 2(3), 1997.
#[must_use]
pub fn square_to_disc(u: [f32; 2]) -> [f32; 2] {
    let (a, b) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    if a == 0.0 && b == 0.0 {
        return [0.0, 0.0];
    }
    let (r, phi) =
        if b.abs() < a.abs() { (a, PI / 4.0 * (b / a)) } else { (b, PI / 2.0 - PI / 4.0 * (a / b)) };
    let (s, c) = phi.sin_cos();
    [r * c, r * s]
}

/// Direction in the hemisphere around +Z with density [`cos_hemisphere_pdf`] per steradian.
#[must_use]
pub fn square_to_cos_hemisphere(u: [f32; 2]) -> Vec3A {
    let [x, y] = square_to_disc(u);
    Vec3A::new(x, y, (1.0 - x * x - y * y).max(0.0).sqrt())
}

/// Density of [`square_to_cos_hemisphere`] per steradian: `cos(theta) / pi`.
#[must_use]
pub fn cos_hemisphere_pdf(cos_theta: f32) -> f32 {
    cos_theta.max(0.0) * FRAC_1_PI
}

/// Direction around +Z within the half angle whose `1 - cos` is given, uniform by solid angle.
///
/// `one_minus_cos` is passed instead of the cosine because for the sun it is 1e-5 and would lose
/// its digits.
#[must_use]
pub fn square_to_cone(u: [f32; 2], one_minus_cos: f32) -> Vec3A {
    let [x, y] = square_to_disc(u);
    // Equal areas on the disc become equal heights on the cap.
    let r2 = x * x + y * y;
    let h = r2 * one_minus_cos;
    let scale = (one_minus_cos * (2.0 - h)).max(0.0).sqrt();
    Vec3A::new(x * scale, y * scale, 1.0 - h)
}

/// Barycentric coordinates uniform over a triangle, by folding the unit square along its diagonal
/// in a way that keeps stratification: \[Hei19\] Heitz, "A Low-Distortion Map Between Triangle and
/// Square", 2019.
#[must_use]
pub fn square_to_triangle(u: [f32; 2]) -> [f32; 3] {
    let (mut a, mut b) = (u[0], u[1]);
    if a < b {
        a *= 0.5;
        b -= a;
    } else {
        b *= 0.5;
        a -= b;
    }
    [a, b, (1.0 - a - b).max(0.0)]
}

/// Right-handed orthonormal frame around a unit vector.
///
/// \[Duf17\] Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// First tangent.
    pub x: Vec3A,
    /// Second tangent.
    pub y: Vec3A,
    /// The vector the frame was made from.
    pub z: Vec3A,
}

impl Frame {
    /// The frame whose third axis is `z`.
    #[must_use]
    pub fn new(z: Vec3A) -> Self {
        let s = 1.0f32.copysign(z.z);
        let a = -1.0 / (s + z.z);
        let b = z.x * z.y * a;
        Self {
            x: Vec3A::new(1.0 + s * z.x * z.x * a, s * b, -s * z.x),
            y: Vec3A::new(b, s + z.y * z.y * a, -z.y),
            z,
        }
    }

    /// From this frame to the world.
    #[must_use]
    pub fn to_world(&self, v: Vec3A) -> Vec3A {
        self.x * v.x + self.y * v.y + self.z * v.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(n: u16) -> impl Iterator<Item = [f32; 2]> {
        (0..n).flat_map(move |i| {
            (0..n).map(move |j| [(f32::from(i) + 0.5) / f32::from(n), (f32::from(j) + 0.5) / f32::from(n)])
        })
    }

    /// First moments of a cosine lobe are known: E[z] = 2/3, E[z^2] = 1/2, E[x] = 0.
    #[test]
    fn cos_hemisphere_has_its_moments() {
        let n = 256;
        let (mut z, mut z2, mut x) = (0.0f64, 0.0f64, 0.0f64);
        for u in grid(n) {
            let w = square_to_cos_hemisphere(u);
            assert!((w.length() - 1.0).abs() < 1e-5);
            z += f64::from(w.z);
            z2 += f64::from(w.z * w.z);
            x += f64::from(w.x);
        }
        let m = f64::from(n) * f64::from(n);
        assert!((z / m - 2.0 / 3.0).abs() < 1e-3, "{}", z / m);
        assert!((z2 / m - 0.5).abs() < 1e-3, "{}", z2 / m);
        assert!((x / m).abs() < 1e-5, "{}", x / m);
    }

    /// Heights in a cone are uniform, and directions stay inside it even where it is as thin as the sun.
    #[test]
    fn cone_is_uniform_in_height() {
        for half_angle in [0.0023f32, 0.5, 1.5] {
            let h = 2.0 * (half_angle / 2.0).sin().powi(2);
            let n = 128;
            let mut mean = 0.0f64;
            for u in grid(n) {
                let w = square_to_cone(u, h);
                assert!((w.length() - 1.0).abs() < 1e-5);
                mean += f64::from(w.x * w.x + w.y * w.y);
            }
            mean /= f64::from(n) * f64::from(n);
            // Mean of sin^2 over the cap: h - h^2/3 by integration of 2t - t^2 over heights.
            let want = f64::from(h) - f64::from(h) * f64::from(h) / 3.0;
            assert!((mean / want - 1.0).abs() < 1e-3, "{half_angle}: {mean} {want}");
        }
    }

    #[test]
    fn triangle_is_uniform() {
        let mut c = [0.0f64; 3];
        let n = 128;
        for u in grid(n) {
            let b = square_to_triangle(u);
            assert!((b[0] + b[1] + b[2] - 1.0).abs() < 1e-6 && b.iter().all(|&x| 0.0 <= x));
            for k in 0..3 {
                c[k] += f64::from(b[k]);
            }
        }
        for x in c {
            assert!((x / (f64::from(n) * f64::from(n)) - 1.0 / 3.0).abs() < 1e-3, "{c:?}");
        }
    }

    #[test]
    fn frames_are_orthonormal_everywhere() {
        for z in [
            Vec3A::Z,
            -Vec3A::Z,
            Vec3A::X,
            Vec3A::new(0.6, 0.0, -0.8),
            Vec3A::new(1e-4, 0.0, -1.0).normalize(),
        ] {
            let f = Frame::new(z);
            for (a, b, want) in
                [(f.x, f.y, 0.0), (f.y, f.z, 0.0), (f.x, f.z, 0.0), (f.x, f.x, 1.0), (f.y, f.y, 1.0)]
            {
                assert!((a.dot(b) - want).abs() < 1e-5, "{z}: {f:?}");
            }
            assert!((f.x.cross(f.y) - f.z).length() < 1e-5);
        }
    }
}
