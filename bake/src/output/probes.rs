//! Files of light probes: bricks as they are, and an even grid as engines take it.
//!
//! `probes.bin` (`probes-1.bin` and so on for more boxes) is a [`ProbeVolume`], see [`tables::probes`]. Beside it are two three-dimensional textures of half floats that hold its light at the
//! centres of even voxels, for engines without bricks; what they interpolate leaks through thin walls, as their look-up knows none:
//!
//! - `probes.vxgi.ktx2`: Bevy's irradiance volume, of R x 2R x 3R texels. Voxel (x, y, z) has `E / pi` in nits for the normals +x, +y, +z at
//!   texel (x, y, z + axis * Rz) and for -x, -y, -z at (x, y + Ry, z + axis * Rz): the halves as Bevy's shader reads them (`irradiance_volume.wesl`,
//!   0.17 to main of August 2026), which are not those of its documentation. Alpha is 1. Bevy weighs the three by the squares of the normal's parts, multiplies by
//!   `intensity` and by the base colour, and knows no factor 1 / pi. The entity's transform is
//!   a translation to `centre` and a scale by `extent` of the manifest; it must not be rotated.
//! - `probes.three.ktx2`: the atlas of three.js' `LightProbeGrid`, radiance by nine coefficients in seven blocks of slices along z, the first and the
//!   last slice of each block twice. Coefficients follow one another through the channels: block 0 has coefficient 0 and red of coefficient 1, block 1 its green and blue
//!   and red and green of coefficient 2, and so on; the last channel is 0.

use crate::error::{Error, Result};
use crate::output::folder::Staging;
use crate::output::ktx::{self, Half, LEVEL, Packing, Texels};
use crate::plan::memory::MOST_VOXELS;
use crate::solve::probes::Figures;
use glam::{UVec3, Vec3};
use half::f16;
use tables::format::manifest::{self, ErrorFigure, PROBE_CONVENTION};
use tables::probes::{CELLS, Light, ProbeVolume};

/// Texels of a three-dimensional texture along one axis, at most: what graphics cards take everywhere.
const MOST_TEXELS: u32 = 2048;

/// Coefficients that the even grid has.
const COEFFICIENTS: usize = 9;

/// Blocks of slices that they take.
const BLOCKS: u32 = 7;

/// Writes the files of volume `number` and says what the manifest says of it.
///
/// # Errors
///
/// [`crate::error::Error::Io`] if they cannot be written.
pub fn write(
    staging: &Staging,
    number: usize,
    volume: &ProbeVolume,
    figures: &Figures,
    samples: u32,
) -> Result<manifest::Probes> {
    let stem = if number == 0 { "probes".to_owned() } else { format!("probes-{number}") };
    let file = format!("{stem}.bin");
    staging.write(&file, volume.to_bytes())?;
    let relative = (0.0 < figures.mean_luminance).then(|| figures.rms_std_err / figures.mean_luminance);
    let l = &volume.lattice;
    Ok(manifest::Probes {
        file,
        basis: volume.basis.name().to_owned(),
        coefficients: volume.basis.coefficients(),
        convention: PROBE_CONVENTION.to_owned(),
        origin: l.origin,
        spacing: l.spacing,
        size: l.size,
        levels: l.levels,
        bricks: volume.bricks.len(),
        probes: volume.probes.len(),
        invalid: figures.invalid,
        moved: figures.moved,
        own: figures.own,
        windowed: figures.windowed,
        samples,
        rejected_samples: figures.gate.rejected,
        mean_luminance: figures.mean_luminance,
        error: ErrorFigure { rms_std_err: figures.rms_std_err, relative, max_std_err: figures.max_std_err },
        grid: grid(staging, &stem, volume)?,
    })
}

/// Writes the even grid.
fn grid(staging: &Staging, stem: &str, volume: &ProbeVolume) -> Result<manifest::ProbeGrid> {
    let voxels = Voxels::new(volume);
    let size = voxels.size;
    let mut half = Half::default();
    // Right, up and out of the screen is how glTF's axes point.
    let texts = [("KTXorientation", "ruo"), ("KTXwriter", concat!("bake ", env!("CARGO_PKG_VERSION")))];
    let put = |file: &str, size: [u32; 3], texels: &[[f16; 4]]| {
        let bytes = ktx::volume(size, Texels::Rgba16f(texels), Packing::Zstd(LEVEL), &texts);
        staging.write(file, bytes.map_err(Error::io(file, "cannot pack"))?)
    };
    let irradiance_volume = format!("{stem}.vxgi.ktx2");
    put(&irradiance_volume, [size.x, 2 * size.y, 3 * size.z], &voxels.ambient_cubes(&mut half))?;
    let harmonics = format!("{stem}.three.ktx2");
    let depth = (size.z + 2) * BLOCKS;
    put(&harmonics, [size.x, size.y, depth], &voxels.atlas(&mut half))?;
    Ok(manifest::ProbeGrid {
        irradiance_volume,
        harmonics,
        size: size.to_array(),
        centre: (voxels.first + 0.5 * voxels.extent()).to_array(),
        extent: voxels.extent().to_array(),
        clamped: half.clamped,
    })
}

