//! KTX2 files: containers of textures as graphics cards take them.
//!
//! Header and descriptors come from the crate `ktx2`, from the format's specification 2.0 (Khronos Group). Files have one
//! mip level: those above it would mix charts. Data are written and read as they pass, so that a texture need not be in memory.

use half::f16;
use ktx2::dfd::{Basic, Block};
use ktx2::{Header, Index, LevelIndex, SupercompressionScheme};
use std::io::{self, Cursor, Read, Seek, SeekFrom, Write};

/// Level of compression that lightmaps are packed with. On a page of the hall, as it is and smoothed: BC6H to 74 and 68 % at level 3, 74 and 64 % at 6, 73 and 63 % at 9,
/// 72 and 60 % at 19; half floats to 55 and 51 %, 51 and 48 %, 50 and 47 %, 50 and 43 %, with 0.2, 0.5, 1 and 20 to 25 s for 25 MB.
pub const LEVEL: i32 = 6;

/// What a texel is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Blocks of 4 x 4 texels, 16 bytes each: red, green and blue from 0 to 65504.
    Bc6hUfloat,
    /// Four half floats.
    Rgba16f,
    /// One half float.
    R16f,
    /// Red, green and blue with 9 bits each and one exponent, see [`rgb9e5`].
    Rgb9e5,
}

impl Format {
    /// Its number in Vulkan, which KTX2 uses.
    #[must_use]
    pub const fn number(self) -> ktx2::Format {
        match self {
            Self::Bc6hUfloat => ktx2::Format::BC6H_UFLOAT_BLOCK,
            Self::Rgba16f => ktx2::Format::R16G16B16A16_SFLOAT,
            Self::R16f => ktx2::Format::R16_SFLOAT,
            Self::Rgb9e5 => ktx2::Format::E5B9G9R9_UFLOAT_PACK32,
        }
    }

    /// Texels along both sides of a block.
    #[must_use]
    pub const fn block(self) -> usize {
        match self {
            Self::Bc6hUfloat => 4,
            Self::Rgba16f | Self::R16f | Self::Rgb9e5 => 1,
        }
    }

    /// Bytes of a block.
    #[must_use]
    pub const fn bytes(self) -> usize {
        match self {
            Self::Bc6hUfloat => 16,
            Self::Rgba16f => 8,
            Self::R16f => 2,
            Self::Rgb9e5 => 4,
        }
    }
}

/// How many texels there are along which axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Columns and rows.
    Flat([u32; 2]),
    /// Columns, rows, and layers behind each other.
    Array([u32; 2], u32),
    /// Columns, rows and slices.
    Volume([u32; 3]),
}

impl Shape {
    /// Texels along x, y and z, where there is z, and layers of an array, as the header has them.
    fn counts(self) -> ([u32; 3], u32) {
        match self {
            Self::Flat([x, y]) => ([x, y, 0], 0),
            Self::Array([x, y], layers) => ([x, y, 0], layers),
            Self::Volume(size) => (size, 0),
        }
    }

    /// Bytes of all its blocks, those that reach beyond the edge included.
    #[must_use]
    pub fn bytes(self, format: Format) -> u64 {
        let ([x, y, z], layers) = self.counts();
        let blocks = |n: u32| u64::from(n).div_ceil(format.block() as u64);
        let area = blocks(x) * blocks(y);
        area * u64::from(z.max(1)) * u64::from(layers.max(1)) * format.bytes() as u64
    }
}

/// How data lie in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// As graphics cards take them.
    Stored,
    /// One frame of Zstandard with a checksum, compressed at this level; scheme 2 of the format.
    Zstd(i32),
}

/// A texture that is to be written.
#[derive(Clone, Copy, Debug)]
pub struct Texture<'a> {
    /// What a texel is.
    pub format: Format,
    /// How many there are.
    pub shape: Shape,
    /// How they lie in the file.
    pub packing: Packing,
    /// Metadata as keys and texts, which the format wants in the order of keys.
    pub texts: &'a [(&'a str, &'a str)],
}

