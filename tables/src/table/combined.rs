//! Responses for baking: orders of scattering added up once for a scene, single precision, a few nanoseconds a look-up.

use super::file::{Emitter, Tables};
use super::query::{Orders, Query, QueryError};
use crate::harmonics::zonal::{CLAMPED_COSINE, CLAMPED_COSINE_F32, double_product, norm};
use crate::harmonics::{BANDS, Zh, real};
use crate::response::patch::Response;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Nodes over distance, equal ratios.
const DISTANCES: usize = 96;
/// Nearest and farthest distance.
const ENDS: (f64, f64) = (1e-6, 1e3);
/// Nodes over artanh(g) from -0.9 to 0.9, or the part of them that is needed.
const GS: f64 = 24.0;
/// Nodes over sqrt(1 - albedo), or the part of them that is needed.
const ALBEDOS: f64 = 32.0;
/// The same for patches.
const PATCH_DISTANCES: usize = 64;
/// Nodes over the square root of cos(theta) of a patch, whose back nobody sees.
const ANGLES: usize = 16;

/// Values that a quantity takes in a scene: one, or all from the first to the second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Least value.
    pub from: f64,
    /// Greatest value.
    pub to: f64,
}

impl From<f64> for Range {
    fn from(x: f64) -> Self {
        Self { from: x, to: x }
    }
}

/// Equidistant nodes.
#[derive(Clone, Copy, Debug)]
struct Even {
    from: f32,
    per_unit: f32,
    n: usize,
}

impl Even {
    #[expect(clippy::cast_possible_truncation, reason = "single precision is what is asked for")]
    fn new(from: f64, to: f64, n: usize) -> Self {
        if to <= from {
            return Self { from: from as f32, per_unit: 0.0, n: 1 };
        }
        Self { from: from as f32, per_unit: ((n - 1) as f64 / (to - from)) as f32, n }
    }

    /// As many nodes as there are at `per_unit` in each unit; four at least, or one.
    fn part(from: f64, to: f64, per_unit: f64) -> Self {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small number")]
        let n = ((to - from) * per_unit).ceil() as usize + 1;
        Self::new(from, to, n.max(4))
    }

    fn node(&self, i: usize) -> f64 {
        if self.n == 1 {
            return f64::from(self.from);
        }
        f64::from(self.from) + i as f64 / f64::from(self.per_unit)
    }

    /// The first of the neighbours, and their weights: four, or the only node.
    #[inline(always)]
    fn at(&self, x: f32) -> (usize, [f32; 4], usize) {
        if self.n == 1 {
            return (0, [1.0, 0.0, 0.0, 0.0], 1);
        }
        // NaN becomes the first node.
        let place = ((x - self.from) * self.per_unit).max(0.0).min((self.n - 1) as f32);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped above")]
        let first = (place as usize).saturating_sub(1).min(self.n - 4);
        let t = place - first as f32;
        let (a, b, c, d) = (t, t - 1.0, t - 2.0, t - 3.0);
        let (bc, ad) = (b * c, a * d);
        (first, [bc * d * (-1.0 / 6.0), ad * c * 0.5, ad * b * -0.5, a * bc * (1.0 / 6.0)], 4)
    }
}

/// What an entry of any grid begins with: the logarithm of the first coefficient, divided by what it changes most with, and the decay
/// that was taken out.
const FIRST: usize = 0;
const DECAY: usize = 1;
/// What follows is the emitter's own.
const OWN: usize = 2;

/// Entries over distance, angle, g and albedo, cubic between them.
#[derive(Clone, Debug)]
struct Grid<const LANES: usize> {
    emitter: Emitter,
    /// Lowest order: the light is proportional to albedo^lowest where that is small.
    lowest: i32,
    /// That power, where there is one albedo.
    power: f32,
    distance: Even,
    g: Even,
    albedo: Even,
    /// Nodes over angle.
    angles: usize,
    /// Distance runs fastest, then angle, g, albedo.
    entries: Vec<[f32; LANES]>,
}

