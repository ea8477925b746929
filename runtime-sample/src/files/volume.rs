//! Light in the air, and media: what fog to the eye is made of.

use std::path::Path;

use anyhow::{Result, ensure};
use glam::{Affine3A, Vec3};
use half::f16;
use ktx2::Format;
use tables::{
    format::manifest,
    probes::{Light, ProbeVolume},
};

use super::ktx;

/// Blocks of slices of a [`Grid`].
pub(crate) const BLOCKS: u32 = 7;

/// Light at the nodes of a lattice: radiance from all directions in nits, spherical harmonics of bands 0 to 2 as `light-grid.ktx2` has them.
#[derive(Debug)]
pub(crate) struct Grid {
    /// Nodes along x, y and z.
    pub(crate) size: [u32; 3],
    /// Slices of one of seven blocks along z; the first and the last are there twice.
    pub(crate) slices: u32,
    /// The first node, metres in the scene's axes.
    pub(crate) first: Vec3,
    /// Distances of nodes, metres.
    pub(crate) cell: Vec3,
    /// Four half floats a texel.
    pub(crate) bytes: Vec<u8>,
    /// Whether what lamps send straight is left out, so that it is to be added.
    pub(crate) without_lamps: bool,
}

impl Grid {
    /// Reads what the manifest says of the light grid. `apart` asks for the light without that of lamps, where a bake has it.
    ///
    /// # Errors
    ///
    /// Where the file is missing, damaged, or not of the size that the manifest states.
    pub(crate) fn open(dir: &Path, m: &manifest::LightGrid, apart: bool) -> Result<Self> {
        let indirect = m.indirect.as_ref().filter(|_| apart);
        let path = dir.join(indirect.unwrap_or(&m.file));
        let image = ktx::read(&path)?;
        let wanted = [m.size[0], m.size[1], m.slices.saturating_mul(BLOCKS)];
        ensure!(
            image.format == Format::R16G16B16A16_SFLOAT
                && image.size == wanted
                && m.size[2].checked_add(2) == Some(m.slices),
            "{}: not of the size that the manifest states; bake again",
            path.display()
        );
        Ok(Self {
            size: m.size,
            slices: m.slices,
            first: m.first.into(),
            cell: m.cell.into(),
            bytes: image.bytes,
            without_lamps: indirect.is_some(),
        })
    }

    /// The light of probes at the nodes of an even lattice over them, for bakes without a light grid.
    pub(crate) fn from_probes(probes: &ProbeVolume) -> Option<Self> {
        let l = &probes.lattice;
        if l.size.contains(&0) {
            return None;
        }
        let cells = l.size.map(|n| n.saturating_mul(4));
        let most = cells.into_iter().max()?;
        let nodes = most.min(MOST_NODES) as f32;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most MOST_NODES")]
        let size = cells.map(|n| ((n as f32 / most as f32 * nodes).round() as u32).max(1) + 1);
        let extent = Vec3::from(cells.map(|n| n as f32 * l.spacing));
        let cell = extent / Vec3::from(size.map(|n| (n - 1) as f32));
        let first = Vec3::from(l.origin);
        let slices = size[2] + 2;
        let mut nodes: Vec<Option<Light>> = Vec::new();
        for z in 0..size[2] {
            for y in 0..size[1] {
                for x in 0..size[0] {
                    let p = first + cell * Vec3::new(x as f32, y as f32, z as f32);
                    nodes.push(probes.light(p.to_array()));
                }
            }
        }
        let area = (size[0] * size[1]) as usize;
        let mut bytes = Vec::new();
        for k in 0..BLOCKS as usize {
            for slice in 0..slices as usize {
                let z = slice.saturating_sub(1).min(size[2] as usize - 1);
                for light in &nodes[z * area..(z + 1) * area] {
                    let texel = light.map_or([0.0; 4], |l| {
                        let c = l.expand();
                        let fourth = if k < 6 { c[7 + k / 3][k % 3] } else { 1.0 };
                        [c[k][0], c[k][1], c[k][2], fourth]
                    });
                    bytes.extend(texel.into_iter().flat_map(|v| half(v).to_le_bytes()));
                }
            }
        }
        Some(Self { size, slices, first, cell, bytes, without_lamps: false })
    }
}

/// Nodes less one along the longest side of a lattice that is made from probes.
const MOST_NODES: u32 = 32;

/// Not beyond what half floats hold.
fn half(v: f32) -> f16 {
    let most = f16::MAX.to_f32();
    f16::from_f32(v.clamp(-most, most))
}

/// A medium.
#[derive(Clone, Debug)]
pub(crate) struct Medium {
    /// Scattering per metre where the density is 1.
    pub(crate) sigma_s: Vec3,
    /// Absorption per metre where the density is 1.
    pub(crate) sigma_a: Vec3,
    /// Mean cosine, Henyey-Greenstein.
    pub(crate) g: f32,
    /// The scene's axes to the cube [0, 1]^3 that it is in; everywhere without.
    pub(crate) cube: Option<Affine3A>,
    /// Where the density is 1, metres, and over which it falls by e.
    pub(crate) height: Option<[f32; 2]>,
    /// A texture of density.
    pub(crate) density: Option<Density>,
}

