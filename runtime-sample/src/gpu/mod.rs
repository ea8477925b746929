//! Draws on the platform's graphics interface.
//!
//! - [`device`]: the adapter;
//! - [`uploaded`]: a bake on the card;
//! - [`lamps`]: their shadow maps;
//! - [`uniforms`]: what shaders are told of a picture;
//! - [`renderer`]: passes of a frame.

pub(crate) mod device;
mod lamps;
mod pipelines;
pub(crate) mod renderer;
mod uniforms;
pub(crate) mod uploaded;

pub(crate) use lamps::MOST_LAMPS;
