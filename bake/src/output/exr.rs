//! `lightmap-N.exr`, and reading any flat EXR.
//!
//! A page is one 32-bit float layer: `R G B` hold `E / pi` in nits, `A` coverage, `stderr.R/G/B`
//! the standard error of the mean, `direct.*` and `indirect.*` the two parts of the light where
//! they were asked for; where it was denoised, `noisy.*` what it was before and `rmse.*` the error that is left; where texels lay inside other geometry and were
//! filled from their chart, `filled`, which is 1 there and 0 elsewhere. Zip compression; channels are read from the page in place while writing.

use std::{
    fs::File,
    io::{self, BufReader},
    path::Path,
};

use exr::{
    block::{UncompressedBlock, chunk::Chunk, reader::ChunksReader},
    image::write::samples::{SamplesWriter, WritableSamples},
    math::{RoundingMode, Vec2},
    meta::{
        attribute::{AttributeValue, Chromaticities, LevelMode, LineOrder, SampleType, Text},
        header::Header,
    },
    prelude::{
        AnyChannel, AnyChannels, Blocks, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes,
        ReadChannels, ReadLayers, WritableImage,
    },
};
use half::f16;
use rayon::prelude::*;
use tables::format::manifest::UNIT;

use super::page::Page;
use super::stitch::Bits;
use crate::error::{Error, Result};

/// Name of the text attribute that holds [`UNIT`].
const UNIT_ATTRIBUTE: &str = "lightmapUnit";

/// Primaries and white point of Rec. 709 (ITU-R BT.709-6, item 1.3).
const REC709: Chromaticities = Chromaticities {
    red: Vec2(0.64, 0.33),
    green: Vec2(0.30, 0.60),
    blue: Vec2(0.15, 0.06),
    white: Vec2(0.3127, 0.3290),
};

/// Writes a page; equal pages give equal bytes at any number of threads.
///
/// The file is read back and every bit compared.
///
/// # Errors
/// [`Error::Usage`] if a layer is not `width * height` texels or the page is empty, [`Error::Io`] if
/// writing fails; a file that could not be finished is removed.
pub fn write_page(path: &Path, page: &Page) -> Result<()> {
    if let Some(layer) = page.misshapen_layer() {
        return Err(Error::Usage(format!(
            "{}: layer {layer} is not {} x {} texels",
            path.display(),
            page.width,
            page.height
        )));
    }
    write_planes(path, page.width, page.height, planes_of(page))?;
    verify(path, page)
}

/// Writes linear colours as `R G B`, 32-bit float; for difference pictures and views.
///
/// # Errors
/// As [`write_page`].
pub fn write_rgb(path: &Path, width: usize, height: usize, pixels: &[[f32; 3]]) -> Result<()> {
    if pixels.len() != width * height {
        let got = pixels.len();
        return Err(Error::Usage(format!("{}: {got} pixels are not {width} x {height}", path.display())));
    }
    // In the order of their names.
    let planes = [(2, "B"), (1, "G"), (0, "R")].into_iter();
    write_planes(
        path,
        width,
        height,
        planes.map(|(c, name)| (name.to_owned(), Plane::Color(pixels, c))).collect(),
    )
}