/// Where a density is in [`Media::atlas`].
#[derive(Clone, Debug)]
pub(crate) struct Density {
    /// The scene's axes to [0, 1]^3 of the texture; 0 outside.
    pub(crate) cube: Affine3A,
    /// Texels along x, y and z.
    pub(crate) size: [u32; 3],
    /// Its first slice in the atlas, behind a repeated one.
    pub(crate) slice: u32,
}

/// All media of a bake.
#[derive(Debug, Default)]
pub(crate) struct Media {
    /// One by one.
    pub(crate) all: Vec<Medium>,
    /// Densities one behind the other along z, their first and last slice twice, as single half floats; their size.
    pub(crate) atlas: (Vec<u8>, [u32; 3]),
}

impl Media {
    /// Reads the media of a manifest.
    ///
    /// # Errors
    ///
    /// Where a density is missing, damaged, or not of the size that the manifest states.
    pub(crate) fn open(dir: &Path, media: &[manifest::Medium]) -> Result<Self> {
        let mut images = Vec::new();
        for t in media.iter().filter_map(|m| m.texture.as_ref()) {
            let path = dir.join(&t.file);
            let image = ktx::read(&path)?;
            ensure!(
                image.format == Format::R16_SFLOAT && image.size == t.size,
                "{}: not of the size that the manifest states; bake again",
                path.display()
            );
            images.push(image);
        }
        let along = |a: usize| images.iter().map(|i| i.size[a]).max().unwrap_or(1);
        let (width, height) = (along(0), along(1));
        let mut bytes = Vec::new();
        let mut slice = 0;
        let mut starts = Vec::new();
        for image in &images {
            let [w, h, d] = image.size;
            starts.push(slice + 1);
            for z in std::iter::once(0).chain(0..d).chain(std::iter::once(d - 1)) {
                for y in 0..height {
                    let row = ((z * h + y.min(h - 1)) * w * 2) as usize;
                    let row = &image.bytes[row..row + 2 * w as usize];
                    bytes.extend_from_slice(row);
                    (w..width).for_each(|_| bytes.extend_from_slice(&row[row.len() - 2..]));
                }
            }
            slice += d + 2;
        }
        if images.is_empty() {
            (bytes, slice) = (vec![0; 2], 1);
        }
        let mut starts = starts.into_iter();
        let all = media
            .iter()
            .map(|m| Medium {
                sigma_s: m.sigma_s.into(),
                sigma_a: m.sigma_a.into(),
                g: m.g,
                cube: m.unit_from_world.map(affine),
                height: m.height.map(|h| [h.base, h.falloff]),
                density: m.texture.as_ref().map(|t| Density {
                    cube: affine(t.unit_from_world),
                    size: t.size,
                    slice: starts.next().unwrap_or(0),
                }),
            })
            .collect();
        Ok(Self { all, atlas: (bytes, [width, height, slice]) })
    }
}

fn affine(columns: [[f32; 3]; 4]) -> Affine3A {
    Affine3A::from_cols_array_2d(&columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tables::probes::{Basis, Lattice, Probe};

    /// One brick of even light: every node holds it, in the layout of `light-grid.ktx2`.
    #[test]
    fn probes_become_a_lattice() {
        let light = Light::new(Basis::L1, &[[1.0, 2.0, 3.0], [4.0, 0.0, 0.0]]);
        let probe = Probe { position: [0.0; 3], light, std_err: 0.0, validity: 1.0, window: 0.0 };
        let brick =
            tables::probes::Brick { corner: [0; 3], level: 0, probes: [0; 125], cells: [u32::MAX; 64] };
        let probes = ProbeVolume {
            basis: Basis::L1,
            lattice: Lattice { origin: [1.0, 2.0, 3.0], spacing: 0.5, size: [1; 3], levels: 1 },
            index: vec![0],
            bricks: vec![brick],
            occlusions: Vec::new(),
            probes: vec![probe],
        };
        let grid = Grid::from_probes(&probes).expect("there are probes");
        assert_eq!((grid.size, grid.slices, grid.cell), ([5; 3], 7, Vec3::splat(0.5)));
        let texel = |i: usize| -> [f32; 4] {
            std::array::from_fn(|c| {
                f16::from_le_bytes([grid.bytes[8 * i + 2 * c], grid.bytes[8 * i + 2 * c + 1]]).to_f32()
            })
        };
        let block = 25 * 7;
        assert_eq!(grid.bytes.len(), 8 * 7 * block);
        for i in [0, 30, block - 1] {
            assert_eq!(
                [texel(i), texel(block + i), texel(6 * block + i)],
                [[1.0, 2.0, 3.0, 0.0], [4.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
            );
        }
        assert!(Grid::from_probes(&ProbeVolume::default()).is_none());
    }
}
