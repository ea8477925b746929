//! Rays, and the watertight test of a ray against a triangle.
//!
//! \[WBW13\] Woop, Benthin & Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013.

use glam::{Vec3, Vec3A};

/// A half line, or a segment up to `t_max`. Hits have `0 < t < t_max`.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Start, metres, relative to [`crate::geom::World::origin`].
    pub origin: Vec3A,
    /// Unit direction.
    pub direction: Vec3A,
    /// End, metres; infinity for a half line.
    pub t_max: f32,
}

/// The nearest thing a ray meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance, metres.
    pub t: f32,
    /// World triangle index.
    pub triangle: u32,
    /// Barycentric weights of the triangle's three corners.
    pub bary: [f32; 3],
}

/// A ray prepared for [`WatertightRay::intersect`]: \[WBW13\] section 3.
#[derive(Clone, Copy, Debug)]
pub struct WatertightRay {
    origin: [f32; 3],
    k: [usize; 3],
    shear: [f32; 3],
}

impl WatertightRay {
    /// Chooses the dominant axis of the direction and the shear that aligns it with the ray.
    #[must_use]
    pub fn new(ray: &Ray) -> Self {
        let (d, o) = (ray.direction, ray.origin);
        // One by one: out of memory the parts would have to wait for the whole.
        let (d, o) = ([d.x, d.y, d.z], [o.x, o.y, o.z]);
        let a = [d[0].abs(), d[1].abs(), d[2].abs()];
        let kz = if a[1] <= a[0] && a[2] <= a[0] {
            0
        } else if a[2] <= a[1] {
            1
        } else {
            2
        };
        let (mut kx, mut ky) = ((kz + 1) % 3, (kz + 2) % 3);
        // Keeping the winding makes the sign of the determinant say which side was hit.
        if d[kz] < 0.0 {
            std::mem::swap(&mut kx, &mut ky);
        }
        Self { origin: o, k: [kx, ky, kz], shear: [d[kx] / d[kz], d[ky] / d[kz], 1.0 / d[kz]] }
    }

    /// The axes that become x, y and z: z is the dominant one.
    #[must_use]
    #[inline]
    pub(crate) fn axes(&self) -> [usize; 3] {
        self.k
    }

    /// The ray's origin on [`Self::axes`], metres.
    #[must_use]
    #[inline]
    pub(crate) fn origin(&self) -> [f32; 3] {
        self.k.map(|axis| self.origin[axis])
    }

    /// Shear of x and y by z, and 1 over the direction's z.
    #[must_use]
    #[inline]
    pub(crate) fn shear(&self) -> [f32; 3] {
        self.shear
    }

    /// Distance and barycentric weights, or `None`. Edges are computed so that two triangles that
    /// share one never both miss it.
    #[must_use]
    #[inline]
    #[expect(clippy::cast_possible_truncation, reason = "the f64 fallback only needs the sign to be right")]
    pub fn intersect(&self, v: &[Vec3; 3], t_max: f32) -> Option<(f32, [f32; 3])> {
        let [kx, ky, kz] = self.k;
        let [sx, sy, sz] = self.shear;
        let rel = |p: Vec3| {
            let p = p.to_array();
            let z = p[kz] - self.origin[kz];
            [p[kx] - self.origin[kx] - sx * z, p[ky] - self.origin[ky] - sy * z, z]
        };
        let (a, b, c) = (rel(v[0]), rel(v[1]), rel(v[2]));
        let mut e = [c[0] * b[1] - c[1] * b[0], a[0] * c[1] - a[1] * c[0], b[0] * a[1] - b[1] * a[0]];
        if e[0] == 0.0 || e[1] == 0.0 || e[2] == 0.0 {
            // f32 cannot tell on which side of the edge the ray passes; f64 products are exact here.
            let cross = |p: [f32; 3], q: [f32; 3]| {
                (f64::from(p[0]) * f64::from(q[1]) - f64::from(p[1]) * f64::from(q[0])) as f32
            };
            e = [cross(c, b), cross(a, c), cross(b, a)];
        }
        if (e[0] < 0.0 || e[1] < 0.0 || e[2] < 0.0) && (0.0 < e[0] || 0.0 < e[1] || 0.0 < e[2]) {
            return None;
        }
        let det = e[0] + e[1] + e[2];
        if det == 0.0 {
            return None;
        }
        let inv = 1.0 / det;
        let t = (e[0] * a[2] + e[1] * b[2] + e[2] * c[2]) * sz * inv;
        // Written so that NaN (from coordinates near the largest f32) is a miss.
        if 0.0 < t && t < t_max { Some((t, [e[0] * inv, e[1] * inv, e[2] * inv])) } else { None }
    }
}

/// How far from a surface a ray has to start, so that rounding cannot put it behind the surface.
///
/// `magnitude` is the largest absolute coordinate of the triangle the point lies on. Interpolation
/// and the translation inside the intersection test each lose at most a few units in the last
/// place of it; 16 units cover their sum. The offset scales with the scene: there is no absolute
/// length in it.
#[must_use]
pub fn offset_distance(magnitude: f32) -> f32 {
    magnitude * (16.0 * f32::EPSILON)
}
