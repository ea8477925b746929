//! The scene: from glTF bytes to checked data in world units.

pub mod accessor;
pub mod config;
pub mod document;
mod findings;
mod meshopt;
pub mod model;
mod read;
pub mod sky;
mod uri;
