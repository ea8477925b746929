//! Light transport: the path-traced estimate of what arrives at a point.

pub mod connect;
pub mod direct;
mod encounter;
pub mod path;

pub use path::{Estimate, Kernel, Vertex};
