//! Tables of impulse responses: a file, how it is made and how it answers.
//!
//! What [`crate::response`] computes is smooth once the distance and the exponential are divided out, so a few nodes and cubic or
//! Chebyshev interpolation stand for all of it.

pub mod build;
pub mod combined;
pub mod file;
pub mod query;
pub mod verify;

pub use combined::{Combined, CombinedPatch, Range, Way};
pub use file::Tables;
pub use query::{Answer, Orders, Query};
