//! Impulse responses: the light that a medium sends to a receiver for one emitter, as zonal coefficients about the direction to the
//! emitter.
//!
//! All for sigma_t = 1, so distances are in mean free paths, and for an infinite medium (directional light: a half space under a
//! vacuum). Unscattered light is never included. Everything in this module is exact up to quadrature and slow; tables are
//! made of it.
//!
//! | emitter | order 1 | orders from 2 on |
//! |---|---|---|
//! | point, 1 candela | [`point::single`] | [`moments`]: every g, every order, all at once |
//! | directional, 1 lux on the plane | [`directional::single`] | [`directional::HalfSpace`]: g = 0 |
//! | patch, 1 nit and 1 area | [`patch::single`] | [`patch::Orders`]: g = 0 |

pub mod directional;
pub mod interpolation;
pub mod moments;
pub mod patch;
pub mod point;
pub mod quadrature;
