//! `lightmap-N.ktx2`: a page as engines and graphics cards take it.
//!
//! Row 0 is the top, as in the EXR (`KTXorientation` is `rd`); linear Rec. 709; nits (of `E / pi`); one mip level, because those above it would mix charts. Blocks
//! are packed with Zstandard. Two formats:
//!
//! - `bc6h`: unsigned BC6H, a byte a texel before packing. The pages of a bake are multiples of 4, which WebGPU and Direct3D want; of other sizes the blocks at the right and
//!   lower edges continue the last column and row. Texels that lie beyond the gutter, black in the EXR, hold whatever makes their block better, and blocks without others are black.
//! - `rgba16f`: half floats, bit for bit those of the EXR rounded to nearest; `A` is coverage.
//!
//! Values beyond 65504 become 65504, NaN becomes 0, and in `bc6h` so does what is below 0; all are counted. Several maps of one page, such as those of spherical
//! harmonics, become layers of an array texture in the order given: each has all of the page's texels and `A` is the same in all. Maps with a sign go into `rgba16f`.
//!
//! Every file is read back from the disk: headers, a hash of all blocks, each `rgba16f` texel bit for bit, and each `bc6h` block by way of another
//! decoder, which has to be as good as a block of the mean colour at least.

use super::bc6h::{self, Block};
use super::ktx::{self, Contents, Format, Packing, Shape, Texture};
use super::page::{Page, PageStats, luminance};
use crate::error::{Error, Result};
use crate::plan::settings::TextureFormat;
use half::f16;
use rayon::prelude::*;
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;
use tables::format::manifest;

/// Metadata, in the order of keys.
const TEXTS: &[(&str, &str)] =
    &[("KTXorientation", "rd"), ("KTXwriter", concat!("bake ", env!("CARGO_PKG_VERSION")))];

/// Rows that are made, and later compared, at once; each of them is [`bc6h::SIDE`] rows of texels.
const STRIPS: usize = 64;

/// Part of the mean luminance that is added to both sides before logarithms are compared, so that black counts little.
const LOG_FLOOR: f64 = 1e-3;

/// Maps of one page that make a texture.
#[derive(Clone, Debug)]
pub struct Maps<'a> {
    /// Texels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// One or more, each with `width * height` colours; several become an array.
    pub layers: Vec<&'a [[f32; 3]]>,
    /// Part of each texel that its chart covers.
    pub coverage: &'a [f32],
    /// Rings of gutter around covered texels.
    pub padding: u32,
}

/// What a texture holds in comparison with the page.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Length of the file.
    pub bytes: u64,
    /// Root mean squared difference of the three channels over covered texels of all layers, nits.
    pub rmse: f64,
    /// `rmse` over the mean luminance of the first layer, unless that is black.
    pub relative_rmse: Option<f64>,
    /// Root mean squared difference of the logarithm of luminance over covered texels of the first layer, which has a thousandth of its mean added.
    pub log_rmse: Option<f64>,
    /// Values beyond 65504 or below -65504.
    pub overflows: u64,
    /// Values that were NaN, or below 0 where the format has no sign.
    pub unsigned: u64,
}

impl Figures {
    /// As the manifest has them.
    #[must_use]
    pub fn record(&self, format: TextureFormat) -> manifest::Texture {
        let format = match format {
            TextureFormat::Bc6h => "bc6h_ufloat",
            TextureFormat::Rgba16f => "rgba16f",
        };
        manifest::Texture {
            format: format.to_owned(),
            bytes: self.bytes,
            rmse: self.rmse,
            relative_rmse: self.relative_rmse,
            log_rmse: self.log_rmse,
            clamped: self.overflows + self.unsigned,
        }
    }
}

/// Writes the texture of a page; equal pages give equal bytes at any number of threads.
///
/// # Errors
/// [`Error::Usage`] if a layer of the page is misshapen or empty, [`Error::Io`] if the file cannot be written, or does not hold what it should.
pub fn write_page(path: &Path, page: &Page, padding: u32, format: TextureFormat) -> Result<Figures> {
    let maps = Maps {
        width: page.width,
        height: page.height,
        layers: vec![&page.radiance],
        coverage: &page.coverage,
        padding,
    };
    maps.write(path, format)
}

