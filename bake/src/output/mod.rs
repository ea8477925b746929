//! Files: pages of texels become a bake's folder.
//!
//! A finished [`page::Page`] is repaired and padded by [`dilate`], written by [`exr`] and shown by
//! [`preview`]. [`scene_glb`] writes the scene with its new texture coordinates, [`light_grid`] the light in
//! media, [`probes`] that of the air. All of it goes
//! into a [`folder::Staging`] that replaces the previous bake at once when everything is there.

pub mod assemble;
pub mod dilate;
pub mod exr;
pub mod folder;
mod glb;
mod ktx;
pub mod light_grid;
pub mod page;
pub mod preview;
pub mod probes;
pub mod record;
pub mod scene_glb;
pub mod view;