impl<const LANES: usize> Grid<LANES> {
    /// `own` writes what belongs to the emitter.
    fn new(
        tables: &Tables,
        emitter: Emitter,
        orders: Orders,
        g: Range,
        albedo: Range,
        own: impl Fn(&Response, &Query, &mut [f32]) + Sync,
    ) -> Result<Self, QueryError> {
        let lowest = match orders {
            Orders::Span(from, _) => from.try_into().unwrap_or(i32::MAX),
            Orders::Rest => 2,
            Orders::All => 1,
        };
        let area = emitter == Emitter::Area;
        let distances = if area { PATCH_DISTANCES } else { DISTANCES };
        let mut out = Self {
            emitter,
            lowest,
            #[expect(clippy::cast_possible_truncation, reason = "single precision is what is asked for")]
            power: albedo.to.powi(lowest) as f32,
            distance: Even::new(ENDS.0.ln(), ENDS.1.ln(), distances),
            g: Even::part(g.from.atanh(), g.to.atanh(), GS / (2.0 * 0.9f64.atanh())),
            albedo: Even::part((1.0 - albedo.to).sqrt(), (1.0 - albedo.from).sqrt(), ALBEDOS),
            angles: if area { ANGLES } else { 1 },
            entries: Vec::new(),
        };
        let mut columns = Vec::new();
        for a in 0..out.albedo.n {
            for g in 0..out.g.n {
                columns.extend((0..out.angles).map(|angle| (a, g, angle)));
            }
        }
        let filled: Result<Vec<Vec<[f32; LANES]>>, QueryError> = columns
            .into_par_iter()
            .map(|(a, g, angle)| {
                // At no albedo at all there is no light, but its shape has a limit.
                let albedo = (1.0 - out.albedo.node(a).powi(2)).clamp(1e-6, 1.0);
                let g = out.g.node(g).tanh();
                out.column(
                    tables,
                    &Query { emitter, depth: 0.0, theta: theta(angle), g, albedo, orders },
                    &own,
                )
            })
            .collect();
        out.entries = filled?.concat();
        Ok(out)
    }

    /// The same with those of the emitter's own numbers left out that `which` names.
    fn without(mut self, which: impl Fn(usize) -> bool) -> Self {
        for entry in &mut self.entries {
            let own = entry[OWN..].iter_mut().enumerate();
            own.filter(|(k, _)| which(*k)).for_each(|(_, v)| *v = 0.0);
        }
        self
    }

    /// Entries over distance.
    #[expect(clippy::cast_possible_truncation, reason = "single precision is what is asked for")]
    fn column(
        &self,
        tables: &Tables,
        q: &Query,
        own: &impl Fn(&Response, &Query, &mut [f32]),
    ) -> Result<Vec<[f32; LANES]>, QueryError> {
        let decay = tables.decay(q);
        (0..self.distance.n)
            .map(|i| {
                let depth = self.distance.node(i).exp();
                let q = Query { depth, ..*q };
                let light = tables.light_log(&q, decay * depth)?;
                let spread = if self.emitter == Emitter::Directional { 1.0 } else { depth };
                let mut entry = [0.0; LANES];
                entry[FIRST] = (light[0] * spread / q.albedo.powi(self.lowest)).ln() as f32;
                entry[DECAY] = decay as f32;
                own(&light, &q, &mut entry[OWN..]);
                Ok(entry)
            })
            .collect()
    }

    /// First coefficient and the emitter's own numbers.
    #[inline(always)]
    fn look_up(&self, depth: f32, g: f32, albedo: f32, cosine: f32) -> (f32, [f32; LANES]) {
        let (d, wd, _) = self.distance.at(depth.ln());
        let (ig, wg, ng) = self.g.at(if self.g.n == 1 { 0.0 } else { g.atanh() });
        let (ia, wa, na) = self.albedo.at(if self.albedo.n == 1 { 0.0 } else { (1.0 - albedo).sqrt() });
        let (it, wt, nt) = if self.angles == 1 {
            (0, [1.0, 0.0, 0.0, 0.0], 1)
        } else {
            let even = Even { from: 0.0, per_unit: (ANGLES - 1) as f32, n: ANGLES };
            even.at(cosine.max(0.0).sqrt())
        };
        let mut sum = [0.0f32; LANES];
        for (a, &wa) in wa[..na].iter().enumerate() {
            for (k, &wg) in wg[..ng].iter().enumerate() {
                for (t, &wt) in wt[..nt].iter().enumerate() {
                    let column = ((ia + a) * self.g.n + ig + k) * self.angles + it + t;
                    let start = column * self.distance.n + d;
                    let w = wa * wg * wt;
                    for (entry, wd) in self.entries[start..start + 4].iter().zip(wd) {
                        let w = w * wd;
                        for (s, e) in sum.iter_mut().zip(entry) {
                            *s += w * e;
                        }
                    }
                }
            }
        }
        let power = if self.albedo.n == 1 { self.power } else { albedo.powi(self.lowest) };
        let mut first = power * (sum[FIRST] - sum[DECAY] * depth).exp();
        if self.emitter != Emitter::Directional {
            first /= depth;
        }
        (first, sum)
    }
}

/// The light of a point or a sun of strength 1 in a medium with sigma_t = 1, see [`strength`].
///
/// Where g varies, the sum of all orders is up to 1 % off at optical depths of 50, where it has long been too weak to see; else
/// this differs from the file by less than 2e-3 of the first coefficient.
#[derive(Clone, Debug)]
pub struct Combined(Grid<16>);