/// One channel, borrowed from a page.
#[derive(Clone, Copy)]
enum Plane<'a> {
    Scalar(&'a [f32]),
    /// 1 for what is in a set, else 0.
    Set(&'a Bits),
    /// One of three interleaved channels.
    Color(&'a [[f32; 3]], usize),
    /// The same of half floats, and written as such.
    Half(&'a [[f16; 3]], usize),
}

impl Plane<'_> {
    fn at(self, i: usize) -> f32 {
        match self {
            Self::Scalar(values) => values[i],
            Self::Set(bits) => f32::from(u8::from(bits.contains(i))),
            Self::Color(values, channel) => values[i][channel],
            Self::Half(values, channel) => values[i][channel].to_f32(),
        }
    }
}

/// Channels in the order of their names, as OpenEXR wants them.
fn planes_of(page: &Page) -> Vec<(String, Plane<'_>)> {
    let mut planes = vec![("A".to_owned(), Plane::Scalar(&page.coverage))];
    for (prefix, layer) in page.layers() {
        for (channel, name) in ["R", "G", "B"].into_iter().enumerate() {
            let name = if prefix.is_empty() { name.to_owned() } else { format!("{prefix}.{name}") };
            planes.push((name, Plane::Color(layer, channel)));
        }
    }
    planes.extend(page.filled.as_ref().map(|bits| ("filled".to_owned(), Plane::Set(bits))));
    planes.sort_by(|(a, _), (b, _)| a.cmp(b));
    planes
}

/// Writes `R G B` as half floats without a unit of ours; for images that are no lightmaps.
///
/// # Errors
/// As [`write_page`].
pub fn write_half(path: &Path, width: usize, height: usize, pixels: &[[f16; 3]]) -> Result<()> {
    if pixels.len() != width * height {
        let got = pixels.len();
        return Err(Error::Usage(format!("{}: {got} pixels are not {width} x {height}", path.display())));
    }
    let planes = [(2, "B"), (1, "G"), (0, "R")].into_iter();
    let planes = planes.map(|(c, name)| (name.to_owned(), Plane::Half(pixels, c))).collect();
    write_image(path, width, height, planes, None)
}

fn write_planes(path: &Path, width: usize, height: usize, planes: Vec<(String, Plane<'_>)>) -> Result<()> {
    write_image(path, width, height, planes, Some(UNIT))
}

fn write_image(
    path: &Path,
    width: usize,
    height: usize,
    planes: Vec<(String, Plane<'_>)>,
    unit: Option<&str>,
) -> Result<()> {
    if width == 0 || height == 0 {
        return Err(Error::Usage(format!("{}: an image of {width} x {height} pixels", path.display())));
    }
    let list = planes.into_iter().map(|(name, plane)| AnyChannel {
        name: text(&name),
        sample_data: Samples { width, plane },
        quantize_linearly: true,
        sampling: Vec2(1, 1),
    });
    let mut attributes = LayerAttributes { software_name: Some(text("bake")), ..LayerAttributes::default() };
    // The library keeps custom attributes in a hash map and writes them in its order, so there may
    // be one at most, or the bytes would differ from run to run.
    attributes.other.extend(unit.map(|unit| (text(UNIT_ATTRIBUTE), AttributeValue::Text(text(unit)))));
    // Without a fixed order, blocks are written as threads finish them.
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let layer = Layer::new((width, height), attributes, encoding, AnyChannels { list: list.collect() });
    let mut image = Image::from_layer(layer);
    image.attributes.chromaticities = Some(REC709);
    let write = image.write();
    // The library compresses on a thread pool of its own, so one thread has to be asked for.
    let write = if rayon::current_num_threads() == 1 { write.non_parallel() } else { write };
    write.to_file(path).map_err(|e| failure(path, "cannot write", e))
}

/// Text of a name of ours; every character is ASCII.
fn text(ascii: &str) -> Text {
    Text::new_or_none(ascii).unwrap_or_default()
}

/// Presents a [`Plane`] to the EXR library without a copy.
#[derive(Clone, Copy)]
struct Samples<'a> {
    width: usize,
    plane: Plane<'a>,
}

impl<'slf, 'a: 'slf> WritableSamples<'slf> for Samples<'a> {
    type Writer = Samples<'a>;

    fn sample_type(&self) -> SampleType {
        if matches!(self.plane, Plane::Half(..)) { SampleType::F16 } else { SampleType::F32 }
    }

    fn infer_level_modes(&self) -> (LevelMode, RoundingMode) {
        (LevelMode::Singular, RoundingMode::Down)
    }

    fn create_samples_writer(&'slf self, _header: &Header) -> Self::Writer {
        *self
    }
}

impl SamplesWriter for Samples<'_> {
    fn extract_line(&self, line: exr::block::lines::LineRefMut<'_>) {
        let start = line.location.position.y() * self.width + line.location.position.x();
        if let Plane::Half(values, channel) = self.plane {
            for (value, bytes) in values[start..].iter().zip(line.value.chunks_exact_mut(2)) {
                bytes.copy_from_slice(&value[channel].to_ne_bytes());
            }
            return;
        }
        for (i, bytes) in line.value.chunks_exact_mut(4).enumerate() {
            // The library swaps to the file's byte order later.
            bytes.copy_from_slice(&self.plane.at(start + i).to_ne_bytes());
        }
    }
}

/// A decoded flat EXR: one layer's channels as 32-bit floats, row 0 at the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Exr {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// In the order of their names.
    pub channels: Vec<Channel>,
    /// What a lightmap texel holds, where the file says so: [`UNIT`] for ours.
    pub unit: Option<String>,
}

/// One channel of an [`Exr`].
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Full name, such as `stderr.R`.
    pub name: String,
    /// Whether the file holds 16-bit floats (11 significant bits).
    pub half: bool,
    /// `width * height` values.
    pub values: Vec<f32>,
}

