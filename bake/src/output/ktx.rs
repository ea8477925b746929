//! KTX2 files: containers of textures as graphics cards take them.
//!
//! Header and descriptors come from the crate `ktx2`, from the format's specification 2.0 (Khronos Group).

use half::f16;
use ktx2::dfd::{Basic, Block};
use ktx2::{Format, Header, Index, LevelIndex};

/// Texels start at a multiple of this; the least common multiple of 4 and the size of a texel.
const ALIGNMENT: usize = 8;

/// Makes half floats and counts those that were too great.
#[derive(Default)]
pub(super) struct Half {
    /// Values beyond 65504, which were clamped to it.
    pub(super) clamped: u64,
}

impl Half {
    /// The nearest half float; not infinite.
    pub(super) fn of(&mut self, v: f32) -> f16 {
        self.clamped += u64::from(f16::MAX.to_f32() < v.abs());
        f16::from_f32(v.clamp(f16::MIN.to_f32(), f16::MAX.to_f32()))
    }
}

/// A three-dimensional texture of half floats, x fastest, with metadata as keys and texts, which the format wants in the order of keys.
///
/// # Panics
///
/// If there are not as many texels as `size` says.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "headers are short")]
pub(super) fn volume(size: [u32; 3], texels: &[[f16; 4]], texts: &[(&str, &str)]) -> Vec<u8> {
    assert_eq!(texels.len() as u64, size.iter().map(|n| u64::from(*n)).product::<u64>());
    let format = Format::R16G16B16A16_SFLOAT;
    let (basic, type_size) = Basic::from_format(format).expect("a format that is known");
    let block = Block::Basic(basic).to_vec();
    let descriptor = [&(block.len() as u32 + 4).to_le_bytes()[..], &block].concat();
    let mut pairs = Vec::new();
    for (key, text) in texts {
        let pair = [key.as_bytes(), &[0], text.as_bytes(), &[0]].concat();
        pairs.extend((pair.len() as u32).to_le_bytes());
        pairs.extend(pair);
        pairs.resize(pairs.len().next_multiple_of(4), 0);
    }
    let at = Header::LENGTH + LevelIndex::LENGTH;
    let after = at + descriptor.len() + pairs.len();
    let begin = after.next_multiple_of(ALIGNMENT);
    let header = Header {
        format: Some(format),
        type_size,
        pixel_width: size[0],
        pixel_height: size[1],
        pixel_depth: size[2],
        layer_count: 0,
        face_count: 1,
        level_count: 1,
        supercompression_scheme: None,
        index: Index {
            dfd_byte_offset: at as u32,
            dfd_byte_length: descriptor.len() as u32,
            kvd_byte_offset: if pairs.is_empty() { 0 } else { (at + descriptor.len()) as u32 },
            kvd_byte_length: pairs.len() as u32,
            sgd_byte_offset: 0,
            sgd_byte_length: 0,
        },
    };
    let length = (texels.len() * 8) as u64;
    let level =
        LevelIndex { byte_offset: begin as u64, byte_length: length, uncompressed_byte_length: length };
    let mut out = Vec::with_capacity(begin + texels.len() * 8);
    out.extend(header.as_bytes());
    out.extend(level.as_bytes());
    out.extend(descriptor);
    out.extend(pairs);
    out.resize(begin, 0);
    out.extend(texels.iter().flatten().flat_map(|v| v.to_le_bytes()));
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn volumes_are_read_back() {
        let texels: Vec<[f16; 4]> =
            (0..24u8).map(|i| [0.5, 1.0, -2.0, 0.0].map(|v| f16::from_f32(v * f32::from(i)))).collect();
        let bytes = volume([2, 3, 4], &texels, &[("KTXorientation", "rui"), ("KTXwriter", "bake")]);
        let reader = ktx2::Reader::new(&bytes[..]).expect("a KTX2 file");
        let header = reader.header();
        assert_eq!(header.format, Some(Format::R16G16B16A16_SFLOAT));
        assert_eq!([header.pixel_width, header.pixel_height, header.pixel_depth], [2, 3, 4]);
        let pairs: Vec<(&str, &[u8])> = reader.key_value_data().collect();
        assert_eq!(pairs, [("KTXorientation", &b"rui\0"[..]), ("KTXwriter", b"bake\0")]);
        let level = reader.levels().next().expect("a level");
        let want: Vec<u8> = texels.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        assert_eq!(level.data, want);
        assert!(reader.basic_dfd().is_some_and(|d| d.sample_information.len() == 4));
    }
}