impl Combined {
    /// Adds up orders for media of the given g and albedos.
    ///
    /// # Errors
    ///
    /// If the file lacks a table or a range means nothing.
    #[expect(clippy::cast_possible_truncation, reason = "single precision is what is asked for")]
    pub fn new(
        tables: &Tables,
        emitter: Emitter,
        orders: Orders,
        g: Range,
        albedo: Range,
    ) -> Result<Self, QueryError> {
        if emitter == Emitter::Area {
            return Err(QueryError::Nonsense("the light of a patch is no lobe about the way to it"));
        }
        // About the way to the emitter, where order m = 0 is all there is.
        let ratios = |light: &Response, _: &Query, own: &mut [f32]| {
            for (l, o) in (1..BANDS).zip(own) {
                *o = (light[l * (l + 1) / 2] / light[0]) as f32;
            }
        };
        Grid::new(tables, emitter, orders, g, albedo, ratios).map(Self)
    }

    /// The same with coefficients of the first `order` bands alone, at least one.
    #[must_use]
    pub fn truncated(self, order: usize) -> Self {
        Self(self.0.without(|own| order <= own + 1))
    }

    /// Zonal coefficients about the way to the emitter for an optical depth (mean free paths), g and albedo.
    #[must_use]
    #[inline]
    pub fn look_up(&self, depth: f32, g: f32, albedo: f32) -> Zh {
        let (first, own) = self.0.look_up(depth, g, albedo, 1.0);
        let mut zh = [first; BANDS];
        for (z, o) in zh[1..].iter_mut().zip(&own[OWN..]) {
            *z *= o;
        }
        zh
    }

    /// Irradiance on a plane whose normal has the cosine `x` to the way to the emitter. What truncation makes negative is for the
    /// caller to clamp to 0 and count.
    #[must_use]
    #[inline]
    pub fn irradiance(&self, depth: f32, g: f32, albedo: f32, x: f32) -> f32 {
        double_product(&self.look_up(depth, g, albedo), &CLAMPED_COSINE_F32, x)
    }
}

/// Irradiance by the first coefficient alone, on any plane: sqrt(pi) / 2.
const OF_FIRST: f32 = 0.886_226_9;

/// Radians; the file's numbers divided by its sine are still good to 1e-3.
const BESIDE_A_POLE: f64 = 0.1;

/// Coefficients (l, m) that the irradiance is made of: odd bands from 3 on have no part in it, and the even ones beyond 4 so little
/// that they are left out.
const PLACES: [(usize, usize); 10] =
    [(1, 0), (1, 1), (2, 0), (2, 1), (2, 2), (4, 0), (4, 1), (4, 2), (4, 3), (4, 4)];

/// Real spherical harmonics at [`PLACES`], but for constant factors.
#[inline(always)]
fn polynomials([x, y, z]: [f32; 3]) -> [f32; 10] {
    let (xx, yy, zz, xz) = (x * x, y * y, z * z, x * z);
    let (difference, seven) = (xx - yy, 7.0 * zz);
    [
        z,
        x,
        3.0 * zz - 1.0,
        xz,
        difference,
        zz * (35.0 * zz - 30.0) + 3.0,
        xz * (seven - 3.0),
        difference * (seven - 1.0),
        xz * (xx - 3.0 * yy),
        difference * difference - 4.0 * xx * yy,
    ]
}

/// The irradiance by a patch with radiance x area 1 in a medium with sigma_t = 1, on its front side.
///
/// Of full harmonics up to band 4: the lobe that fits best costs up to a third of the irradiance on some planes where light is scattered
/// backwards, and its axis jumps, so it cannot be interpolated. What is left out of the bands beyond is at most 2.3 % of sqrt(pi) times
/// the first coefficient for |g| up to 0.5 and 4.4 % at 0.8, both close to a patch that faces the receiver.
#[derive(Clone, Debug)]
pub struct CombinedPatch(Grid<12>);

impl CombinedPatch {
    /// Adds up orders for media of the given g and albedos.
    ///
    /// # Errors
    ///
    /// If the file lacks a table or a range means nothing.
    #[expect(clippy::cast_possible_truncation, reason = "single precision is what is asked for")]
    pub fn new(tables: &Tables, orders: Orders, g: Range, albedo: Range) -> Result<Self, QueryError> {
        // Any direction tells the constant factors.
        let any = [0.36f32, 0.48, 0.8];
        let (exact, rough) = (real::basis(any.map(f64::from)), polynomials(any));
        let factors: Vec<f64> = PLACES
            .iter()
            .zip(rough)
            .map(|(&(l, m), p)| exact[l * (l + 1) + m] / f64::from(p) * CLAMPED_COSINE[l] / norm(l))
            .map(|f| f / (CLAMPED_COSINE[0] / norm(0) * exact[0]))
            .collect();
        let own = |light: &Response, q: &Query, own: &mut [f32]| {
            // Odd coefficients vanish with the sine, whose slope would be infinite in the cosine: they are divided by it, at the
            // poles a little beside them.
            let off_pole = Query { theta: q.theta.clamp(BESIDE_A_POLE, PI - BESIDE_A_POLE), ..*q };
            let beside = if off_pole == *q {
                None
            } else {
                tables.light_log(&off_pole, tables.decay(q) * q.depth).ok()
            };
            let odd = beside.as_ref().unwrap_or(light);
            for ((o, (l, m)), factor) in own.iter_mut().zip(PLACES).zip(&factors) {
                let of = |a: &Response| a[l * (l + 1) / 2 + m] / a[0];
                let v = if m % 2 == 1 { of(odd) / off_pole.theta.sin() } else { of(light) };
                // With the factors between light and irradiance.
                *o = (v * factor) as f32;
            }
        };
        Grid::new(tables, Emitter::Area, orders, g, albedo, own).map(Self)
    }

