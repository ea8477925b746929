//! The scene: from glTF bytes to checked data in world units.

pub mod model;
pub mod texture;
