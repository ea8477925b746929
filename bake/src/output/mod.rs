//! Files: pages of texels become a bake's folder.
//!
//! Solved texels are denoised by [`denoise`] if that is asked for. A finished [`page::Page`] is repaired and padded by [`dilate`], its seams are closed by [`stitch`]; it is written by [`exr`], as engines take it
//! by [`texture`], and shown by [`preview`]. [`scene_glb`] writes the scene with its new texture coordinates, [`light_grid`] the light in
//! media, [`media`] what these are, [`sky`] an image of the sky, [`probes`] the light of the air. All of it goes
//! into a [`folder::Staging`] that replaces the previous bake at once when everything is there. [`html`] makes a page
//! for browsers of a folder.

pub mod assemble;
mod attach;
pub mod bc6h;
pub mod denoise;
pub mod dilate;
pub mod exr;
pub mod folder;
mod glb;
pub mod html;
pub mod ktx;
pub mod light_grid;
pub mod media;
pub mod page;
pub mod preview;
pub mod probes;
pub mod record;
pub mod scene_glb;
pub mod sky;
pub mod stitch;
pub mod texture;
pub mod view;
