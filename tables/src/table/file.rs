//! The file: a line of JSON that describes it, numbers, and a checksum.
//!
//! | bytes | content |
//! |---|---|
//! | 8 | `ZHTABLE` and a line feed |
//! | 4 | length of the header, little-endian |
//! | header | [`Header`] as JSON |
//! | rest but 32 | numbers: for each block all first coefficients (f32), then ten ratios an entry (i16), then a shift an entry (i16) where it has one |
//! | 32 | BLAKE3 of everything before |
//!
//! Coefficient l of an entry is ratio / 32767 x sqrt(2 l + 1) x the first coefficient: radiance is nowhere negative, so this is the
//! range of the ratio. Numbers are read where they lie.

use crate::harmonics::{BANDS, Zh64};
use crate::response::interpolation::{ChebyshevAxis, Cubic, LogAxis};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// First bytes of the file.
pub const MAGIC: &[u8; 8] = b"ZHTABLE\n";

/// The only version that this code reads.
pub const VERSION: u32 = 1;

/// Where light comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Emitter {
    /// A point of 1 candela.
    Point,
    /// A sun of 1 lux on the plane that bounds the medium.
    Directional,
    /// A Lambertian patch of 1 nit and unit area.
    Area,
}

/// Which orders of scattering a block holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// This one, for albedo 1.
    Order(u32),
    /// All from 2 on, divided by the square of the albedo.
    Rest,
}

/// A quantity that a block is tabulated over.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "axis")]
pub enum Axis {
    /// Distance or depth, mean free paths; equal ratios.
    Distance {
        /// First node.
        first: f64,
        /// Last node.
        last: f64,
        /// Number of nodes.
        n: usize,
    },
    /// Mean cosine of scattering; Chebyshev nodes.
    G {
        /// Least value.
        from: f64,
        /// Greatest value.
        to: f64,
        /// Number of nodes.
        n: usize,
    },
    /// sqrt(1 - albedo); Chebyshev nodes.
    RootOfAbsorption {
        /// Least value.
        from: f64,
        /// Greatest value.
        to: f64,
        /// Number of nodes.
        n: usize,
    },
    /// Angle between a patch's normal and the way to the receiver, 0 to 180 degrees in equal steps.
    Angle {
        /// Number of nodes.
        n: usize,
    },
}

impl Axis {
    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        let (Self::Distance { n, .. }
        | Self::G { n, .. }
        | Self::RootOfAbsorption { n, .. }
        | Self::Angle { n }) = *self;
        n
    }

    /// Whether there are no nodes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Values of the nodes; angles in radians.
    #[must_use]
    pub fn nodes(&self) -> Vec<f64> {
        match *self {
            Self::Distance { first, last, n } => LogAxis { first, last, n }.nodes().collect(),
            Self::G { from, to, n } | Self::RootOfAbsorption { from, to, n } => {
                ChebyshevAxis { from, to, n }.nodes().collect()
            }
            Self::Angle { n } => (0..n).map(|i| std::f64::consts::PI * i as f64 / (n - 1) as f64).collect(),
        }
    }

    /// Nodes that count at a value, and their weights.
    fn at(&self, x: f64) -> Vec<(usize, f64)> {
        let cubic = |c: Cubic| (0..4).map(|i| (c.first + i, c.weights[i])).collect();
        match *self {
            Self::Distance { first, last, n } => cubic(LogAxis { first, last, n }.at(x)),
            Self::G { from, to, n } | Self::RootOfAbsorption { from, to, n } => {
                ChebyshevAxis { from, to, n }.at(x).into_iter().enumerate().collect()
            }
            Self::Angle { n } => cubic(Cubic::at(x / std::f64::consts::PI * (n - 1) as f64, n)),
        }
    }
}

/// A table for one emitter and part.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Block {
    /// Where light comes from.
    pub emitter: Emitter,
    /// Orders of scattering.
    pub part: Part,
    /// What it is tabulated over; the last one runs fastest.
    pub axes: Vec<Axis>,
    /// Whether entries have an axis of their own.
    pub shifted: bool,
    /// First byte, counted from behind the header.
    pub offset: usize,
}

impl Block {
    fn entries(&self) -> usize {
        self.axes.iter().map(Axis::len).product()
    }

    fn bytes(&self) -> usize {
        self.entries() * (4 + 2 * (BANDS - 1) + if self.shifted { 2 } else { 0 })
    }
}

/// What the file says of itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// [`VERSION`].
    pub version: u32,
    /// [`BANDS`].
    pub bands: usize,
    /// Name of the configuration that it was built with.
    pub preset: String,
    /// The tables.
    pub blocks: Vec<Block>,
}

