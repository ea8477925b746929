//! Reads KTX 2 files with a 3-D texture: the first channel of the finest level. Texels lie in the order of the file, x fastest.

use super::{Unusable, Voxels, linear, raw};
use flate2::read::ZlibDecoder;
use glam::uvec3;
use ktx2::{Reader, SupercompressionScheme};
use ruzstd::decoding::StreamingDecoder;
use std::io::Read;

/// Formats that are read: Vulkan's number, channels and how each is stored.
const FORMATS: &[(ktx2::Format, usize, raw::Format)] = &[
    (ktx2::Format::R8_UNORM, 1, raw::Format::U8),
    (ktx2::Format::R8G8B8A8_UNORM, 4, raw::Format::U8),
    (ktx2::Format::R16_UNORM, 1, raw::Format::U16),
    (ktx2::Format::R16_SFLOAT, 1, raw::Format::F16),
    (ktx2::Format::R16G16B16A16_SFLOAT, 4, raw::Format::F16),
    (ktx2::Format::R32_SFLOAT, 1, raw::Format::F32),
    (ktx2::Format::R32G32B32A32_SFLOAT, 4, raw::Format::F32),
];

/// Reads a grid.
///
/// # Errors
/// Where the file is damaged, no single 3-D texture or of another format, and as [`Voxels::from_fn`].
pub fn read(file: &[u8], most_bytes: usize) -> Result<Voxels, Unusable> {
    let reader = Reader::new(file).map_err(|e| damaged(&e.to_string()))?;
    let head = reader.header();
    let size = uvec3(head.pixel_width, head.pixel_height, head.pixel_depth);
    if size.z == 0 || 1 < head.layer_count || head.face_count != 1 {
        return Err(Unusable::new(
            format!(
                "the texture has {} x {} x {} texels, {} layers and {} faces; a 3-D texture has a depth, no layers and 1 face",
                size.x, size.y, size.z, head.layer_count, head.face_count
            ),
            "save it as a 3-D texture",
        ));
    }
    super::check_size(size)?;
    let known = FORMATS.iter().find(|f| Some(f.0) == head.format);
    let &(_, channels, format) = known.ok_or_else(|| {
        let name = head.format.map_or_else(|| "none".to_owned(), |f| format!("{f:?}"));
        Unusable::new(
            format!("the texture has the format {name}, which is not read"),
            "save it as R8_UNORM, R16_UNORM, R16_SFLOAT or R32_SFLOAT",
        )
    })?;
    let texel = channels * format.bytes();
    let expected = size.as_u64vec3().element_product().saturating_mul(texel as u64);
    let level = reader.levels().next().ok_or_else(|| damaged("it has no levels"))?;
    let unpack = |decoder: &mut dyn Read| {
        // Of four channels, the three that are not kept.
        if (most_bytes as u64).saturating_mul(4) < expected {
            return Err(Unusable::large(expected as f64, most_bytes));
        }
        let mut data = Vec::new();
        decoder
            .take(expected.saturating_add(1))
            .read_to_end(&mut data)
            .map_err(|e| damaged(&e.to_string()))?;
        Ok(data)
    };
    let unpacked;
    let data = match head.supercompression_scheme {
        None => level.data,
        Some(SupercompressionScheme::ZLIB) => {
            unpacked = unpack(&mut ZlibDecoder::new(level.data))?;
            &unpacked
        }
        Some(SupercompressionScheme::Zstandard) => {
            let mut decoder = StreamingDecoder::new(level.data).map_err(|e| damaged(&e.to_string()))?;
            unpacked = unpack(&mut decoder)?;
            &unpacked
        }
        Some(other) => {
            return Err(Unusable::new(
                format!("the texture is packed with {other:?}, which is not read"),
                "save it without supercompression, or with Zstandard",
            ));
        }
    };
    if data.len() as u64 != expected {
        let found = if expected < data.len() as u64 { "more".to_owned() } else { data.len().to_string() };
        return Err(damaged(&format!("its finest level has {found} bytes of {expected}")));
    }
    Voxels::from_fn(size, most_bytes, |v| format.at(&data[linear(v, size) * texel..]))
}

fn damaged(why: &str) -> Unusable {
    Unusable::new(format!("this is no KTX 2 file, or it is damaged: {why}"), "export it again")
}

#[cfg(test)]
mod tests {
    use super::*;
    use flate2::{Compression, read::ZlibEncoder};
    use glam::UVec3;
    use half::f16;
    use ruzstd::encoding::{CompressionLevel, compress_to_vec};
    use std::{fs, path::Path};

    const ENOUGH: usize = 1 << 30;
    const SIZE: UVec3 = uvec3(5, 3, 9);

    /// A file of one level, without metadata.
    fn file(format: ktx2::Format, scheme: u32, size: UVec3, data: &[u8], unpacked: usize) -> Vec<u8> {
        let mut out = b"\xabKTX 20\xbb\r\n\x1a\n".to_vec();
        let word = |out: &mut Vec<u8>, v: u32| out.extend(v.to_le_bytes());
        let at = 104 + 44;
        for v in [format.value(), 1, size.x, size.y, size.z, 0, 1, 1, scheme, 104, 44, 0, 0, 0, 0, 0, 0] {
            word(&mut out, v);
        }
        for v in [at, data.len(), unpacked] {
            out.extend((v as u64).to_le_bytes());
        }
        // A descriptor of one sample, which nobody reads.
        for v in [44, 0, 2 | 40 << 16, 1, 0, 1, 0, 7 << 16, 0, 0, 255] {
            word(&mut out, v);
        }
        out.extend(data);
        out
    }

