//! Light in the air, and media: what fog to the eye is made of.

use std::path::Path;

use anyhow::{Context, Result, ensure};
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
    /// The first of them in the atlas.
    pub(crate) first: [u32; 3],
}

/// How many boxes lie side by side along each axis so that `n` fit; as near to a cube as there is room.
fn boxes(n: usize, cell: [u32; 3], most: u32) -> Option<[u32; 3]> {
    let n = u32::try_from(n).ok()?.max(1);
    let room = cell.map(|c| most / c.max(1));
    let side = (1..=n).find(|s| n <= s.saturating_pow(3)).unwrap_or(n);
    let x = side.min(room[0]);
    let y = side.min(room[1]);
    let z = n.div_ceil((x * y).max(1));
    (0 < x * y && z <= room[2]).then_some([x, y, z])
}

/// All media of a bake.
#[derive(Debug, Default)]
pub(crate) struct Media {
    /// One by one.
    pub(crate) all: Vec<Medium>,
    /// Densities side by side in boxes of one size, as single half floats, and the size of all. What is looked up lies between the middles of texels at
    /// the faces of a box, so that neighbours never mix.
    pub(crate) atlas: (Vec<u8>, [u32; 3]),
}

impl Media {
    /// Reads the media of a manifest, for an adapter that takes `most` texels along each axis.
    ///
    /// # Errors
    ///
    /// Where a density is missing, damaged, or not of the size that the manifest states.
    pub(crate) fn open(dir: &Path, media: &[manifest::Medium], most: u32) -> Result<Self> {
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
        let cell = [0, 1, 2].map(|a| images.iter().map(|i| i.size[a]).max().unwrap_or(1));
        let boxes = boxes(images.len(), cell, most);
        let boxes = boxes.with_context(|| {
            format!("the densities of {} media are more than this adapter takes", images.len())
        })?;
        let size = [0, 1, 2].map(|a| boxes[a] * cell[a]);
        let mut bytes = vec![0; 2 * size.iter().map(|n| *n as usize).product::<usize>()];
        let mut starts = Vec::new();
        for (i, image) in (0u32..).zip(&images) {
            let first = [i % boxes[0], i / boxes[0] % boxes[1], i / boxes[0] / boxes[1]];
            let first: [u32; 3] = std::array::from_fn(|a| first[a] * cell[a]);
            let [w, h, d] = image.size;
            let line = 2 * w as usize;
            for (row, (z, y)) in (0..d).flat_map(|z| (0..h).map(move |y| (z, y))).enumerate() {
                let at =
                    ((first[2] + z) * size[1] + first[1] + y) as usize * size[0] as usize + first[0] as usize;
                bytes[2 * at..2 * at + line].copy_from_slice(&image.bytes[row * line..(row + 1) * line]);
            }
            starts.push(first);
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
                    first: starts.next().unwrap_or_default(),
                }),
            })
            .collect();
        Ok(Self { all, atlas: (bytes, size) })
    }
}

fn affine(columns: [[f32; 3]; 4]) -> Affine3A {
    Affine3A::from_cols_array_2d(&columns)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tables::probes::{Basis, Lattice, Probe};

    #[test]
    fn densities_find_room() {
        assert_eq!(boxes(0, [1; 3], 2048), Some([1; 3]));
        assert_eq!(boxes(3, [128; 3], 2048), Some([2, 2, 1]));
        assert_eq!(boxes(64, [128; 3], 2048), Some([4; 3]));
        assert_eq!(boxes(64, [128, 128, 2], 256), Some([2, 2, 16]));
        assert_eq!(boxes(9, [128; 3], 256), None);
        assert_eq!(boxes(1, [300, 1, 1], 256), None);
    }

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