/// Why a file is not one.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum FileError {
    /// Something else.
    #[error("this is no file of response tables: it does not begin with ZHTABLE")]
    Foreign,
    /// Cut off or changed.
    #[error("the file is damaged: {0}; build it again with `tables build`")]
    Damaged(String),
    /// Made by another version.
    #[error("the file has {what} {found}, this program reads {known}; build it again with `tables build`")]
    Differs {
        /// What differs.
        what: &'static str,
        /// In the file.
        found: String,
        /// Here.
        known: String,
    },
}

/// Response tables, read where they lie.
#[derive(Clone, Debug)]
pub struct Tables {
    bytes: Cow<'static, [u8]>,
    header: Header,
    start: usize,
}

impl Tables {
    /// Reads tables.
    ///
    /// # Errors
    ///
    /// If the bytes are no such file, were changed, or come from another version.
    pub fn from_bytes(bytes: impl Into<Cow<'static, [u8]>>) -> Result<Self, FileError> {
        let bytes = bytes.into();
        if !bytes.starts_with(MAGIC) {
            return Err(FileError::Foreign);
        }
        let cut = || FileError::Damaged("it ends too early".to_owned());
        let body = bytes.len().checked_sub(32).ok_or_else(cut)?;
        let length =
            bytes.get(8..12).and_then(|b| b.try_into().ok()).map(u32::from_le_bytes).ok_or_else(cut)?;
        let start = 12 + length as usize;
        if body < start {
            return Err(cut());
        }
        // The version first: another one may have its checksum elsewhere.
        let json: serde_json::Value = serde_json::from_slice(&bytes[12..start])
            .map_err(|e| FileError::Damaged(format!("its header: {e}")))?;
        let differs = |what, found: &serde_json::Value, known: String| FileError::Differs {
            what,
            found: found.to_string(),
            known,
        };
        if json["version"] != VERSION {
            return Err(differs("version", &json["version"], VERSION.to_string()));
        }
        if json["bands"] != BANDS {
            return Err(differs("bands", &json["bands"], BANDS.to_string()));
        }
        if *blake3::hash(&bytes[..body]).as_bytes() != bytes[body..] {
            return Err(FileError::Damaged("its checksum is wrong".to_owned()));
        }
        let header: Header =
            serde_json::from_value(json).map_err(|e| FileError::Damaged(format!("its header: {e}")))?;
        for b in &header.blocks {
            let end = b.offset.checked_add(b.bytes());
            if end.is_none_or(|end| body - start < end) || b.axes.iter().any(|a| a.len() < 4) {
                return Err(FileError::Damaged("a table lies outside it".to_owned()));
            }
        }
        Ok(Self { bytes, header, start })
    }

    /// What the file says of itself.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// Size of the file.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.bytes.len()
    }

    /// The block for an emitter and part.
    #[must_use]
    pub fn block(&self, emitter: Emitter, part: Part) -> Option<&Block> {
        self.header.blocks.iter().find(|b| b.emitter == emitter && b.part == part)
    }

    /// Coefficients of an entry, and its shift.
    #[must_use]
    pub fn entry(&self, block: &Block, i: usize) -> (Zh64, f64) {
        let n = block.entries();
        let at = self.start + block.offset;
        let word = |byte: usize| i16::from_le_bytes([self.bytes[byte], self.bytes[byte + 1]]);
        let first = &self.bytes[at + 4 * i..at + 4 * i + 4];
        let first = f64::from(f32::from_le_bytes([first[0], first[1], first[2], first[3]]));
        let mut zh = [first; BANDS];
        let ratios = at + 4 * n + 2 * (BANDS - 1) * i;
        for (l, z) in zh.iter_mut().enumerate().skip(1) {
            *z *= f64::from(word(ratios + 2 * (l - 1))) / STEPS * ((2 * l + 1) as f64).sqrt();
        }
        let shift = if block.shifted {
            f64::from(word(at + 4 * n + 2 * (BANDS - 1) * n + 2 * i)) / STEPS
        } else {
            0.0
        };
        (zh, shift)
    }

    /// Interpolated coefficients and shift at a value for each axis.
    #[must_use]
    pub fn interpolate(&self, block: &Block, at: &[f64]) -> (Zh64, f64) {
        let mut terms = vec![(0, 1.0)];
        for (axis, &x) in block.axes.iter().zip(at) {
            let nodes = axis.at(x);
            terms = terms
                .iter()
                .flat_map(|&(i, w)| nodes.iter().map(move |&(j, v)| (i * axis.len() + j, w * v)))
                .collect();
        }
        // First coefficients differ by many orders of magnitude along an axis, so their logarithms are interpolated, and the
        // others as parts of them.
        let (mut ratios, mut log, mut shift) = ([0.0; BANDS], 0.0, 0.0);
        for (i, w) in terms {
            let (entry, s) = self.entry(block, i);
            log += w * entry[0].max(f64::MIN_POSITIVE).ln();
            for (r, e) in ratios.iter_mut().zip(entry) {
                *r += w * if 0.0 < entry[0] { e / entry[0] } else { 0.0 };
            }
            shift += w * s;
        }
        let first = log.exp();
        (ratios.map(|r| r * first), shift.clamp(0.0, 1.0))
    }
}

