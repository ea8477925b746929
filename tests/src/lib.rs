//! Scene builders and helpers for whole-tool tests.

pub mod gltf;
pub mod scenes;
pub mod shape;
