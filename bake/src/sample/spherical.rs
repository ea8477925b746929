//! Triangles as a place sees them.

use glam::{DVec3, Vec3A};
use std::f64::consts::PI;

/// A triangle projected on the unit sphere around a place.
#[derive(Clone, Copy, Debug)]
pub struct SphericalTriangle {
    corners: [DVec3; 3],
    /// Angle at the first corner.
    alpha: f64,
    solid_angle: f64,
}

impl SphericalTriangle {
    /// Smallest solid angle that is sampled, steradian: rounding of the corners would be seen below.
    const LEAST: f64 = 1e-6;

    /// `None` where the triangle is seen along its plane or from too far away.
    #[must_use]
    pub fn new(from: Vec3A, corners: &[Vec3A; 3]) -> Option<Self> {
        let corners = corners.map(|c| (c.as_dvec3() - from.as_dvec3()).normalize_or_zero());
        let [a, b, c] = corners;
        // Normals of the planes through the place and each side.
        let [ab, bc, ca] = [a.cross(b), b.cross(c), c.cross(a)].map(DVec3::normalize_or_zero);
        if [ab, bc, ca].contains(&DVec3::ZERO) {
            return None;
        }
        let angle = |n: DVec3, m: DVec3| n.cross(m).length().atan2(n.dot(m));
        let (alpha, beta, gamma) = (angle(ab, -ca), angle(bc, -ab), angle(ca, -bc));
        let solid_angle = alpha + beta + gamma - PI;
        let known = (Self::LEAST..2.0 * PI).contains(&solid_angle);
        known.then_some(Self { corners, alpha, solid_angle })
    }

    /// Steradian.
    #[must_use]
    pub fn solid_angle(&self) -> f64 {
        self.solid_angle
    }

    /// A direction in it, uniform by solid angle: \[Arv95\] Arvo, "Stratified Sampling of Spherical Triangles", 1995, section 3.
    #[must_use]
    pub fn sample(&self, u: [f32; 2]) -> DVec3 {
        let [a, b, c] = self.corners;
        let (sin_alpha, cos_alpha) = self.alpha.sin_cos();
        let (s, t) = (f64::from(u[0]) * self.solid_angle - self.alpha).sin_cos();
        let p = t - cos_alpha;
        let q = s + sin_alpha * a.dot(b);
        let cos = ((q * t - p * s) * cos_alpha - q) / ((q * s + p * t) * sin_alpha);
        let cos = if cos.is_finite() { cos.clamp(-1.0, 1.0) } else { 1.0 };
        // Where the arc that parts off the area meets the side opposite the second corner, then a place on the arc.
        let on_side = on_arc(a, c, cos);
        on_arc(b, on_side, 1.0 - f64::from(u[1]) * (1.0 - on_side.dot(b)))
    }
}

/// The place on the arc from `a` towards `b` with a cosine to `a`.
fn on_arc(a: DVec3, b: DVec3, cos: f64) -> DVec3 {
    let side = (b - a * a.dot(b)).normalize_or_zero();
    a * cos + side * (1.0 - cos * cos).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An octant of the sphere, and the solid angle of any triangle by \[VOS83\] Van Oosterom & Strackee, "The Solid Angle of a Plane Triangle", eq. 8.
    #[test]
    fn solid_angles_have_their_closed_form() {
        let octant = SphericalTriangle::new(Vec3A::ZERO, &[Vec3A::X, Vec3A::Y * 3.0, Vec3A::Z * 0.1]);
        assert!((octant.expect("seen").solid_angle() - PI / 2.0).abs() < 1e-12);
        for i in 0..2000u32 {
            let u = |d| sobol_burley::sample(i, d, 5) - 0.5;
            let corners = [0, 3, 6].map(|d| Vec3A::new(u(d), u(d + 1), u(d + 2)));
            let Some(t) = SphericalTriangle::new(Vec3A::ZERO, &corners) else { continue };
            let [a, b, c] = corners.map(|c| c.as_dvec3().normalize());
            let tan = a.dot(b.cross(c)).abs() / (1.0 + a.dot(b) + b.dot(c) + c.dot(a));
            let want = 2.0 * tan.atan().rem_euclid(PI);
            assert!((t.solid_angle() - want).abs() < 1e-9 * (1.0 + want), "{corners:?}");
        }
    }

    /// The mean direction is that of Lambert's formula, and every direction is in the triangle.
    #[test]
    fn directions_are_uniform() {
        let shapes = [
            [Vec3A::X, Vec3A::Y, Vec3A::Z],
            [Vec3A::new(1.0, -0.75, 0.02), Vec3A::new(1.01, 0.75, 0.02), Vec3A::new(1.0, 0.75, 0.03)],
            [Vec3A::new(-0.2, 5.0, 0.01), Vec3A::new(-0.2, -4.0, 0.01), Vec3A::new(0.3, 0.0, 0.02)],
        ];
        for corners in shapes {
            let t = SphericalTriangle::new(Vec3A::ZERO, &corners).expect("seen");
            let n = 64u16;
            let mut mean = DVec3::ZERO;
            let c = corners.map(|c| c.as_dvec3());
            for i in 0..n {
                for j in 0..n {
                    let d =
                        t.sample([(f32::from(i) + 0.5) / f32::from(n), (f32::from(j) + 0.5) / f32::from(n)]);
                    assert!((d.length() - 1.0).abs() < 1e-9);
                    let side = c[0].dot(c[1].cross(c[2])).signum();
                    for k in 0..3 {
                        let inside = d.dot(c[k].cross(c[(k + 1) % 3]).normalize()) * side;
                        assert!(-1e-7 < inside, "{corners:?}: {inside}");
                    }
                    mean += d / f64::from(n * n);
                }
            }
            let mut want = DVec3::ZERO;
            for k in 0..3 {
                let (a, b) = (t.corners[k], t.corners[(k + 1) % 3]);
                want += a.cross(b).normalize() * a.angle_between(b) * 0.5;
            }
            let want = want * c[0].dot(c[1].cross(c[2])).signum() / t.solid_angle();
            assert!((mean - want).length() < 2e-3, "{corners:?}: {mean} {want}");
        }
    }
}