/// Writes the directions of a page's light, if it has them: an array of three layers, x, y and z, of half floats. Relative figures are left out: the
/// layers have signs.
///
/// # Errors
/// As [`write_page`].
pub fn write_directions(path: &Path, page: &Page, padding: u32) -> Result<Option<Figures>> {
    let Some(directions) = &page.sh1 else { return Ok(None) };
    let maps = Maps {
        width: page.width,
        height: page.height,
        layers: directions.iter().map(Vec::as_slice).collect(),
        coverage: &page.coverage,
        padding,
    };
    let figures = maps.write(path, TextureFormat::Rgba16f)?;
    Ok(Some(Figures { relative_rmse: None, log_rmse: None, ..figures }))
}

impl Maps<'_> {
    /// Writes them, reads them back and compares.
    ///
    /// # Errors
    /// As [`write_page`].
    pub fn write(&self, path: &Path, format: TextureFormat) -> Result<Figures> {
        let shape = self.shape(path)?;
        let format = match format {
            TextureFormat::Bc6h => Format::Bc6hUfloat,
            TextureFormat::Rgba16f => Format::Rgba16f,
        };
        let texture = Texture { format, shape, packing: Packing::Zstd(ktx::LEVEL), texts: TEXTS };
        let mut clamped = Clamped::default();
        let hash = File::create(path)
            .and_then(|file| {
                let mut file = BufWriter::new(file);
                let hash = texture.write(&mut file, |out| {
                    self.batches().try_for_each(|batch| {
                        let strips: Vec<(Vec<u8>, Clamped)> =
                            batch.into_par_iter().map(|s| self.strip(s).bytes(format)).collect();
                        strips.iter().try_for_each(|(bytes, c)| {
                            clamped.add(*c);
                            out.write_all(bytes)
                        })
                    })
                })?;
                file.flush()?;
                Ok(hash)
            })
            .map_err(Error::io(path, "cannot write"))?;
        let (bytes, sums) = self.compare(path, &texture, hash).map_err(Error::io(path, "cannot verify"))?;
        Ok(self.figures(bytes, sums, clamped))
    }

    /// Reads the file back and compares every texel.
    fn compare(&self, path: &Path, texture: &Texture<'_>, hash: blake3::Hash) -> io::Result<(u64, Sums)> {
        let wrong = |what: &str| io::Error::other(format!("the file does not hold what was written: {what}"));
        let file = File::open(path)?;
        let length = file.metadata()?.len();
        let mut contents = Contents::open(BufReader::with_capacity(1 << 16, file))?;
        if !contents.is(texture.format, texture.shape) {
            return Err(wrong("format and sizes"));
        }
        let floor = LOG_FLOOR * self.mean_luminance();
        let mut sums = Sums::default();
        let mut data = Vec::new();
        for batch in self.batches() {
            let lengths: Vec<usize> = batch.clone().map(|s| self.strip(s).length(texture.format)).collect();
            data.resize(lengths.iter().sum(), 0);
            contents.read_exact(&mut data)?;
            let mut rest = &data[..];
            let parts: Vec<&[u8]> =
                lengths.iter().map(|n| rest.split_off(..*n).unwrap_or_default()).collect();
            let got: Vec<Option<Sums>> = parts
                .into_par_iter()
                .zip(batch.clone())
                .map(|(bytes, s)| self.strip(s).compare(texture.format, bytes, floor))
                .collect();
            for (part, s) in got.into_iter().zip(batch) {
                let strip = self.strip(s);
                sums.add(
                    part.ok_or_else(|| wrong(&format!("layer {} from row {} on", strip.layer, strip.row)))?,
                );
            }
        }
        if contents.read(&mut [0])? != 0 || contents.hash() != hash {
            return Err(wrong("the hash differs"));
        }
        Ok((length, sums))
    }

    fn figures(&self, bytes: u64, sums: Sums, clamped: Clamped) -> Figures {
        let n = sums.covered.max(1) as f64;
        let rmse = (sums.squares / (3.0 * n)).sqrt();
        let mean = self.mean_luminance();
        let lit = 0.0 < mean;
        Figures {
            bytes,
            rmse,
            relative_rmse: lit.then(|| rmse / mean),
            log_rmse: lit.then(|| (sums.log_squares * self.layers.len() as f64 / n).sqrt()),
            overflows: clamped.overflows,
            unsigned: clamped.unsigned,
        }
    }

    fn shape(&self, path: &Path) -> Result<Shape> {
        let n = self.width * self.height;
        let fits = self.layers.iter().all(|l| l.len() == n) && self.coverage.len() == n;
        let sizes = (u32::try_from(self.width), u32::try_from(self.height), u32::try_from(self.layers.len()));
        match sizes {
            (Ok(x), Ok(y), Ok(1)) if fits && 0 < n => Ok(Shape::Flat([x, y])),
            (Ok(x), Ok(y), Ok(layers)) if fits && 0 < n && 0 < layers => Ok(Shape::Array([x, y], layers)),
            _ => Err(Error::Usage(format!(
                "{}: layers are not {} x {} texels, or there are none",
                path.display(),
                self.width,
                self.height
            ))),
        }
    }

    /// Numbers of strips, in pieces whose memory is small.
    fn batches(&self) -> impl Iterator<Item = std::ops::Range<usize>> {
        let n = self.layers.len() * self.height.div_ceil(bc6h::SIDE);
        (0..n).step_by(STRIPS).map(move |s| s..(s + STRIPS).min(n))
    }

    fn strip(&self, number: usize) -> Strip<'_> {
        let strips = self.height.div_ceil(bc6h::SIDE);
        Strip { maps: self, layer: number / strips, row: number % strips * bc6h::SIDE }
    }

    /// Over covered texels of the first layer, nits.
    fn mean_luminance(&self) -> f64 {
        let mut stats = PageStats::default();
        for (c, _) in self.layers[0].iter().zip(self.coverage).filter(|(_, coverage)| 0.0 < **coverage) {
            stats.covered += 1;
            stats.sum_luminance += luminance(*c);
        }
        stats.mean_luminance()
    }
}

