//! Spherical and zonal harmonics up to [`BANDS`] bands.
//!
//! Basis: real, orthonormal over the sphere, without the Condon-Shortley phase, so that band 1 is proportional to (y, z, x) with
//! positive signs. Coefficient (l, m) has index `l (l + 1) + m`. Zonal coefficients are those of m = 0 about the lobe's own
//! axis.

pub mod real;
pub mod zonal;

/// Bands of every expansion here: degrees 0 to 10, "order 11" in the literature on lighting.
pub const BANDS: usize = 11;

/// Zonal coefficients, f64.
pub type Zh64 = [f64; BANDS];

/// Zonal coefficients.
pub type Zh = [f32; BANDS];
