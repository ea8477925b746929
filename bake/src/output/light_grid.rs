//! The light grid of media as a texture that a fog shader samples.
//!
//! `light-grid.ktx2` is a three-dimensional texture of half floats, seven blocks of slices one behind the other along z. Texel `rgb` of block k, 0 to 6, is
//! coefficient k of the radiance at a node, nits, in real spherical harmonics (\[Slo13\], the order and signs of [`tables::harmonics`]: 1, y, z, x,
//! xy, yz, 3z^2 - 1, xz, x^2 - y^2); of coefficients 7 and 8 the `a` of blocks 0 to 2 and 3 to 5 have red, green and blue. The `a` of block 6 is 1, and all
//! is 0 at nodes inside of solid things, which see the backs of surfaces in more than a quarter of all directions: dividing by what is interpolated of it leaves them out. The first and the last slice of each block
//! are there twice, so that linear filtering never mixes blocks. Graphics cards take 2,048 slices, mostly: a lattice of more than 290 nodes along z, as of very long
//! corridors, is beyond that. The manifest says where nodes are, see [`manifest::LightGrid`].
//!
//! The light is all that arrives, emitted, reflected or scattered, but the direct light of lights that the game adds itself. Where lamps or suns are baked, there is a second
//! texture of the same layout, `light-grid.indirect.ktx2`: the same light without what lamps and suns of the scene bring straight away, but with what emissive surfaces do. A game that
//! adds lamps to its fog along each ray, with shadow maps, takes it in place of the first; a lattice is too coarse for the edges of beams. Both are of the same rays, so that their difference
//! is the lamps' light. Without such lights both would be alike, and there is one. What a view ray with the direction d (away from the eye)
//! gains per metre is sigma_s times the sum of coefficients, those of band l times g^l, times the harmonics of d; where g is above 0 see
//! [`crate::media::Media::smoothed`] for why lights are a little stronger behind media. In WGSL:
//!
//! ```wgsl
//! // `p` in metres, `first`, `cell`, `size` and `slices` from the manifest; `depth` is 7 * slices.
//! fn light(k: u32, p: vec3f) -> vec4f {
//!     let node = clamp((p - first) / cell, vec3f(0), vec3f(size - 1));
//!     let texel = vec3f(node.xy + 0.5, node.z + 1.5 + f32(k * slices));
//!     return textureSampleLevel(grid, linear, texel / vec3f(vec2f(size.xy), depth), 0.0);
//! }
//! fn scattered(p: vec3f, d: vec3f, g: f32) -> vec3f {
//!     let l0 = light(0u, p); let l1 = light(1u, p); let l2 = light(2u, p); let l3 = light(3u, p);
//!     let l4 = light(4u, p); let l5 = light(5u, p); let l6 = light(6u, p);
//!     let band1 = 0.488603 * (l1.rgb * d.y + l2.rgb * d.z + l3.rgb * d.x);
//!     let band2 = 1.092548 * (l4.rgb * d.x * d.y + l5.rgb * d.y * d.z + vec3f(l0.a, l1.a, l2.a) * d.x * d.z)
//!         + 0.315392 * l6.rgb * (3.0 * d.z * d.z - 1.0)
//!         + 0.546274 * vec3f(l3.a, l4.a, l5.a) * (d.x * d.x - d.y * d.y);
//!     return max(vec3f(0), 0.282095 * l0.rgb + g * band1 + g * g * band2) / max(l6.a, 0.001);
//! }
//! ```

use crate::error::{Error, Result};
use crate::output::folder::Staging;
use crate::output::ktx::{self, Half, Packing, Texels};
use crate::scene::model::Rgb;
use crate::solve::light_grid::{AllLight, Nodes};
use crate::transport::light_grid::{COEFFICIENTS, LightGrid};
use glam::{UVec3, Vec3};
use half::f16;
use tables::format::manifest;

/// Name of the file.
pub const FILE: &str = "light-grid.ktx2";

/// Name of the file without the straight light of lamps and suns.
pub const INDIRECT_FILE: &str = "light-grid.indirect.ktx2";

/// Blocks of slices.
const BLOCKS: u32 = 7;