/// Some rows of a layer: [`bc6h::SIDE`], or what is left of them.
#[derive(Clone, Copy)]
struct Strip<'a> {
    maps: &'a Maps<'a>,
    layer: usize,
    row: usize,
}

impl Strip<'_> {
    fn rows(&self) -> std::ops::Range<usize> {
        self.row..(self.row + bc6h::SIDE).min(self.maps.height)
    }

    fn length(&self, format: Format) -> usize {
        let blocks = self.maps.width.div_ceil(format.block());
        blocks * self.rows().len().div_ceil(format.block()) * format.bytes()
    }

    /// Its blocks, and what they could not hold.
    fn bytes(&self, format: Format) -> (Vec<u8>, Clamped) {
        let mut out = Vec::with_capacity(self.length(format));
        if format == Format::Bc6hUfloat {
            self.blocks().for_each(|(_, block)| out.extend(block.encode()));
        } else {
            self.halves().for_each(|(_, texel)| out.extend(texel.map(f16::to_le_bytes).as_flattened()));
        }
        (out, self.clamped(format))
    }

    /// Compares what was read with what was meant; nothing if it differs.
    fn compare(&self, format: Format, bytes: &[u8], floor: f64) -> Option<Sums> {
        let mut sums = Sums::default();
        if format == Format::Bc6hUfloat {
            for ((x, block), bytes) in self.blocks().zip(bytes.as_chunks().0) {
                let decoded = bc6h::decode(bytes);
                if !block.is_met_by(&decoded) {
                    return None;
                }
                for (i, texel) in decoded.iter().enumerate() {
                    let (x, y) = (x + i % bc6h::SIDE, self.row + i / bc6h::SIDE);
                    if x < self.maps.width && y < self.maps.height {
                        let got = texel.map(|v| f16::from_bits(v).to_f32());
                        self.add(&mut sums, y * self.maps.width + x, got, floor);
                    }
                }
            }
        } else {
            for ((i, wanted), bytes) in self.halves().zip(bytes.as_chunks::<8>().0) {
                let got: [f16; 4] =
                    std::array::from_fn(|c| f16::from_le_bytes([bytes[2 * c], bytes[2 * c + 1]]));
                if got.map(f16::to_bits) != wanted.map(f16::to_bits) {
                    return None;
                }
                self.add(&mut sums, i, [got[0], got[1], got[2]].map(f16::to_f32), floor);
            }
        }
        Some(sums)
    }

    /// Adds the difference of a texel that is covered.
    fn add(&self, sums: &mut Sums, i: usize, got: [f32; 3], floor: f64) {
        if self.maps.coverage[i] <= 0.0 {
            return;
        }
        // A value that is NaN has no difference, but the texture shall not hide behind that.
        let meant = self.maps.layers[self.layer][i].map(|v| if v.is_nan() { 0.0 } else { v });
        sums.covered += 1;
        sums.squares +=
            got.iter().zip(meant).map(|(a, b)| (f64::from(*a) - f64::from(b)).powi(2)).sum::<f64>();
        if self.layer == 0 && 0.0 < floor {
            let log = |c| (luminance(c).max(0.0) + floor).ln();
            sums.log_squares += (log(got) - log(meant)).powi(2);
        }
    }

    /// Texels with their places on the page.
    fn halves(&self) -> impl Iterator<Item = (usize, [f16; 4])> {
        let Maps { width, layers, coverage, .. } = self.maps;
        let layer = layers[self.layer];
        (self.rows().start * width..self.rows().end * width).map(move |i| {
            let [r, g, b] = layer[i].map(half);
            (i, [r, g, b, half(coverage[i])])
        })
    }

    /// Blocks with the column where they begin.
    fn blocks(&self) -> impl Iterator<Item = (usize, Block)> {
        let needed = self.needed();
        let Maps { width, height, layers, .. } = self.maps;
        let layer = layers[self.layer];
        (0..*width).step_by(bc6h::SIDE).map(move |x| {
            let at = |i: usize| {
                let (x, y) = (x + i % bc6h::SIDE, self.row + i / bc6h::SIDE);
                (x.min(width - 1), y.min(height - 1))
            };
            let block = Block {
                texels: std::array::from_fn(|i| {
                    let (x, y) = at(i);
                    layer[y * width + x].map(positive_half)
                }),
                needed: std::array::from_fn(|i| {
                    let (x, y) = at(i);
                    needed[(y - self.row) * width + x]
                }),
            };
            (x, block)
        })
    }

    /// Which texels of the rows are covered or in the gutter.
    fn needed(&self) -> Vec<bool> {
        let Maps { width, height, coverage, .. } = *self.maps;
        let padding = self.maps.padding as usize;
        let near = |i: usize, n: usize| i.saturating_sub(padding)..(i + padding + 1).min(n);
        let mut out = Vec::with_capacity(width * bc6h::SIDE);
        for y in self.rows() {
            let column = |x: usize| near(y, height).any(|y| 0.0 < coverage[y * width + x]);
            let columns: Vec<bool> = (0..width).map(column).collect();
            out.extend((0..width).map(|x| columns[near(x, width)].contains(&true)));
        }
        out
    }

    fn clamped(&self, format: Format) -> Clamped {
        let greatest = f16::MAX.to_f32();
        let signed = format != Format::Bc6hUfloat;
        let mut out = Clamped::default();
        let width = self.maps.width;
        for v in
            self.maps.layers[self.layer][self.rows().start * width..self.rows().end * width].as_flattened()
        {
            let below = v.is_nan() || !signed && *v < 0.0;
            out.unsigned += u64::from(below);
            out.overflows += u64::from(!below && greatest < v.abs());
        }
        out
    }
}

