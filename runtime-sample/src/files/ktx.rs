//! KTX2 textures: one level, plain or packed with Zstandard.

use std::{fs, io::Read, path::Path};

use anyhow::{Context, Result, bail, ensure};
use ktx2::{Format, Header, LevelIndex, SupercompressionScheme};

/// What a file holds.
#[derive(Debug)]
pub(crate) struct Image {
    /// How texels are stored.
    pub(crate) format: Format,
    /// Texels along x, y and z; 1 where the texture has fewer dimensions.
    pub(crate) size: [u32; 3],
    /// Layers of an array; 1 for others.
    pub(crate) layers: u32,
    /// Texels, layer by layer, slice by slice, row by row from the top.
    pub(crate) bytes: Vec<u8>,
}

/// Reads the one level of a texture.
///
/// # Errors
///
/// Where the file is missing, damaged, or in a format that bakes are not written in.
pub(crate) fn read(path: &Path) -> Result<Image> {
    let name = path.display();
    let file = fs::read(path).with_context(|| format!("{name}: missing; bake again"))?;
    parse(&file).with_context(|| format!("{name}: damaged; bake again"))
}

fn parse(file: &[u8]) -> Result<Image> {
    // Only the header and the index of levels are read: `ktx2::Reader` panics on descriptors of formats that are damaged, and these files need
    // none.
    let cut = || "it is cut off";
    let (header, rest) = file.split_first_chunk::<{ Header::LENGTH }>().with_context(cut)?;
    let header = Header::from_bytes(header).map_err(|e| anyhow::anyhow!("{e}"))?;
    let level = LevelIndex::from_bytes(rest.first_chunk::<{ LevelIndex::LENGTH }>().with_context(cut)?);
    let format = header.format.context("the format of its texels is not stated")?;
    let size = [header.pixel_width, header.pixel_height, header.pixel_depth].map(|n| n.max(1));
    let layers = header.layer_count.max(1);
    let end = level.byte_offset.checked_add(level.byte_length).with_context(cut)?;
    let [start, end] = [level.byte_offset, end].map(|n| usize::try_from(n).unwrap_or(usize::MAX));
    let data = file.get(start..end).with_context(cut)?;
    // What the header asks for is compared with what the texels need before room is made for them.
    let wanted = bytes(format, size, layers)?;
    ensure!(
        level.uncompressed_byte_length == wanted,
        "{} bytes of texels are stated, {wanted} are needed",
        level.uncompressed_byte_length
    );
    let bytes = match header.supercompression_scheme {
        None => data.to_vec(),
        Some(SupercompressionScheme::Zstandard) => {
            let mut bytes = Vec::new();
            let decoder =
                ruzstd::decoding::StreamingDecoder::new(data).map_err(|e| anyhow::anyhow!("{e}"))?;
            decoder.take(wanted + 1).read_to_end(&mut bytes)?;
            bytes
        }
        Some(other) => bail!("it is packed by {other:?}, which bakes are not"),
    };
    ensure!(bytes.len() as u64 == wanted, "{} of {wanted} bytes of texels are there", bytes.len());
    Ok(Image { format, size, layers, bytes })
}

impl Image {
    /// The same texels as half floats, if they are in blocks.
    pub(crate) fn unpacked(self) -> Self {
        if self.format != Format::BC6H_UFLOAT_BLOCK {
            return self;
        }
        let [w, h] = [0, 1].map(|a| self.size[a] as usize);
        let mut bytes = vec![0; 8 * w * h];
        let (wide, one) = (w.div_ceil(4), half::f16::ONE.to_le_bytes());
        for (i, block) in self.bytes.chunks_exact(16).enumerate() {
            let mut texels = [0; 48];
            bcdec_rs::bc6h_half(block, &mut texels, 12, false);
            for (k, rgb) in texels.chunks_exact(3).enumerate() {
                let (x, y) = (4 * (i % wide) + k % 4, 4 * (i / wide) + k / 4);
                // Blocks at the edge reach beyond it.
                if x < w && y < h {
                    let texel = &mut bytes[8 * (y * w + x)..][..8];
                    rgb.iter()
                        .zip(texel.chunks_exact_mut(2))
                        .for_each(|(v, to)| to.copy_from_slice(&v.to_le_bytes()));
                    texel[6..].copy_from_slice(&one);
                }
            }
        }
        Self { format: Format::R16G16B16A16_SFLOAT, bytes, ..self }
    }
}