impl Exr {
    /// The channel of exactly this name.
    #[must_use]
    pub fn channel(&self, name: &str) -> Option<&Channel> {
        self.channels.iter().find(|c| c.name == name)
    }

    /// The three channels `prefix.R`, `prefix.G` and `prefix.B`, or `R`, `G` and `B` without a prefix.
    #[must_use]
    pub fn rgb(&self, prefix: &str) -> Option<[&Channel; 3]> {
        let named =
            |c: &str| self.channel(&if prefix.is_empty() { c.to_owned() } else { format!("{prefix}.{c}") });
        Some([named("R")?, named("G")?, named("B")?])
    }
}

/// Reads the first layer of a flat EXR with any channels of any sample type.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, is no EXR, or holds deep data.
pub fn read(path: &Path) -> Result<Exr> {
    let file = File::open(path).map_err(Error::io(path, "cannot open"))?;
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .from_unbuffered(file)
        .map_err(|e| failure(path, "cannot read", e))?;
    let layer = image.layer_data;
    let unit = match layer.attributes.other.get(&text(UNIT_ATTRIBUTE)) {
        Some(AttributeValue::Text(unit)) => Some(unit.to_string()),
        _ => None,
    };
    let channels = layer.channel_data.list.into_iter().map(|channel| Channel {
        name: channel.name.to_string(),
        half: matches!(channel.sample_data, FlatSamples::F16(_)),
        values: match channel.sample_data {
            FlatSamples::F16(values) => values.par_iter().map(|v| v.to_f32()).collect(),
            FlatSamples::F32(values) => values,
            #[expect(clippy::cast_precision_loss, reason = "integer channels are ids; ours are floats")]
            FlatSamples::U32(values) => values.par_iter().map(|&v| v as f32).collect(),
        },
    });
    Ok(Exr { width: layer.size.width(), height: layer.size.height(), channels: channels.collect(), unit })
}

/// Reads a page back, a block for each thread at a time, and compares every bit.
fn verify(path: &Path, page: &Page) -> Result<()> {
    let (width, height, planes) = (page.width, page.height, planes_of(page));
    let wrong = |channel: &str| {
        let what = format!("the file does not hold what was written (channel {channel})");
        Error::Io { path: path.to_owned(), doing: "cannot verify", source: io::Error::other(what) }
    };
    let broken = |e| failure(path, "cannot verify", e);
    let file = File::open(path).map_err(Error::io(path, "cannot verify"))?;
    let reader = exr::block::read(BufReader::new(file), true).map_err(broken)?;
    let mut chunks = reader.all_chunks(true).map_err(broken)?;
    let meta = chunks.meta_data().clone();
    let header = &meta.headers[0];
    let names = header.channels.list.iter().map(|c| (c.name.to_string(), c.sample_type));
    let named = names.eq(planes.iter().map(|(name, _)| (name.clone(), SampleType::F32)));
    if meta.headers.len() != 1 || header.layer_size != Vec2(width, height) || !named {
        return Err(wrong("sizes"));
    }
    let mut lines = 0;
    loop {
        let some =
            chunks.by_ref().take(rayon::current_num_threads()).collect::<exr::error::Result<Vec<Chunk>>>();
        let some = some.map_err(broken)?;
        if some.is_empty() {
            break;
        }
        let compare = |chunk: Chunk| {
            let block = UncompressedBlock::decompress_chunk(chunk, &meta, true).map_err(broken)?;
            let mut n = 0;
            for line in block.lines(&header.channels) {
                let (name, plane) = &planes[line.location.channel];
                let start = line.location.position.y() * width + line.location.position.x();
                let mut values = line.value.as_chunks::<4>().0.iter().enumerate();
                let same = |(i, bytes): (usize, &[u8; 4])| *bytes == plane.at(start + i).to_ne_bytes();
                if line.location.sample_count != width || !values.all(same) {
                    return Err(wrong(name));
                }
                n += 1;
            }
            Ok(n)
        };
        let counts = some.into_par_iter().map(compare).collect::<Result<Vec<usize>>>()?;
        lines += counts.iter().sum::<usize>();
    }
    if lines == height * planes.len() { Ok(()) } else { Err(wrong("rows")) }
}