/// Light at the centres of even voxels.
struct Voxels {
    /// Corner of the first voxel, metres in the scene's axes.
    first: Vec3,
    /// Side of a voxel, metres.
    side: f32,
    size: UVec3,
    light: Vec<Light>,
}

impl Voxels {
    /// Over the whole lattice, as fine as its smallest cells if there are not too many.
    fn new(volume: &ProbeVolume) -> Self {
        let l = &volume.lattice;
        #[expect(clippy::cast_possible_truncation, reason = "four")]
        let cells = UVec3::from(l.size) * CELLS as u32;
        let mut step = 1;
        let along = |step: u32| cells.map(|n| n.div_ceil(step));
        let too_many = |n: UVec3| {
            let textures = [n.x, 2 * n.y, 3 * n.z, (n.z + 2) * BLOCKS];
            MOST_VOXELS < n.as_u64vec3().element_product() || textures.iter().any(|n| MOST_TEXELS < *n)
        };
        while too_many(along(step)) {
            step += 1;
        }
        let (size, side) = (along(step), l.spacing * step as f32);
        let first = Vec3::from(l.origin);
        let mut light: Vec<Option<Light>> = Vec::new();
        for z in 0..size.z {
            for y in 0..size.y {
                for x in 0..size.x {
                    let centre = first + (UVec3::new(x, y, z).as_vec3() + 0.5) * side;
                    light.push(volume.light(centre.to_array()));
                }
            }
        }
        let black = Light::black(volume.basis);
        let light = light.into_iter().map(|l| l.unwrap_or(black)).collect();
        Self { first, side, size, light }
    }

    fn extent(&self) -> Vec3 {
        self.size.as_vec3() * self.side
    }

    fn at(&self, x: u32, y: u32, z: u32) -> &Light {
        &self.light[((z * self.size.y + y) * self.size.x + x) as usize]
    }

    /// Bevy's order of texels.
    fn ambient_cubes(&self, half: &mut Half) -> Vec<[f16; 4]> {
        let s = self.size;
        let mut out = Vec::with_capacity(6 * self.light.len());
        for axis in 0..3 {
            for z in 0..s.z {
                for sign in [1.0, -1.0] {
                    let mut n = [0.0; 3];
                    n[axis] = sign;
                    for y in 0..s.y {
                        for x in 0..s.x {
                            let [r, g, b] = self.at(x, y, z).irradiance(n).map(|e| half.of(e.max(0.0)));
                            out.push([r, g, b, f16::ONE]);
                        }
                    }
                }
            }
        }
        out
    }