/// Bytes that texels take.
fn bytes(format: Format, size: [u32; 3], layers: u32) -> Result<u64> {
    let [w, h, d] = size.map(u64::from);
    let slice = match format {
        Format::BC6H_UFLOAT_BLOCK => w.div_ceil(4).checked_mul(16 * h.div_ceil(4)),
        Format::R16G16B16A16_SFLOAT => w.checked_mul(8 * h),
        Format::R16_SFLOAT => w.checked_mul(2 * h),
        other => bail!("its format is {other:?}, which bakes are not written in"),
    };
    slice.and_then(|s| s.checked_mul(d)).and_then(|s| s.checked_mul(layers.into())).context("it is too large")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_follow_from_the_size() {
        let of = |f, size, layers| bytes(f, size, layers).ok();
        assert_eq!(of(Format::BC6H_UFLOAT_BLOCK, [5, 4, 1], 1), Some(32));
        assert_eq!(of(Format::R16G16B16A16_SFLOAT, [3, 2, 4], 1), Some(192));
        assert_eq!(of(Format::R16G16B16A16_SFLOAT, [3, 2, 1], 3), Some(144));
        assert_eq!(of(Format::R16_SFLOAT, [u32::MAX; 3], u32::MAX), None);
        assert_eq!(of(Format::R8G8B8A8_UNORM, [1; 3], 1), None);
    }

    /// A block of one colour: mode 11, both ends the same; 0x2aa of ten bits is the half float 0x52a5.
    #[test]
    fn blocks_are_unpacked() {
        let mut bits = 0b00011u128;
        (0..6).for_each(|c| bits |= 0x2aa << (5 + 10 * c));
        let image = Image {
            format: Format::BC6H_UFLOAT_BLOCK,
            size: [4, 4, 1],
            layers: 1,
            bytes: bits.to_le_bytes().into(),
        };
        let out = image.unpacked();
        assert_eq!((out.format, out.bytes.len()), (Format::R16G16B16A16_SFLOAT, 128));
        let values: Vec<f32> =
            out.bytes.chunks_exact(2).map(|b| half::f16::from_le_bytes([b[0], b[1]]).to_f32()).collect();
        for texel in values.chunks_exact(4) {
            assert_eq!((texel[0], texel[1], texel[3]), (values[0], values[0], 1.0));
            assert_eq!(texel[0], half::f16::from_bits(0x52a5).to_f32());
        }
    }

    /// One texel of half floats; where the descriptor of its format is said to be does not matter.
    #[test]
    fn a_level_is_read_without_a_descriptor() {
        let words: [u32; 9] = [97, 2, 1, 1, 0, 0, 1, 1, 0];
        let mut file = b"\xabKTX 20\xbb\r\n\x1a\n".to_vec();
        file.extend(words.into_iter().flat_map(u32::to_le_bytes));
        file.extend([0xff; 16].into_iter().chain([0; 16]));
        file.extend([104u64, 8, 8].into_iter().flat_map(u64::to_le_bytes));
        file.extend(1..=8);
        let image = parse(&file).expect("a texture");
        assert_eq!((image.size, image.layers, &image.bytes[..]), ([1; 3], 1, &[1, 2, 3, 4, 5, 6, 7, 8][..]));
        for end in 0..file.len() {
            assert!(parse(&file[..end]).is_err(), "cut at {end}");
        }
        file[80..88].fill(0xff);
        assert!(parse(&file).is_err(), "beyond the end");
    }

    #[test]
    fn what_is_no_texture_is_refused() {
        for bytes in [&b""[..], b"\xabKTX 20\xbb\r\n\x1a\n", &[0; 200]] {
            assert!(parse(bytes).is_err());
        }
    }
}
