//! Radiance from all directions at one place.

use crate::harmonics::{real, zonal};

/// Coefficients of the longest expansion, bands 0 to 3.
pub const MOST_COEFFICIENTS: usize = 16;

/// Which part of the radiance's expansion is kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Basis {
    /// Bands 0 and 1: 4 coefficients.
    L1,
    /// Bands 0 to 2: 9 coefficients.
    #[default]
    L2,
    /// Bands 0 to 3: 16 coefficients. Irradiance has no third band, so this is for fog and gloss.
    L3,
    /// Bands 0 and 1 and of band 2 what is symmetric about the axis of the luminance of band 1: 5 coefficients (\[RS24\] Roughton, Sloan,
    /// Silvennoinen, Iwanicki & Shirley, "ZH3: Quadratic Zonal Harmonics", I3D 2024).
    Zh3,
}

impl Basis {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::L1, Self::L2, Self::L3, Self::Zh3];

    /// Coefficients for each colour channel.
    #[must_use]
    pub const fn coefficients(self) -> usize {
        match self {
            Self::L1 => 4,
            Self::L2 => 9,
            Self::L3 => 16,
            Self::Zh3 => 5,
        }
    }

    /// Name in files and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::L1 => "l1",
            Self::L2 => "l2",
            Self::L3 => "l3",
            Self::Zh3 => "zh3",
        }
    }

    /// The basis of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|b| b.name() == name)
    }
}

/// Rec. 709.
const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// What a band of radiance gives to `E / pi`: the coefficients of the clamped cosine over pi.
const PER_BAND: [f32; 4] = [1.0, 2.0 / 3.0, 0.25, 0.0];

/// Radiance in nits as coefficients of a [`Basis`], each red, green and blue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    basis: Basis,
    values: [[f32; 3]; MOST_COEFFICIENTS],
}

impl Light {
    /// No light.
    #[must_use]
    pub const fn black(basis: Basis) -> Self {
        Self { basis, values: [[0.0; 3]; MOST_COEFFICIENTS] }
    }

    /// From as many coefficients as the basis has; the last of [`Basis::Zh3`] is zonal. More are left out, fewer are followed by zeros.
    #[must_use]
    pub fn new(basis: Basis, coefficients: &[[f32; 3]]) -> Self {
        let mut light = Self::black(basis);
        for (to, from) in light.values[..basis.coefficients()].iter_mut().zip(coefficients) {
            *to = *from;
        }
        light
    }

    /// The part of an expansion of bands 0 to 3 that a basis holds.
    #[must_use]
    pub fn project(basis: Basis, full: &[[f32; 3]; MOST_COEFFICIENTS]) -> Self {
        let mut light = Self::new(basis, full);
        if basis == Basis::Zh3 {
            let y: [f32; 9] = real::first(light.axis());
            light.values[4] =
                std::array::from_fn(|c| (4..9usize).map(|i| full[i][c] * y[i]).sum::<f32>() / norm2());
        }
        light
    }

    /// Which basis.
    #[must_use]
    pub const fn basis(&self) -> Basis {
        self.basis
    }

    /// Its coefficients.
    #[must_use]
    pub fn coefficients(&self) -> &[[f32; 3]] {
        &self.values[..self.basis.coefficients()]
    }

    /// Unit vector along the luminance of band 1; up where there is none.
    #[must_use]
    pub fn axis(&self) -> [f32; 3] {
        let of = |i: usize| self.values[i].iter().zip(LUMINANCE).map(|(v, l)| v * l).sum::<f32>();
        // Scaled first, so that squares neither overflow nor vanish.
        let v = [of(3), of(1), of(2)];
        let most = v.iter().fold(0.0f32, |m, x| m.max(x.abs()));
        if most == 0.0 {
            return [0.0, 1.0, 0.0];
        }
        let v = v.map(|x| x / most);
        let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
        v.map(|x| x / length)
    }

    /// All coefficients of bands 0 to 3; those that the basis lacks are 0.
    #[must_use]
    pub fn expand(&self) -> [[f32; 3]; MOST_COEFFICIENTS] {
        let mut full = self.values;
        if self.basis == Basis::Zh3 {
            let zonal = self.values[4];
            let y: [f32; 9] = real::first(self.axis());
            for i in 4..9 {
                full[i] = zonal.map(|z| z * y[i] / norm2());
            }
        }
        full
    }