    /// The order of texels of three.js.
    fn atlas(&self, half: &mut Half) -> Vec<[f16; 4]> {
        let s = self.size;
        let mut out = Vec::new();
        for block in 0..BLOCKS as usize {
            for slice in 0..s.z + 2 {
                let z = slice.saturating_sub(1).min(s.z - 1);
                for y in 0..s.y {
                    for x in 0..s.x {
                        let full = self.at(x, y, z).expand();
                        let flat = full[..COEFFICIENTS].as_flattened();
                        let channel = |c: usize| flat.get(4 * block + c).copied().unwrap_or(0.0);
                        out.push([0, 1, 2, 3].map(|c| half.of(channel(c))));
                    }
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tables::harmonics::real;
    use tables::probes::Basis;

    /// Light that differs from voxel to voxel, on a lattice whose sides differ.
    fn voxels() -> Voxels {
        let size = UVec3::new(2, 3, 4);
        let light = (0..24)
            .map(|i| {
                let mut c = [[0.0; 3]; COEFFICIENTS];
                for (k, c) in c.iter_mut().enumerate() {
                    *c = [k as f32 * 0.1 - 0.3, i as f32 * 0.05, 0.2 * ((i + 3 * k) % 5) as f32];
                }
                c[0] = [20.0 + i as f32, 15.0, 30.0];
                Light::new(Basis::L2, &c)
            })
            .collect();
        Voxels { first: Vec3::new(1.0, 2.0, 3.0), side: 0.5, size, light }
    }

    /// What Bevy's shader samples: the texel of a voxel for the axes of a normal, written down from the shader: `stp` is the voxel, the slab of the
    /// axis lies a third of the texture further along z each, and where a part of the normal is negative half the texture further along y.
    #[test]
    fn bevy_finds_every_face() {
        let v = voxels();
        let texels = v.ambient_cubes(&mut Half::default());
        let [rx, ry, rz] = v.size.to_array();
        let atlas = [rx, 2 * ry, 3 * rz];
        let fetch = |stp: [u32; 3]| texels[((stp[2] * atlas[1] + stp[1]) * atlas[0] + stp[0]) as usize];
        for n in [[0.6f32, 0.64, 0.48], [-0.6, 0.48, -0.64], [0.0, -1.0, 0.0], [-0.36, -0.48, 0.8]] {
            for (x, y, z) in [(0, 0, 0), (1, 2, 3), (0, 1, 2), (1, 0, 3)] {
                let mut shown = [0.0f32; 3];
                let mut want = [0.0f32; 3];
                for axis in 0..3u32 {
                    let part = n[axis as usize];
                    let neg_offset = if part < 0.0 { atlas[1] / 2 } else { 0 };
                    let texel = fetch([x, y + neg_offset, z + axis * (atlas[2] / 3)]);
                    let mut face = [0.0; 3];
                    face[axis as usize] = part.signum();
                    let e = v.at(x, y, z).irradiance(face);
                    for c in 0..3 {
                        shown[c] += part * part * texel[c].to_f32();
                        want[c] += part * part * e[c];
                    }
                }
                for (s, w) in shown.iter().zip(want) {
                    assert!((s - w).abs() < 2e-3 * w.abs(), "{n:?} {x} {y} {z}: {s} {w}");
                }
            }
        }
    }

    /// What three.js' shader chunk `lightprobes_pars_fragment` samples at the centre of a probe, constants included.
    #[test]
    fn three_js_finds_every_coefficient() {
        let v = voxels();
        let texels = v.atlas(&mut Half::default());
        let [nx, ny, nz] = v.size.to_array();
        assert_eq!(texels.len() as u64, u64::from(nx * ny * 7 * (nz + 2)));
        let padded = nz + 2;
        let sampled = |block: u32, x: u32, y: u32, z: u32| {
            let slice = z + 1 + block * padded;
            texels[((slice * ny + y) * nx + x) as usize].map(f16::to_f32)
        };
        for (x, y, z) in [(0, 0, 0), (1, 2, 3), (0, 1, 2)] {
            let flat: Vec<f32> = (0..7).flat_map(|b| sampled(b, x, y, z)).collect();
            let c = |k: usize, channel: usize| flat[3 * k + channel];
            let n = [0.36f32, -0.48, 0.8];
            let want = v.at(x, y, z).irradiance(n);
            for (channel, want) in want.into_iter().enumerate() {
                let of = |k: usize| c(k, channel);
                let e = of(0) * 0.886_227
                    + 2.0 * 0.511_664 * (of(1) * n[1] + of(2) * n[2] + of(3) * n[0])
                    + 2.0 * 0.429_043 * (of(4) * n[0] * n[1] + of(5) * n[1] * n[2] + of(7) * n[0] * n[2])
                    + of(6) * (0.743_125 * n[2] * n[2] - 0.247_708)
                    + of(8) * 0.429_043 * (n[0] * n[0] - n[1] * n[1]);
                let want = want * std::f32::consts::PI;
                assert!((e - want).abs() < 2e-3 * want.abs(), "{x} {y} {z}: {e} {want}");
            }
        }
        // Slices at the ends of blocks are there twice.
        assert_eq!(texels[..(nx * ny) as usize], texels[(nx * ny) as usize..(2 * nx * ny) as usize]);
    }

    #[test]
    fn what_is_too_bright_is_clamped_and_counted() {
        let mut v = voxels();
        let y: [f32; COEFFICIENTS] = real::first([0.0, 1.0, 0.0]);
        v.light[5] = Light::new(Basis::L2, &y.map(|y| [y * 1e6; 3]));
        let mut half = Half::default();
        let texels = v.ambient_cubes(&mut half);
        assert!(0 < half.clamped && texels.iter().flatten().all(|h| h.is_finite()));
    }
}
