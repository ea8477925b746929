//! Geometry: triangles, rays, charts and texels.

pub mod atlas;
pub mod texel;