impl Texture<'_> {
    /// Writes a file from its beginning; `fill` writes the blocks: x fastest, then y, then z or layers. Returns what tells these blocks
    /// from others, see [`Contents::hash`].
    ///
    /// # Errors
    /// Those of `out` and `fill`, and if there are not as many bytes as the shape says.
    pub fn write<W: Write + Seek>(
        &self,
        out: &mut W,
        fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<blake3::Hash> {
        let expected = self.shape.bytes(self.format);
        let head = self.head();
        out.write_all(&head)?;
        let (written, hash) = match self.packing {
            Packing::Stored => {
                let mut metered = Metered::new(&mut *out);
                fill(&mut metered)?;
                metered.done()
            }
            Packing::Zstd(level) => {
                let mut encoder = zstd::Encoder::new(&mut *out, level)?;
                encoder.set_pledged_src_size(Some(expected))?;
                encoder.include_checksum(true)?;
                let mut metered = Metered::new(encoder);
                fill(&mut metered)?;
                let (written, hash, encoder) = metered.into_parts();
                encoder.finish()?;
                (written, hash)
            }
        };
        if written != expected {
            return Err(io::Error::other(format!("{written} bytes of texels and not {expected}")));
        }
        let end = out.stream_position()?;
        let begin = head.len() as u64;
        let level =
            LevelIndex { byte_offset: begin, byte_length: end - begin, uncompressed_byte_length: expected };
        out.seek(SeekFrom::Start(Header::LENGTH as u64))?;
        out.write_all(&level.as_bytes())?;
        out.seek(SeekFrom::Start(end))?;
        Ok(hash)
    }

    /// Everything before the blocks, with an empty level.
    #[expect(clippy::cast_possible_truncation, reason = "headers are short")]
    fn head(&self) -> Vec<u8> {
        let format = self.format.number();
        let (basic, type_size) = Basic::from_format(format).expect("a format that is known");
        let block = Block::Basic(basic).to_vec();
        let descriptor = [&(block.len() as u32 + 4).to_le_bytes()[..], &block].concat();
        let mut pairs = Vec::new();
        for (key, text) in self.texts {
            let pair = [key.as_bytes(), &[0], text.as_bytes(), &[0]].concat();
            pairs.extend((pair.len() as u32).to_le_bytes());
            pairs.extend(pair);
            pairs.resize(pairs.len().next_multiple_of(4), 0);
        }
        let at = Header::LENGTH + LevelIndex::LENGTH;
        let after = at + descriptor.len() + pairs.len();
        let (scheme, begin) = match self.packing {
            // A multiple of 4 and of the bytes of a block, which are powers of 2.
            Packing::Stored => (None, after.next_multiple_of(self.format.bytes().max(4))),
            Packing::Zstd(_) => (Some(SupercompressionScheme::Zstandard), after),
        };
        let (size, layers) = self.shape.counts();
        let header = Header {
            format: Some(format),
            type_size,
            pixel_width: size[0],
            pixel_height: size[1],
            pixel_depth: size[2],
            layer_count: layers,
            face_count: 1,
            level_count: 1,
            supercompression_scheme: scheme,
            index: Index {
                dfd_byte_offset: at as u32,
                dfd_byte_length: descriptor.len() as u32,
                kvd_byte_offset: if pairs.is_empty() { 0 } else { (at + descriptor.len()) as u32 },
                kvd_byte_length: pairs.len() as u32,
                sgd_byte_offset: 0,
                sgd_byte_length: 0,
            },
        };
        let mut out = Vec::with_capacity(begin);
        out.extend(header.as_bytes());
        out.resize(at, 0);
        out.extend(descriptor);
        out.extend(pairs);
        out.resize(begin, 0);
        out
    }
}

/// Counts and hashes what passes.
struct Metered<T> {
    inner: T,
    bytes: u64,
    hasher: blake3::Hasher,
}

impl<T> Metered<T> {
    fn new(inner: T) -> Self {
        Self { inner, bytes: 0, hasher: blake3::Hasher::new() }
    }