    /// Adds another light of the same basis, times a weight.
    ///
    /// # Panics
    ///
    /// If the bases differ.
    pub fn add(&mut self, other: &Self, weight: f32) {
        assert_eq!(self.basis, other.basis);
        for (a, b) in self.values.iter_mut().zip(other.values) {
            for (a, b) in a.iter_mut().zip(b) {
                *a += b * weight;
            }
        }
    }

    /// Each band times a factor.
    pub fn scale_bands(&mut self, factors: [f32; 4]) {
        let n = self.basis.coefficients();
        for (i, v) in self.values[..n].iter_mut().enumerate() {
            *v = v.map(|v| v * factors[i.isqrt()]);
        }
    }

    /// `E / pi` of a surface with the unit normal `n`, nits: irradiance over pi, what a lightmap texel holds. Not clamped.
    #[must_use]
    pub fn irradiance(&self, n: [f32; 3]) -> [f32; 3] {
        let y: [f32; 9] = real::first(n);
        let full = self.expand();
        std::array::from_fn(|c| (0..9usize).map(|i| PER_BAND[i.isqrt()] * y[i] * full[i][c]).sum())
    }

    /// Radiance that arrives from the direction `d`, nits. Not clamped: a short expansion rings.
    #[must_use]
    pub fn radiance(&self, d: [f32; 3]) -> [f32; 3] {
        let y: [f32; MOST_COEFFICIENTS] = real::first(d);
        let full = self.expand();
        std::array::from_fn(|c| (0..MOST_COEFFICIENTS).map(|i: usize| y[i] * full[i][c]).sum())
    }
}

/// Of band 2 along its axis.
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
fn norm2() -> f32 {
    zonal::norm(2) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coefficients of a light of 1 lux from one direction.
    fn beam(d: [f32; 3]) -> [[f32; 3]; MOST_COEFFICIENTS] {
        let y: [f32; MOST_COEFFICIENTS] = real::first(d);
        y.map(|v| [v; 3])
    }

    #[test]
    fn even_light_is_the_same_on_all_sides() {
        let mut full = [[0.0; 3]; MOST_COEFFICIENTS];
        full[0] = [2.0 * (4.0 * std::f32::consts::PI).sqrt(); 3];
        for basis in Basis::ALL {
            let light = Light::project(basis, &full);
            for n in [[0.0, 1.0, 0.0], [0.6, 0.0, -0.8]] {
                assert!(light.irradiance(n).iter().all(|e| (e - 2.0).abs() < 1e-6), "{light:?}");
                assert!(light.radiance(n).iter().all(|e| (e - 2.0).abs() < 1e-6), "{light:?}");
            }
        }
    }

    /// A beam's irradiance by bands: 1/4 + 1/2 cos + 5/32 (3 cos^2 - 1), each over pi. Band 2 of ZH3 is exact here, since the light is symmetric.
    #[test]
    fn a_beam_by_bands() {
        let d = [0.6, -0.64, 0.48];
        for basis in Basis::ALL {
            let light = Light::project(basis, &beam(d));
            for n in [d, [0.8, 0.6, 0.0], [0.0, 0.0, -1.0]] {
                let cos: f32 = n.iter().zip(d).map(|(a, b)| a * b).sum();
                let second = if basis == Basis::L1 { 0.0 } else { 5.0 / 32.0 * (3.0 * cos * cos - 1.0) };
                let want = (0.25 + 0.5 * cos + second) * std::f32::consts::FRAC_1_PI;
                for e in light.irradiance(n) {
                    assert!((e - want).abs() < 1e-6, "{basis:?} {n:?}: {e} {want}");
                }
            }
        }
    }

    #[test]
    fn axes_of_dim_and_bright_lights_are_unit_vectors() {
        for scale in [1e-30f32, 1.0, 1e30] {
            let full = beam([0.0, 0.6, 0.8]).map(|v| v.map(|v| v * scale));
            let axis = Light::project(Basis::Zh3, &full).axis();
            assert!((axis[1] - 0.6).abs() < 1e-6 && (axis[2] - 0.8).abs() < 1e-6, "{axis:?}");
        }
        assert_eq!(Light::black(Basis::Zh3).axis(), [0.0, 1.0, 0.0]);
    }
}