fn failure(path: &Path, doing: &'static str, e: exr::error::Error) -> Error {
    let source = match e {
        exr::error::Error::Io(source) => source,
        other => io::Error::new(io::ErrorKind::InvalidData, other.to_string()),
    };
    Error::Io { path: path.to_owned(), doing, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(width: usize, height: usize, split: bool) -> Page {
        let mut page = Page::new(width, height);
        let value = |i: usize, c: usize| ((i * 3 + c) * 2_654_435_761 % 1_000_003) as f32 * 1e-3;
        let layer =
            |o: usize| Some((0..width * height).map(|i| [0, 1, 2].map(|c| value(i + o, c))).collect());
        page.radiance = layer(0).unwrap_or_default();
        page.std_err = layer(7).unwrap_or_default();
        page.coverage = (0..width * height).map(|i| value(i, 0) % 1.0).collect();
        if split {
            page.filled = Some(Bits::of(width * height, |i| i % 3 == 1));
            page.direct = layer(11);
            page.indirect = layer(13);
        }
        page
    }

    #[test]
    fn round_trip_is_exact_for_every_size_and_channel_set() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        for (width, height, split) in [(1, 1, false), (3, 17, true), (64, 33, false), (130, 70, true)] {
            let mut page = page(width, height, split);
            page.radiance[0] = [f32::MAX, f32::MIN_POSITIVE / 8.0, 0.0];
            let path = dir.path().join("lightmap-0.exr");
            write_page(&path, &page)?;
            verify(&path, &page)?;
            let back = read(&path)?;
            assert_eq!(back.channels.len(), if split { 14 } else { 7 });
            let filled =
                back.channel("filled").map(|c| c.values.iter().map(|v| *v == 1.0).collect::<Vec<_>>());
            assert_eq!(filled, split.then(|| (0..width * height).map(|i| i % 3 == 1).collect()));
            assert_eq!(back.unit.as_deref(), Some(UNIT));
            assert_eq!(back.rgb("direct").is_some(), split);
        }
        Ok(())
    }

    #[test]
    fn verifying_notices_one_bit() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("lightmap-0.exr");
        let mut page = page(5, 4, true);
        write_page(&path, &page)?;
        let texel = &mut page.indirect.as_mut().expect("split")[19][2];
        *texel = f32::from_bits(texel.to_bits() ^ 1);
        let message = verify(&path, &page).expect_err("differs").to_string();
        assert!(message.contains("indirect.B"), "{message}");
        Ok(())
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bytes() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let page = page(200, 150, true);
        let mut files = Vec::new();
        for threads in [1, 4, 4] {
            let path = dir.path().join(format!("{}.exr", files.len()));
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
            pool.install(|| write_page(&path, &page))?;
            files.push(std::fs::read(path)?);
        }
        assert!(files.iter().all(|f| *f == files[0]));
        Ok(())
    }

    #[test]
    fn half_and_colour_files_are_read() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("foreign.exr");
        let half = exr::prelude::f16::from_f32;
        exr::prelude::write_rgba_file(&path, 3, 2, |x, y| {
            (half(x as f32), half(y as f32), half(0.5), half(1.0))
        })?;
        let back = read(&path)?;
        assert_eq!((back.width, back.height, back.unit.as_deref()), (3, 2, None));
        let [r, g, b] = back.rgb("").expect("colour");
        assert!(r.half);
        assert_eq!(r.values, [0.0, 1.0, 2.0, 0.0, 1.0, 2.0]);
        assert_eq!(g.values, [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]);
        assert_eq!(b.values, [0.5; 6]);

        let path = dir.path().join("rgb.exr");
        write_rgb(&path, 2, 1, &[[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])?;
        assert_eq!(read(&path)?.rgb("").map(|c| c[1].values.clone()), Some(vec![2.0, 5.0]));
        Ok(())
    }

    #[test]
    fn failures_name_the_file() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let path = dir.path().join("x.exr");
        let mut page = page(4, 4, false);
        page.std_err.pop();
        let message = write_page(&path, &page).expect_err("too short").to_string();
        assert!(message.contains("x.exr") && message.contains("std_err"), "{message}");
        assert!(write_page(&path, &Page::new(0, 4)).is_err());
        assert!(!path.exists());
        assert!(matches!(read(&path), Err(Error::Io { doing: "cannot open", .. })));
        std::fs::write(&path, b"v/1\x01 no more")?;
        assert!(matches!(read(&path), Err(Error::Io { doing: "cannot read", .. })));
        assert!(write_page(&dir.path().join("no/such/x.exr"), &Page::new(1, 1)).is_err());
        Ok(())
    }
}