    fn pass(&mut self, bytes: &[u8]) {
        self.bytes += bytes.len() as u64;
        self.hasher.update(bytes);
    }

    fn done(&self) -> (u64, blake3::Hash) {
        (self.bytes, self.hasher.finalize())
    }

    fn into_parts(self) -> (u64, blake3::Hash, T) {
        (self.bytes, self.hasher.finalize(), self.inner)
    }
}

impl<W: Write> Write for Metered<W> {
    fn write(&mut self, buf: &[u8]) -> io::Result<usize> {
        let n = self.inner.write(buf)?;
        self.pass(&buf[..n]);
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl<R: Read> Read for Metered<R> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buf)?;
        self.pass(&buf[..n]);
        Ok(n)
    }
}

/// A texture that is read: implements [`Read`] for its blocks.
pub struct Contents<'a> {
    header: Header,
    data: Metered<Box<dyn Read + 'a>>,
}

impl<'a> Contents<'a> {
    /// Reads what stands before the blocks.
    ///
    /// # Errors
    /// If this is no KTX2 file of one level, stored or packed with Zstandard.
    pub fn open<R: Read + Seek + 'a>(mut file: R) -> io::Result<Self> {
        let invalid = |what: String| io::Error::new(io::ErrorKind::InvalidData, what);
        let mut head = [0; Header::LENGTH];
        file.read_exact(&mut head)?;
        let header = Header::from_bytes(&head).map_err(|e| invalid(e.to_string()))?;
        let mut index = [0; LevelIndex::LENGTH];
        file.read_exact(&mut index)?;
        let level = LevelIndex::from_bytes(&index);
        if header.level_count != 1 {
            return Err(invalid(format!("{} mip levels and not one", header.level_count)));
        }
        file.seek(SeekFrom::Start(level.byte_offset))?;
        let packed = file.take(level.byte_length);
        let data: Box<dyn Read + 'a> = match header.supercompression_scheme {
            None => Box::new(packed),
            Some(SupercompressionScheme::Zstandard) => {
                Box::new(ruzstd::decoding::StreamingDecoder::new(packed).map_err(|e| invalid(e.to_string()))?)
            }
            Some(other) => return Err(invalid(format!("packed with {other:?}"))),
        };
        Ok(Self { header, data: Metered::new(data) })
    }

    /// Whether the header says this format and shape.
    #[must_use]
    pub fn is(&self, format: Format, shape: Shape) -> bool {
        let h = &self.header;
        let counts = ([h.pixel_width, h.pixel_height, h.pixel_depth], h.layer_count);
        h.format == Some(format.number()) && counts == shape.counts() && h.face_count == 1
    }

    /// What tells the blocks read so far from others; of all of them what [`Texture::write`] returned.
    #[must_use]
    pub fn hash(&self) -> blake3::Hash {
        self.data.done().1
    }
}

impl Read for Contents<'_> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        self.data.read(buf)
    }
}

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

