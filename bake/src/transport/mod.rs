//! Light transport: the path-traced estimate of what arrives at a point.

pub(crate) mod air;
pub(crate) mod airlight;
pub mod around;
mod ask;
mod by_grid;
pub mod cache;
pub mod connect;
pub mod direct;
pub(crate) mod encounter;
mod fire;
mod glow;
pub(crate) mod lamps;
pub mod light_grid;
pub mod path;
mod volume;

pub use path::{Estimate, Kernel, Vertex};