/// Steps of a ratio or shift.
const STEPS: f64 = 32767.0;

/// A block to be written: its entries in order, with shifts.
#[derive(Clone, Debug)]
pub struct Content {
    /// Where light comes from.
    pub emitter: Emitter,
    /// Orders of scattering.
    pub part: Part,
    /// Axes.
    pub axes: Vec<Axis>,
    /// Entries.
    pub entries: Vec<Zh64>,
    /// Shifts, or none.
    pub shifts: Vec<f64>,
}

/// The file with the given blocks.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "numbers are rounded on purpose; a header is short")]
pub fn write(preset: &str, contents: &[Content]) -> Vec<u8> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut data: Vec<u8> = Vec::new();
    for c in contents {
        blocks.push(Block {
            emitter: c.emitter,
            part: c.part,
            axes: c.axes.clone(),
            shifted: !c.shifts.is_empty(),
            offset: data.len(),
        });
        data.extend(c.entries.iter().flat_map(|e| (e[0] as f32).to_le_bytes()));
        for e in &c.entries {
            for (l, v) in e.iter().enumerate().skip(1) {
                let ratio = v / (f64::from(e[0] as f32) * ((2 * l + 1) as f64).sqrt());
                let ratio = if ratio.is_finite() { ratio.clamp(-1.0, 1.0) } else { 0.0 };
                data.extend(((ratio * STEPS).round() as i16).to_le_bytes());
            }
        }
        data.extend(c.shifts.iter().flat_map(|s| ((s * STEPS).round() as i16).to_le_bytes()));
    }
    let header = Header { version: VERSION, bands: BANDS, preset: preset.to_owned(), blocks };
    let json = serde_json::to_vec(&header).unwrap_or_default();
    let mut out = MAGIC.to_vec();
    out.extend((json.len() as u32).to_le_bytes());
    out.extend(json);
    out.extend(data);
    let hash = blake3::hash(&out);
    out.extend(hash.as_bytes());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> Vec<u8> {
        let axes = vec![Axis::Distance { first: 0.1, last: 10.0, n: 5 }];
        let entries = (0..5).map(|i| std::array::from_fn(|l| f64::from(i + 1) / (l + 1) as f64)).collect();
        write(
            "test",
            &[Content {
                emitter: Emitter::Point,
                part: Part::Order(1),
                axes,
                entries,
                shifts: vec![0.25; 5],
            }],
        )
    }

    #[test]
    fn what_is_written_is_read() {
        let tables = Tables::from_bytes(small()).expect("a file");
        let block = tables.block(Emitter::Point, Part::Order(1)).expect("the block");
        let (zh, shift) = tables.entry(block, 3);
        for (l, z) in zh.iter().enumerate() {
            assert!((z - 4.0 / (l + 1) as f64).abs() < 4.0 * 2e-4, "{l} {z}");
        }
        assert!((shift - 0.25).abs() < 2e-5);
        // The middle of the axis is a node.
        assert!((tables.interpolate(block, &[1.0]).0[0] - 3.0).abs() < 1e-5);
        assert_eq!(tables.block(Emitter::Area, Part::Rest), None);
    }

    /// Poison: every cut and every changed byte is noticed.
    #[test]
    fn damage_is_named() {
        let good = small();
        for n in 0..good.len() {
            assert!(Tables::from_bytes(good[..n].to_vec()).is_err(), "cut at {n}");
            let mut bad = good.clone();
            bad[n] ^= 0x10;
            assert!(Tables::from_bytes(bad).is_err(), "changed at {n}");
        }
        assert_eq!(Tables::from_bytes(b"glTF".to_vec()).err(), Some(FileError::Foreign));
        let version = b"\"version\":1";
        let at =
            good.windows(version.len()).position(|w| w == version).expect("the version") + version.len() - 1;
        let mut newer = good;
        newer[at] = b'7';
        let e = Tables::from_bytes(newer).expect_err("another version").to_string();
        assert!(e.contains("version 7") && e.contains("reads 1"), "{e}");
    }
}
