//! Geometry: triangles, rays, charts and texels.
