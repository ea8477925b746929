//! Opens a bake's folder. Nothing here draws: read these files to learn what each file of a bake holds.
//!
//! - [`bake`]: the manifest, and what it names;
//! - [`page`]: lightmaps, flat and directional, with their standard errors;
//! - [`scene`]: `scene.glb`, triangles with their atlas coordinates;
//! - [`volume`]: light in the air, and media.
//!
//! Places are metres in the scene's axes until they are uploaded.

mod accessor;
pub(crate) mod bake;
pub(crate) mod ktx;
pub(crate) mod material;
pub(crate) mod page;
pub(crate) mod scene;
pub(crate) mod volume;

/// Weights of Rec. 709 luminance.
pub(crate) const LUMINANCE: glam::Vec3 = glam::Vec3::new(0.2126, 0.7152, 0.0722);