    /// Densities that every format holds.
    fn value(i: usize) -> u8 {
        if i * 7 % 5 == 4 { 255 } else { 0 }
    }

    fn texels(channels: usize, format: raw::Format) -> Vec<u8> {
        let voxels = SIZE.element_product() as usize;
        let texel = |i: usize| {
            let one = value(i) / 255;
            let first = match format {
                raw::Format::U8 => vec![value(i)],
                raw::Format::U16 => (u16::from(one) * 65535).to_le_bytes().to_vec(),
                raw::Format::F16 => f16::from_f32(one.into()).to_le_bytes().to_vec(),
                raw::Format::F32 => f32::from(one).to_le_bytes().to_vec(),
            };
            let rest = vec![0x7f; (channels - 1) * first.len()];
            [first, rest].concat()
        };
        (0..voxels).flat_map(texel).collect()
    }

    #[test]
    fn formats_and_packings_give_the_same_densities() {
        let mut first = None;
        for &(vulkan, channels, format) in FORMATS {
            let data = texels(channels, format);
            let mut zlib = Vec::new();
            ZlibEncoder::new(&data[..], Compression::default()).read_to_end(&mut zlib).expect("zlib");
            let zstd = compress_to_vec(&data[..], CompressionLevel::Fastest);
            for (scheme, packed) in [(0, &data), (3, &zlib), (2, &zstd)] {
                let grid = read(&file(vulkan, scheme, SIZE, packed, data.len()), ENOUGH)
                    .unwrap_or_else(|e| panic!("{vulkan:?} {scheme}: {e}"));
                assert_eq!((grid.size(), grid.place()), (SIZE, None));
                for i in 0..SIZE.element_product() {
                    let v = uvec3(i % SIZE.x, i / SIZE.x % SIZE.y, i / SIZE.x / SIZE.y);
                    assert_eq!(
                        grid.at(v.as_vec3a()),
                        f32::from(value(i as usize) / 255),
                        "{vulkan:?} {scheme} {v}"
                    );
                }
                assert_eq!(*first.get_or_insert_with(|| grid.clone()), grid);
                for end in 0..packed.len() {
                    let cut = file(vulkan, scheme, SIZE, &packed[..end], data.len());
                    // A frame may lack its checksum.
                    assert!(
                        scheme == 2 && packed.len() < end + 8 || read(&cut, ENOUGH).is_err(),
                        "{scheme} {end}"
                    );
                }
            }
        }
    }

    #[test]
    fn other_files_are_refused() {
        let said = |file: &[u8]| read(file, ENOUGH).expect_err("refused").what;
        let good = |size, format| file(format, 0, size, &[255; 4], 4);
        assert!(read(&good(uvec3(1, 1, 1), ktx2::Format::R8G8B8A8_UNORM), ENOUGH).is_ok());
        assert!(said(&good(uvec3(2, 2, 0), ktx2::Format::R8_UNORM)).contains("2 x 2 x 0 texels"));
        assert!(
            said(&good(uvec3(2, 1, 1), ktx2::Format::R8_UNORM)).contains("has 4 bytes of 2")
                || said(&good(uvec3(2, 1, 1), ktx2::Format::R8_UNORM)).contains("more bytes of 2")
        );
        assert!(said(&good(uvec3(4, 1, 1), ktx2::Format::R8_SRGB)).contains("R8_SRGB"));
        assert!(said(&good(uvec3(1, 1, 1), ktx2::Format::R32_SFLOAT)).contains("NaN"), "all bits set");
        assert!(said(&file(ktx2::Format::R8_UNORM, 1, uvec3(4, 1, 1), &[1; 4], 4)).contains("BasisLZ"));
        let huge = file(ktx2::Format::R32_SFLOAT, 2, UVec3::splat(1 << 20), &[0; 4], 4);
        assert!(read(&huge, ENOUGH).is_err());
        assert!(said(b"").contains("no KTX 2"));
        let whole = good(uvec3(1, 1, 1), ktx2::Format::R8G8B8A8_UNORM);
        for end in 0..whole.len() {
            assert!(read(&whole[..end], ENOUGH).is_err(), "cut at {end}");
            for bit in 0..8 {
                let mut bad = whole.clone();
                bad[end] ^= 1 << bit;
                drop(read(&bad, 1 << 20));
            }
        }
    }

    #[test]
    #[expect(clippy::print_stderr, reason = "a test that did not run must say so")]
    fn real_files_are_read() {
        let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
        let named = std::env::var_os("BAKE_SHARED").map(Into::into);
        let dirs = named.into_iter().chain([beside]).map(|d| d.join("scenes/volumes"));
        let Some(dir) = dirs.into_iter().find(|d| d.is_dir()) else {
            eprintln!("skipped: the folder of shared scenes is not here");
            return;
        };
        for name in ["bevy-bunny", "bevy-fog_noise"] {
            let file = fs::read(dir.join(name).with_extension("ktx2")).expect("a file");
            let grid = read(&file, ENOUGH).unwrap_or_else(|e| panic!("{name}: {e}"));
            assert_eq!(grid.size(), UVec3::splat(64), "{name}");
            // All of R32_SFLOAT, behind a head of 200 bytes.
            let values: Vec<f32> =
                file[200..].as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
            assert_eq!(Voxels::dense(grid.size(), &values, ENOUGH).as_ref(), Ok(&grid), "{name}");
            eprintln!("{name}: up to {}, {} bytes", grid.most(), grid.memory());
        }
    }
}
