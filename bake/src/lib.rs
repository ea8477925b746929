//! Bakes a glTF scene into lightmaps.
//!
//! Data flows one way, and each module may use only those above it:
//!
//! ```text
//! error -> sample -> scene -> geom -> light -> plan -> transport -> solve -> output -> files
//! files -> compare;  cli stands above all
//! ```

pub mod cli;
pub mod compare;
pub mod error;
pub mod geom;
pub mod light;
pub mod output;
pub mod plan;
pub mod sample;
pub mod scene;
pub mod solve;
pub mod transport;