/// Writes the textures of a grid whose nodes hold `light`, which is given back as soon as it is in a file; what the manifest says of them.
///
/// # Errors
/// [`crate::error::Error::Io`] if it cannot be written.
pub fn write(
    staging: &Staging,
    grid: &LightGrid,
    world_origin: Vec3,
    AllLight { all, indirect }: AllLight,
) -> Result<manifest::LightGrid> {
    let size = grid.size();
    let inside = all.iter().filter(|l| l.is_none()).count() as u64;
    let mut clamped = write_nodes(staging, FILE, size, all)?;
    let second = indirect.is_some();
    if let Some(indirect) = indirect {
        clamped += write_nodes(staging, INDIRECT_FILE, size, indirect)?;
    }
    Ok(manifest::LightGrid {
        file: FILE.to_owned(),
        indirect: second.then(|| INDIRECT_FILE.to_owned()),
        size: size.to_array(),
        slices: size.z + 2,
        first: (world_origin + Vec3::from(grid.node(0))).to_array(),
        cell: Vec3::from(grid.cell()).to_array(),
        inside,
        clamped,
    })
}

/// Writes one texture; how many values were too great for it.
fn write_nodes(staging: &Staging, name: &str, size: UVec3, light: Nodes) -> Result<u64> {
    let (texels, clamped) = texels(size, &light);
    drop(light);
    let depth = (size.z + 2) * BLOCKS;
    let texels = Texels::Rgba16f(&texels);
    let file = ktx::volume([size.x, size.y, depth], texels, Packing::Stored, ktx::VOLUME_TEXTS)
        .map_err(Error::io(staging.path(name), "cannot write"))?;
    staging.write(name, file)?;
    Ok(clamped)
}

/// Half floats, and how many were too great for them.
fn texels(size: UVec3, light: &[Option<[Rgb; COEFFICIENTS]>]) -> (Vec<[f16; 4]>, u64) {
    let area = (size.x * size.y) as usize;
    let mut half = Half::default();
    let mut out = Vec::with_capacity(area * (size.z as usize + 2) * BLOCKS as usize);
    for k in 0..BLOCKS as usize {
        for slice in 0..size.z as usize + 2 {
            let z = slice.saturating_sub(1).min(size.z as usize - 1);
            for node in &light[z * area..(z + 1) * area] {
                let Some(l) = node else {
                    out.push([f16::ZERO; 4]);
                    continue;
                };
                let fourth = if k < 6 { l[7 + k / 3][k % 3] } else { 1.0 };
                out.push([l[k].x, l[k].y, l[k].z, fourth].map(|v| half.of(v)));
            }
        }
    }
    (out, half.clamped)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every coefficient of every node is where the module says.
    #[test]
    fn coefficients_are_where_they_should_be() {
        let size = UVec3::new(2, 3, 4);
        let value = |node: usize, k: usize, c: usize| (node * 27 + k * 3 + c) as f32;
        let light: Vec<_> = (0..24)
            .map(|n| {
                let of = |k: usize| Vec3::new(value(n, k, 0), value(n, k, 1), value(n, k, 2));
                (n != 5).then(|| std::array::from_fn(of))
            })
            .collect();
        let (texels, clamped) = texels(size, &light);
        assert_eq!((texels.len(), clamped), (2 * 3 * 6 * 7, 0));
        for n in 0..24usize {
            let at = |k: usize| texels[k * 36 + n + 6].map(f16::to_f32);
            for k in 0..7 {
                let want: [f32; 4] = std::array::from_fn(|c| match (n, c, k) {
                    (5, ..) => 0.0,
                    (_, 3, 6) => 1.0,
                    (_, 3, _) => value(n, 7 + k / 3, k % 3),
                    _ => value(n, k, c),
                });
                assert_eq!(at(k), want, "node {n} block {k}");
            }
        }
        for k in 0..7 {
            let block = &texels[k * 36..(k + 1) * 36];
            assert_eq!((&block[..6], &block[30..]), (&block[6..12], &block[24..30]), "ends are doubled");
        }
        let bright = [Some([Vec3::splat(1e6); COEFFICIENTS])];
        let (texels, clamped) = super::texels(UVec3::ONE, &bright);
        assert_eq!((clamped, texels[0][0]), (3 * 27, f16::MAX));
    }
}
