//! Geometry: triangles in the world, rays and the tree they traverse, charts and texels.

pub mod atlas;
pub mod bvh;
pub mod cells;
pub mod ray;
pub mod seams;
pub mod shade;
pub mod texel;
pub mod voxels;
pub mod world;

pub use bvh::Bvh;
pub use ray::{Hit, Ray};
pub use world::World;