/// The nearest half float; NaN is 0.
fn half(v: f32) -> f16 {
    if v.is_nan() { f16::ZERO } else { f16::from_f32(v.clamp(f16::MIN.to_f32(), f16::MAX.to_f32())) }
}

/// Bits of the nearest half float that is not below 0.
fn positive_half(v: f32) -> u16 {
    if 0.0 < v { half(v).to_bits() } else { 0 }
}

/// Values that a format cannot hold.
#[derive(Clone, Copy, Default)]
struct Clamped {
    overflows: u64,
    unsigned: u64,
}

impl Clamped {
    fn add(&mut self, o: Self) {
        self.overflows += o.overflows;
        self.unsigned += o.unsigned;
    }
}

/// Sums over covered texels, made strip by strip in their order.
#[derive(Clone, Copy, Default)]
struct Sums {
    covered: u64,
    squares: f64,
    log_squares: f64,
}

impl Sums {
    fn add(&mut self, o: Self) {
        self.covered += o.covered;
        self.squares += o.squares;
        self.log_squares += o.log_squares;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    /// A page of four charts with gutter between them, light that falls over them, and noise.
    fn page(width: usize, height: usize) -> Page {
        let mut page = Page::new(width, height);
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                let chance = (i * 2_654_435_761 % 1_000_003) as f32 / 1e6;
                let covered = x != width / 2 && y != height / 2 + 1;
                let light = 40.0 / (1.0 + 0.05 * x as f32) * (0.9 + 0.2 * chance);
                page.coverage[i] = if covered { 0.5 + 0.5 * chance } else { 0.0 };
                page.radiance[i] = [light, 0.8 * light, 0.3 * light + 0.1 * chance];
            }
        }
        page
    }

    fn read(path: &Path, shape: Shape, format: Format) -> Vec<u8> {
        let mut contents = Contents::open(File::open(path).expect("a file")).expect("a texture");
        assert!(contents.is(format, shape));
        let mut data = Vec::new();
        contents.read_to_end(&mut data).expect("blocks");
        data
    }

    fn threads<T: Send>(n: usize, f: impl FnOnce() -> T + Send) -> T {
        rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("threads").install(f)
    }

    #[test]
    fn pages_of_any_size_are_kept() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        for (width, height) in [(1, 1), (3, 17), (4, 4), (64, 33), (129, 301)] {
            let page = page(width, height);
            let shape = Shape::Flat([u32::try_from(width)?, u32::try_from(height)?]);
            let path = dir.path().join("a.ktx2");
            let half = write_page(&path, &page, 2, TextureFormat::Rgba16f)?;
            assert_eq!(half.bytes, fs::metadata(&path)?.len());
            let data = read(&path, shape, Format::Rgba16f);
            assert_eq!(data.len(), width * height * 8);
            for (i, texel) in data.as_chunks::<8>().0.iter().enumerate() {
                let wanted = [page.radiance[i].as_slice(), &[page.coverage[i]]].concat();
                let got = texel.as_chunks::<2>().0.iter().map(|b| f16::from_le_bytes(*b));
                assert!(wanted.iter().map(|v| f16::from_f32(*v)).eq(got), "{width} x {height}, texel {i}");
            }
            let block = write_page(&path, &page, 2, TextureFormat::Bc6h)?;
            let data = read(&path, shape, Format::Bc6hUfloat);
            assert_eq!(data.len(), width.div_ceil(4) * height.div_ceil(4) * 16);
            assert_eq!((block.overflows, block.unsigned, half.overflows, half.unsigned), (0, 0, 0, 0));
            // Single texels are exact but for rounding. Of the noise of 6 % a block keeps a part.
            let relative = |f: Figures| f.relative_rmse.unwrap_or_default();
            assert!(relative(half) < 3e-4 && half.log_rmse < Some(3e-4), "{half:?}");
            assert!(relative(block) < 0.04 && block.log_rmse < Some(0.03), "{width} x {height}: {block:?}");
        }
        Ok(())
    }

    /// Every block's texels, decoded, are those of its place.
    #[test]
    fn blocks_are_where_they_belong() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("a.ktx2");
        let (width, height) = (21, 14);
        let mut page = Page::new(width, height);
        page.coverage.fill(1.0);
        for (i, c) in page.radiance.iter_mut().enumerate() {
            let (x, y) = (i % width / 4, i / width / 4);
            *c = [1.0 + x as f32, 1.0 + y as f32, 5.0];
        }
        write_page(&path, &page, 2, TextureFormat::Bc6h)?;
        let data = read(&path, Shape::Flat([21, 14]), Format::Bc6hUfloat);
        for (i, block) in data.as_chunks().0.iter().enumerate() {
            let wanted = [1.0 + (i % 6) as f32, 1.0 + (i / 6) as f32, 5.0];
            for texel in bc6h::decode(block) {
                for (w, t) in wanted.iter().zip(texel) {
                    assert!((f16::from_bits(t).to_f32() / w - 1.0).abs() < 2e-3, "block {i}: {texel:?}");
                }
            }
        }
        Ok(())
    }

    #[test]
    fn what_does_not_fit_is_clamped_and_counted() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("a.ktx2");
        let mut page = page(8, 8);
        page.coverage.fill(1.0);
        page.radiance.fill([1e5; 3]);
        page.radiance[0] = [65504.0, 65505.0, f32::INFINITY];
        page.radiance[9] = [f32::NAN, -3.0, -0.0];
        page.radiance[10] = [-1e9, 0.0, 1e-9];
        for (format, overflows, unsigned) in
            [(TextureFormat::Bc6h, 61 * 3 + 2, 3), (TextureFormat::Rgba16f, 61 * 3 + 3, 1)]
        {
            let figures = write_page(&path, &page, 2, format)?;
            assert_eq!((figures.overflows, figures.unsigned), (overflows, unsigned), "{format:?}");
        }
        let data = read(&path, Shape::Flat([8, 8]), Format::Rgba16f);
        let values: Vec<f32> =
            data.as_chunks::<2>().0.iter().map(|b| f16::from_le_bytes(*b).to_f32()).collect();
        assert_eq!(values[..4], [65504.0, 65504.0, 65504.0, 1.0]);
        assert_eq!(values[36..44], [0.0, -3.0, 0.0, 1.0, -65504.0, 0.0, 0.0, 1.0]);
        assert!(values[4..36].chunks(4).all(|t| t[..3] == [65504.0; 3]));
        Ok(())
    }

    #[test]
    fn maps_become_layers() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("a.ktx2");
        let page = page(10, 7);
        let signed: Vec<[f32; 3]> = page.radiance.iter().map(|c| [-c[0], c[1], c[2] - 1.0]).collect();
        let maps = Maps {
            width: 10,
            height: 7,
            layers: vec![&page.radiance, &signed, &page.radiance],
            coverage: &page.coverage,
            padding: 2,
        };
        let figures = maps.write(&path, TextureFormat::Rgba16f)?;
        assert!(figures.unsigned == 0 && figures.relative_rmse < Some(3e-4), "{figures:?}");
        let data = read(&path, Shape::Array([10, 7], 3), Format::Rgba16f);
        for (layer, colours) in [&page.radiance, &signed, &page.radiance].iter().enumerate() {
            for (i, c) in colours.iter().enumerate() {
                let at = (layer * 70 + i) * 8;
                let got = f16::from_le_bytes([data[at], data[at + 1]]);
                assert_eq!(got, f16::from_f32(c[0]), "layer {layer} texel {i}");
            }
        }
        let figures = maps.write(&path, TextureFormat::Bc6h)?;
        assert!(0 < figures.unsigned);
        let data = read(&path, Shape::Array([10, 7], 3), Format::Bc6hUfloat);
        assert_eq!(data.len(), 3 * 3 * 2 * 16);
        assert_eq!(data[..96], data[192..]);
        let misshapen = Maps { height: 8, ..maps.clone() };
        assert!(matches!(misshapen.write(&path, TextureFormat::Bc6h), Err(Error::Usage(_))));
        let empty = Maps { layers: Vec::new(), ..maps };
        assert!(matches!(empty.write(&path, TextureFormat::Bc6h), Err(Error::Usage(_))));
        Ok(())
    }

    #[test]
    fn bytes_do_not_depend_on_threads() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let page = page(130, 600);
        for format in [TextureFormat::Bc6h, TextureFormat::Rgba16f] {
            let write = |n: usize| -> Result<(Vec<u8>, Figures)> {
                let path = dir.path().join(n.to_string());
                let figures = threads(n, || write_page(&path, &page, 2, format))?;
                Ok((fs::read(&path).map_err(Error::io(path, "cannot read"))?, figures))
            };
            assert_eq!(write(1)?, write(3)?);
        }
        Ok(())
    }

    #[test]
    fn damaged_files_are_noticed() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("a.ktx2");
        let page = page(32, 40);
        let maps = Maps {
            width: 32,
            height: 40,
            layers: vec![&page.radiance],
            coverage: &page.coverage,
            padding: 2,
        };
        let other = Maps { layers: vec![&page.std_err], ..maps.clone() };
        for format in [Format::Bc6hUfloat, Format::Rgba16f] {
            let texture =
                Texture { format, shape: Shape::Flat([32, 40]), packing: Packing::Stored, texts: TEXTS };
            let mut file = File::create(&path)?;
            let hash = texture.write(&mut file, |out| {
                (0..10).try_for_each(|s| out.write_all(&maps.strip(s).bytes(format).0))
            })?;
            drop(file);
            assert!(maps.compare(&path, &texture, hash).is_ok());
            let said = |maps: &Maps<'_>, hash| {
                maps.compare(&path, &texture, hash).map(|_| ()).expect_err("differs").to_string()
            };
            assert!(said(&other, hash).contains("layer 0 from row 0 on"), "{}", said(&other, hash));
            assert!(said(&maps, blake3::hash(b"")).contains("hash"));
            let wider = Texture { shape: Shape::Flat([33, 40]), ..texture };
            assert!(maps.compare(&path, &wider, hash).is_err());
            let mut bytes = fs::read(&path)?;
            let last = bytes.len() - 1;
            bytes[last - 20] ^= 1;
            fs::write(&path, &bytes)?;
            said(&maps, hash);
            fs::write(&path, &bytes[..last])?;
            said(&maps, hash);
        }
        // A whole write names the file it failed on.
        let nowhere = dir.path().join("no folder/a.ktx2");
        let error = write_page(&nowhere, &page, 2, TextureFormat::Bc6h).expect_err("no folder").to_string();
        assert!(error.contains("a.ktx2"), "{error}");
        Ok(())
    }

    /// Texels beyond the gutter are black in the page; leaving them out makes the border better.
    #[test]
    fn black_beyond_the_gutter_does_not_spoil_borders() {
        let mut page = Page::new(16, 16);
        for y in 0..16 {
            for x in 0..6 {
                page.radiance[y * 16 + x] = [5.0 + 0.1 * x as f32 + 0.05 * y as f32; 3];
                page.coverage[y * 16 + x] = if x < 4 { 1.0 } else { 0.0 };
            }
        }
        let of = |padding| {
            let maps = Maps {
                width: 16,
                height: 16,
                layers: vec![&page.radiance],
                coverage: &page.coverage,
                padding,
            };
            let blocks: Vec<(usize, Block)> = maps.strip(1).blocks().collect();
            let needed = blocks.iter().map(|(_, b)| b.needed.map(u8::from)).collect::<Vec<_>>();
            let decoded = bc6h::decode(&blocks[1].1.encode());
            // The gutter's two columns.
            let off = |i: usize| {
                let wanted = page.radiance[(4 + i / 4) * 16 + 4 + i % 4][0];
                (f16::from_bits(decoded[i][0]).to_f32() / wanted - 1.0).abs()
            };
            let worst = (0..16).filter(|i| i % 4 < 2).map(off).fold(0.0, f32::max);
            (needed, worst)
        };
        let (needed, with) = of(2);
        assert_eq!(needed, [[1; 16], [1, 1, 0, 0, 1, 1, 0, 0, 1, 1, 0, 0, 1, 1, 0, 0], [0; 16], [0; 16]]);
        let (_, without) = of(99);
        assert!(with < 5e-3 && 2.0 * with < without, "{with} {without}");
    }
}
