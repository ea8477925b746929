//! The scene: from glTF bytes to checked data in world units.

pub mod accessor;
pub mod black_body;
mod check;
pub mod config;
pub(crate) mod density;
pub mod document;
mod emission_words;
mod findings;
pub mod gltf;
mod gltf_material;
mod gltf_mesh;
mod gltf_nodes;
#[cfg(test)]
mod gltf_tests;
mod images;
mod media_words;
mod meshopt;
pub mod model;
mod probe_words;
mod read;
pub mod sky;
pub mod texture;
mod uri;
pub mod voxels;
