//! Random numbers, warps and discrete distributions.
//!
//! Every number is a function of (seed, texel or point, sample, dimension), never of a thread or
//! of time, so that any split of the work gives the same bytes.

pub mod discrete;
pub mod sequence;
pub mod spherical;
pub mod warp;

pub use sequence::Sequence;