    /// The same with coefficients of the first `order` bands alone, at least one.
    #[must_use]
    pub fn truncated(self, order: usize) -> Self {
        Self(self.0.without(|own| PLACES.get(own).is_some_and(|(l, _)| order <= *l)))
    }

    /// Irradiance for an optical depth (mean free paths), g, albedo, the cosine between the patch's normal and the way to the
    /// receiver (below 0 it counts as 0), and the receiver's normal in the frame of [`crate::response::patch`]: z is the way to the patch, x the part of the
    /// patch's normal across it. What truncation makes negative is for the caller to clamp to 0 and count.
    #[must_use]
    #[inline]
    pub fn irradiance(&self, depth: f32, g: f32, albedo: f32, cosine: f32, normal: [f32; 3]) -> f32 {
        let (first, own) = self.0.look_up(depth, g, albedo, cosine);
        let (mut even, mut odd) = (1.0, 0.0);
        for (((_, m), o), p) in PLACES.iter().zip(&own[OWN..]).zip(polynomials(normal)) {
            if m % 2 == 1 { odd += o * p } else { even += o * p }
        }
        let sine = (1.0 - cosine * cosine).max(0.0).sqrt();
        first * OF_FIRST * (even + sine * odd)
    }
}

/// What a look-up has to be multiplied with for an emitter of some strength: candela, lux, or radiance times area. Points and
/// patches shine with the square of sigma_t (1/m) (\[IR19\] section 4.3), suns do not.
#[must_use]
#[inline]
pub fn strength(emitter: Emitter, strength: f32, sigma_t: f32) -> f32 {
    if emitter == Emitter::Directional { strength } else { strength * sigma_t * sigma_t }
}

/// Angle of a node of a patch.
fn theta(angle: usize) -> f64 {
    (angle as f64 / (ANGLES - 1) as f64).powi(2).acos()
}

/// Coefficients along a way through media, as if they were the same everywhere on it (\[IR19\] section 4.3 and 4.4).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Way {
    /// Metres.
    pub length: f32,
    /// Integral of sigma_t.
    pub optical_depth: f32,
    /// Integral of sigma_s.
    pub scattering: f32,
    /// Integral of g sigma_s.
    pub forward: f32,
}

impl Way {
    /// Goes on for `length` metres in a medium with sigma_s and sigma_a per metre.
    #[inline]
    pub fn add(&mut self, length: f32, sigma_s: f32, sigma_a: f32, g: f32) {
        self.length += length;
        self.optical_depth += length * (sigma_s + sigma_a);
        self.scattering += length * sigma_s;
        self.forward += length * sigma_s * g;
    }

    /// Mean sigma_t, 1/m.
    #[must_use]
    #[inline]
    pub fn sigma_t(&self) -> f32 {
        if 0.0 < self.length { self.optical_depth / self.length } else { 0.0 }
    }

    /// Albedo; 0 where there is no medium.
    #[must_use]
    #[inline]
    pub fn albedo(&self) -> f32 {
        if 0.0 < self.optical_depth { (self.scattering / self.optical_depth).min(1.0) } else { 0.0 }
    }

    /// Mean cosine, weighed by sigma_s.
    #[must_use]
    #[inline]
    pub fn g(&self) -> f32 {
        if 0.0 < self.scattering { self.forward / self.scattering } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_add_up_along_a_way() {
        let mut way = Way::default();
        assert_eq!((way.albedo(), way.g(), way.sigma_t()), (0.0, 0.0, 0.0));
        way.add(2.0, 0.5, 0.0, 0.8);
        way.add(6.0, 0.0, 0.5, 0.0);
        way.add(2.0, 0.5, 0.0, -0.2);
        assert!((way.sigma_t() - 0.5).abs() < 1e-7);
        assert!((way.albedo() - 0.4).abs() < 1e-7);
        assert!((way.g() - 0.3).abs() < 1e-6);
    }
}