/// Texels of a volume, x fastest, then y, then z.
#[derive(Clone, Copy, Debug)]
pub enum Texels<'a> {
    /// [`Format::Rgba16f`].
    Rgba16f(&'a [[f16; 4]]),
    /// [`Format::R16f`].
    R16f(&'a [f16]),
    /// [`Format::Rgb9e5`], as [`rgb9e5`] packs colours.
    Rgb9e5(&'a [u32]),
}

/// What volumes in the scene's axes say of themselves: right, up and out of the screen is how glTF's axes point.
pub(super) const VOLUME_TEXTS: &[(&str, &str)] =
    &[("KTXorientation", "ruo"), ("KTXwriter", concat!("bake ", env!("CARGO_PKG_VERSION")))];

/// The file of a three-dimensional texture: irradiance volumes of engines, light and densities of media.
///
/// # Errors
/// If there are not as many texels as `size` says.
pub fn volume(
    size: [u32; 3],
    texels: Texels<'_>,
    packing: Packing,
    texts: &[(&str, &str)],
) -> io::Result<Vec<u8>> {
    let format = match texels {
        Texels::Rgba16f(_) => Format::Rgba16f,
        Texels::R16f(_) => Format::R16f,
        Texels::Rgb9e5(_) => Format::Rgb9e5,
    };
    let texture = Texture { format, shape: Shape::Volume(size), packing, texts };
    let mut out = Cursor::new(Vec::new());
    texture.write(&mut out, |out| match texels {
        Texels::Rgba16f(list) => pieces(out, list, |t| t.map(|v| v.to_le_bytes()).concat()),
        Texels::R16f(list) => pieces(out, list, |t| t.to_le_bytes().to_vec()),
        Texels::Rgb9e5(list) => pieces(out, list, |t| t.to_le_bytes().to_vec()),
    })?;
    Ok(out.into_inner())
}

/// Writes texels in pieces of some size.
fn pieces<T>(out: &mut dyn Write, list: &[T], bytes: impl Fn(&T) -> Vec<u8>) -> io::Result<()> {
    list.chunks(1 << 12)
        .try_for_each(|piece| out.write_all(&piece.iter().flat_map(&bytes).collect::<Vec<u8>>()))
}

/// A colour with a shared exponent, as Vulkan's specification has it (16.1.5, "shared exponent to RGB"): red in the lowest 9 bits, then green, blue, and 5 bits of exponent.
/// The greatest of the three keeps 9 bits. Below 0 and NaN become 0, beyond 65408 becomes 65408.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most 2^9, and not below 0")]
pub fn rgb9e5(rgb: [f32; 3]) -> u32 {
    const GREATEST: f32 = 65408.0;
    let rgb = rgb.map(|c| if 0.0 < c { c.min(GREATEST) } else { 0.0 });
    let greatest = rgb[0].max(rgb[1]).max(rgb[2]);
    // The exponent of a float is in its bits; those below 2^-16 share the least one.
    let exponent = ((greatest.to_bits() >> 23) as i32 - 127).max(-16) + 16;
    let mantissa = |c: f32, exponent: i32| (f64::from(c) * f64::from(24 - exponent).exp2() + 0.5) as u32;
    // Rounding may need one bit more.
    let exponent = exponent + i32::from(mantissa(greatest, exponent) == 1 << 9);
    let [r, g, b] = rgb.map(|c| mantissa(c, exponent));
    r | g << 9 | b << 18 | (exponent as u32) << 27
}

#[cfg(test)]
mod tests {
    use super::*;

    fn halves() -> Vec<[f16; 4]> {
        (0..24u8).map(|i| [0.5, 1.0, -2.0, 0.0].map(|v| f16::from_f32(v * f32::from(i)))).collect()
    }

    const TEXTS: &[(&str, &str)] = &[("KTXorientation", "rui"), ("KTXwriter", "bake")];

    #[test]
    fn volumes_are_read_back() -> anyhow::Result<()> {
        let (texels, packed) = (halves(), [7, u32::MAX, 0, 1 << 31, 99, 3]);
        let want: Vec<u8> = texels.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let want9: Vec<u8> = packed.iter().flat_map(|v| v.to_le_bytes()).collect();
        for packing in [Packing::Stored, Packing::Zstd(LEVEL)] {
            for (texels, size, want) in
                [(Texels::Rgba16f(&texels), [2, 3, 4], &want), (Texels::Rgb9e5(&packed), [3, 2, 1], &want9)]
            {
                let bytes = volume(size, texels, packing, TEXTS)?;
                let reader = ktx2::Reader::new(&bytes[..]).expect("a KTX2 file");
                let header = reader.header();
                assert_eq!([header.pixel_width, header.pixel_height, header.pixel_depth], size);
                let pairs: Vec<(&str, &[u8])> = reader.key_value_data().collect();
                assert_eq!(pairs, [("KTXorientation", &b"rui\0"[..]), ("KTXwriter", b"bake\0")]);
                let mut contents = Contents::open(Cursor::new(&bytes))?;
                let mut data = Vec::new();
                contents.read_to_end(&mut data)?;
                assert_eq!(&data, want);
                if packing == Packing::Stored {
                    assert_eq!(reader.levels().next().expect("a level").data, want);
                }
            }
        }
        assert!(volume([2, 3, 5], Texels::Rgba16f(&texels), Packing::Stored, &[]).is_err());
        assert!(volume([2, 3, 5], Texels::Rgba16f(&texels), Packing::Zstd(1), &[]).is_err());
        Ok(())
    }

    /// What the specification says of offsets, lengths and the descriptor, byte by byte, apart from the crate that wrote them.
    #[test]
    fn heads_are_as_the_specification_wants_them() -> anyhow::Result<()> {
        for (format, number, type_size, words) in [
            // Model BC6H, BT.709, linear; blocks of 4 x 4; 16 bytes; one sample of 128 bits, float, 0 to 1.
            (Format::Bc6hUfloat, 143, 1, vec![0x0001_0185, 0x0303, 16, 0, 0x807f_0000, 0, 0, 0x3f80_0000]),
            // Model RGBSDA; single texels; 8 bytes; four samples of 16 bits, signed float, -1 to 1; alpha is 15.
            (
                Format::Rgba16f,
                97,
                2,
                [0u32, 1, 2, 15].iter().enumerate().fold(vec![0x0001_0101, 0, 8, 0], |mut v, (i, c)| {
                    let offset = 16 * u32::try_from(i).unwrap_or(0);
                    v.extend([offset | 15 << 16 | (0xc0 | c) << 24, 0, 0xbf80_0000, 0x3f80_0000]);
                    v
                }),
            ),
            // Model RGBSDA; single texels; 2 bytes; one sample of 16 bits, signed float, -1 to 1.
            (
                Format::R16f,
                76,
                2,
                vec![0x0001_0101, 0, 2, 0, 15 << 16 | 0xc0 << 24, 0, 0xbf80_0000, 0x3f80_0000],
            ),
        ] {
            for packing in [Packing::Stored, Packing::Zstd(1)] {
                for shape in [Shape::Flat([5, 6]), Shape::Array([5, 6], 3), Shape::Volume([5, 6, 2])] {
                    let n = usize::try_from(shape.bytes(format))?;
                    let data: Vec<u8> = (0..n).map(|i| u8::try_from(i % 251).unwrap_or(0)).collect();
                    let mut out = Cursor::new(Vec::new());
                    let texture = Texture { format, shape, packing, texts: TEXTS };
                    let hash = texture.write(&mut out, |w| w.write_all(&data))?;
                    let out = out.into_inner();
                    let word = |at: usize| u32::from_le_bytes(out[at..at + 4].try_into().expect("four"));
                    let long = |at: usize| u64::from_le_bytes(out[at..at + 8].try_into().expect("eight"));
                    assert_eq!(out[..12], *b"\xabKTX 20\xbb\r\n\x1a\n");
                    let (size, layers) = shape.counts();
                    let scheme = if packing == Packing::Stored { 0 } else { 2 };
                    let head: Vec<u32> = (0..9).map(|i| word(12 + 4 * i)).collect();
                    assert_eq!(head, [number, type_size, size[0], size[1], size[2], layers, 1, 1, scheme]);
                    let dfd = 80 + 24;
                    let total = 4 + 8 + 4 * u32::try_from(words.len())?;
                    assert_eq!([word(48), word(52)], [dfd, total]);
                    assert_eq!(word(56), dfd + total, "the metadata follow at once");
                    // 4 + 15 + 4 bytes and 1 of padding, 4 + 10 + 5 and 1.
                    assert_eq!([word(60), word(64), word(68), word(72), word(76)], [44, 0, 0, 0, 0]);
                    let at = dfd as usize;
                    // Size of everything; Khronos, basic; version 2, size of the block.
                    assert_eq!([word(at), word(at + 4), word(at + 8)], [total, 0, 2 | (total - 4) << 16]);
                    let got: Vec<u32> = (0..words.len()).map(|i| word(at + 12 + 4 * i)).collect();
                    assert_eq!(got, words, "{format:?}: {got:x?}");
                    let begin = u64::from(dfd + total + 44);
                    let aligned = begin.next_multiple_of(format.bytes().max(4) as u64);
                    let begin = if packing == Packing::Stored { aligned } else { begin };
                    assert_eq!(long(80), begin);
                    assert_eq!(long(80) + long(88), out.len() as u64);
                    assert_eq!(long(96), n as u64);
                    if packing == Packing::Stored {
                        assert_eq!(out[out.len() - n..], data);
                    }
                    let mut contents = Contents::open(Cursor::new(&out))?;
                    assert!(contents.is(format, shape) && !contents.is(format, Shape::Flat([6, 5])));
                    let mut back = Vec::new();
                    contents.read_to_end(&mut back)?;
                    assert!(back == data && contents.hash() == hash);
                }
            }
        }
        Ok(())
    }

    #[test]
    fn damage_is_noticed() -> anyhow::Result<()> {
        let texture = Texture {
            format: Format::Rgba16f,
            shape: Shape::Flat([16, 16]),
            packing: Packing::Zstd(LEVEL),
            texts: TEXTS,
        };
        let data: Vec<u8> = (0..2048u32).map(|i| u8::try_from(i * i % 241).unwrap_or(0)).collect();
        let mut out = Cursor::new(Vec::new());
        let hash = texture.write(&mut out, |w| w.write_all(&data))?;
        let whole = out.into_inner();
        let begin = whole.len() - 100;
        for at in begin..whole.len() - 4 {
            let mut bad = whole.clone();
            bad[at] ^= 0x10;
            let mut back = Vec::new();
            let read = Contents::open(Cursor::new(&bad)).and_then(|mut c| {
                c.read_to_end(&mut back)?;
                Ok(c.hash())
            });
            assert!(read.is_err() || read.is_ok_and(|h| h != hash), "byte {at}");
        }
        assert!(Contents::open(Cursor::new(&whole[..90])).is_err());
        assert!(Contents::open(Cursor::new(b"no texture")).is_err());
        Ok(())
    }

    fn unpacked(v: u32) -> [f64; 3] {
        let scale = f64::from(i32::try_from(v >> 27).expect("five bits") - 24).exp2();
        [0, 9, 18].map(|s| f64::from(v >> s & 511) * scale)
    }

    #[test]
    fn shared_exponents_keep_nine_bits_of_the_greatest() {
        assert_eq!(rgb9e5([1.0, 0.5, 0.25]), 256 | 128 << 9 | 64 << 18 | 16 << 27);
        assert_eq!(unpacked(rgb9e5([f32::INFINITY, f32::NAN, -1.0])), [65408.0, 0.0, 0.0]);
        assert_eq!(rgb9e5([-0.0, 0.0, f32::MIN_POSITIVE / 4.0]), 0);
        // What rounds up to 512 takes the next exponent.
        assert_eq!(unpacked(rgb9e5([1.999_9, 0.0, 0.0])), [2.0, 0.0, 0.0]);
        let mut value = 1e-4f32;
        while value < 65000.0 {
            let rgb = [value, value * 0.37, value * 0.9];
            let back = unpacked(rgb9e5(rgb));
            let step = f64::from(value) / 256.0;
            for (c, b) in rgb.iter().zip(back) {
                assert!((f64::from(*c) - b).abs() <= 0.5 * step, "{rgb:?} {back:?}");
            }
            value *= 1.013;
        }
        // Every packed value whose greatest part uses its bits is its own.
        for v in (0..1 << 16).map(|i: u32| i.wrapping_mul(65537).wrapping_add(i << 3)) {
            let v = v | 256;
            let back = unpacked(v);
            #[expect(clippy::cast_possible_truncation, reason = "nine bits")]
            let again = rgb9e5(back.map(|c| c as f32));
            assert_eq!(again, v, "{back:?}");
        }
    }
}
