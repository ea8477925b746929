//! Reads bare densities, little-endian, x fastest, then y, then z.

use super::{Unusable, Voxels, linear};
use glam::UVec3;
use half::f16;

/// How a density is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A byte, of which 255 is the density 1.
    U8,
    /// Two bytes, of which 65535 is the density 1.
    U16,
    /// A half float.
    F16,
    /// A float.
    F32,
}

impl Format {
    /// Bytes of a density.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::F16 => 2,
            Self::F32 => 4,
        }
    }

    /// The density that begins there; all its bytes have to be there.
    pub(super) fn at(self, bytes: &[u8]) -> f32 {
        match (self, bytes) {
            (Self::U8, &[a, ..]) => f32::from(a) / 255.0,
            (Self::U16, &[a, b, ..]) => f32::from(u16::from_le_bytes([a, b])) / 65535.0,
            (Self::F16, &[a, b, ..]) => f16::from_le_bytes([a, b]).to_f32(),
            (Self::F32, &[a, b, c, d, ..]) => f32::from_le_bytes([a, b, c, d]),
            _ => f32::NAN,
        }
    }

    const fn name(self) -> &'static str {
        match self {
            Self::U8 => "u8",
            Self::U16 => "u16",
            Self::F16 => "f16",
            Self::F32 => "f32",
        }
    }
}

/// Reads a grid of `size` voxels that is all there is in a file.
///
/// # Errors
/// Where the file has another length, and as [`Voxels::from_fn`].
pub fn read(file: &[u8], size: UVec3, format: Format, most_bytes: usize) -> Result<Voxels, Unusable> {
    super::check_size(size)?;
    let expected = size.as_u64vec3().element_product() * format.bytes() as u64;
    if expected != file.len() as u64 {
        return Err(Unusable::new(
            format!(
                "the file has {} bytes, and {} x {} x {} voxels of {} take {expected}",
                file.len(),
                size.x,
                size.y,
                size.z,
                format.name()
            ),
            "correct the size or the type",
        ));
    }
    Voxels::from_fn(size, most_bytes, |v| format.at(&file[linear(v, size) * format.bytes()..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Vec3A, uvec3};

    #[test]
    fn densities_are_what_bytes_say() {
        let size = uvec3(3, 2, 1);
        let halves = [0.0, 0.5, 1.0, 2.0, 6e-8, 65504.0].map(f16::from_f32);
        let cases: [(Format, Vec<u8>, [f32; 6]); 4] = [
            (Format::U8, vec![0, 1, 2, 128, 254, 255], [0, 1, 2, 128, 254, 255].map(|v| v as f32 / 255.0)),
            (
                Format::U16,
                [0u16, 1, 256, 32768, 65534, 65535].map(u16::to_le_bytes).concat(),
                [0.0f32, 1.0, 256.0, 32768.0, 65534.0, 65535.0].map(|v| v / 65535.0),
            ),
            (Format::F16, halves.map(f16::to_le_bytes).concat(), halves.map(f16::to_f32)),
            (
                Format::F32,
                [0.0f32, 1e-45, 0.1, 1.0, 3.0, f32::MAX].map(f32::to_le_bytes).concat(),
                [0.0, 1e-45, 0.1, 1.0, 3.0, f32::MAX],
            ),
        ];
        for (format, bytes, want) in cases {
            let grid = read(&bytes, size, format, usize::MAX).expect("a grid");
            let got: Vec<f32> = (0..6).map(|i| grid.of(uvec3(i % 3, i / 3, 0))).collect();
            assert_eq!(got, want, "{format:?}");
            assert_eq!(grid.at(Vec3A::new(2.5, 1.5, 0.5)), want[5]);
            assert!(grid.place().is_none());
            let error = read(&bytes[1..], size, format, usize::MAX).expect_err("too short").what;
            assert!(error.contains(&format!("has {} bytes", bytes.len() - 1)), "{error}");
            assert!(error.contains(&format!("of {} take {}", format.name(), bytes.len())), "{error}");
        }
    }
}
