//! The file: a line of JSON that describes it, numbers, and a checksum.
//!
//! | bytes | content |
//! |---|---|
//! | 8 | `ZHTABLE` and a line feed |
//! | 4 | length of the header, little-endian |
//! | header | [`Header`] as JSON |
//! | rest but 32 | numbers: for each block the natural logarithms of all first coefficients (f32), then the ratios of the others (i16), 10 or 65 an entry, then a shift an entry (i16) where it has one |
//! | 32 | BLAKE3 of everything before |
//!
//! Coefficient (l, m) of an entry is ratio / 32767 x sqrt(2 l + 1) x the first coefficient: radiance is nowhere negative, so this is
//! the range of the ratio. Numbers are read where they lie.

use crate::harmonics::{BANDS, Zh64};
use crate::response::interpolation::{ChebyshevAxis, HorizonAxis, LogAxis, ScatteringAxis, lagrange};
use crate::response::patch::{self, HALF, Response};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::f64::consts::PI;
use std::sync::LazyLock;

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

impl std::fmt::Display for Emitter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Point => "point",
            Self::Directional => "directional",
            Self::Area => "area",
        })
    }
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

impl std::fmt::Display for Part {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Order(n) => write!(f, "order {n}"),
            Self::Rest => f.write_str("orders 2.."),
        }
    }
}

/// A quantity that a block is tabulated over.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "axis")]
pub enum Axis {
    /// Distance or depth, mean free paths; equal ratios, polynomials through some neighbours.
    Distance {
        /// First node.
        first: f64,
        /// Last node.
        last: f64,
        /// Number of nodes.
        n: usize,
        /// Neighbours that count at a place between nodes.
        neighbours: usize,
    },
    /// Mean cosine of scattering, see [`ScatteringAxis`].
    G {
        /// Greatest |g|.
        to: f64,
        /// Number of nodes.
        n: usize,
    },
    /// Mean cosine of scattering in equal steps with coefficients linear between them, as in \[IR19\] section 4.4.
    Columns {
        /// Greatest |g|.
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
    /// Angle between a patch's normal and the way to the receiver, 0 to 180 degrees, see [`HorizonAxis`].
    Angle {
        /// Number of nodes on either side of 90 degrees.
        per_side: usize,
    },
    /// The same angle in equal steps, linear between them.
    Bins {
        /// Number of nodes.
        n: usize,
    },
}

impl Axis {
    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        match *self {
            Self::Distance { n, .. }
            | Self::G { n, .. }
            | Self::Columns { n, .. }
            | Self::RootOfAbsorption { n, .. }
            | Self::Bins { n } => n,
            Self::Angle { per_side } => 2 * per_side,
        }
    }

    /// Whether there are no nodes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether values between nodes follow from it.
    fn is_sound(&self) -> bool {
        match *self {
            Self::Distance { first, last, n, neighbours } => {
                0.0 < first && first < last && 2 <= neighbours && neighbours <= n
            }
            Self::G { to, n } | Self::Columns { to, n } => 0.0 < to && to < 1.0 && 2 <= n,
            Self::RootOfAbsorption { from, to, n } => from < to && 2 <= n,
            Self::Angle { per_side } => 2 <= per_side,
            Self::Bins { n } => 2 <= n,
        }
    }

    /// Values of the nodes; angles in radians.
    #[must_use]
    pub fn nodes(&self) -> Vec<f64> {
        let even = |from: f64, to: f64, n: usize| {
            (0..n).map(|i| from + (to - from) * i as f64 / (n - 1) as f64).collect()
        };
        match *self {
            Self::Distance { first, last, n, .. } => LogAxis { first, last, n }.nodes().collect(),
            Self::G { to, n } => ScatteringAxis { to, n }.nodes().collect(),
            Self::Columns { to, n } => even(-to, to, n),
            Self::RootOfAbsorption { from, to, n } => ChebyshevAxis { from, to, n }.nodes().collect(),
            Self::Angle { per_side } => HorizonAxis { per_side }.nodes().collect(),
            Self::Bins { n } => even(0.0, PI, n),
        }
    }

    /// Nodes that count at a value, and their weights.
    fn at(&self, x: f64) -> Vec<(usize, f64)> {
        let local = |place: f64, n: usize, neighbours: usize| {
            let (first, weights) = lagrange(place, n, neighbours);
            weights.into_iter().enumerate().map(|(i, w)| (first + i, w)).collect()
        };
        match *self {
            Self::Distance { first, last, n, neighbours } => {
                local((x / first).ln() / (last / first).ln() * (n - 1) as f64, n, neighbours)
            }
            Self::G { to, n } => ScatteringAxis { to, n }.at(x).into_iter().enumerate().collect(),
            Self::Columns { to, n } => local(0.5 * (x / to + 1.0) * (n - 1) as f64, n, 2),
            Self::RootOfAbsorption { from, to, n } => {
                ChebyshevAxis { from, to, n }.at(x).into_iter().enumerate().collect()
            }
            Self::Angle { per_side } => HorizonAxis { per_side }.at(x),
            Self::Bins { n } => local(x / PI * (n - 1) as f64, n, 2),
        }
    }
}

/// What an entry holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Form {
    /// Zonal coefficients about the way to the emitter.
    Zonal,
    /// Zonal coefficients about an axis of its own, and the shift of \[IR19\] section 4.2 that says which.
    Lobe,
    /// Coefficients with m >= 0, and the shift of the axis that fits best.
    Full,
}

impl Form {
    fn ratios(self) -> usize {
        match self {
            Self::Zonal | Self::Lobe => BANDS - 1,
            Self::Full => HALF - 1,
        }
    }

    fn shifted(self) -> bool {
        self != Self::Zonal
    }

    /// Band and place among the coefficients with m >= 0 of each that an entry holds.
    fn places(self) -> impl Iterator<Item = (usize, usize)> {
        (0..BANDS).flat_map(move |l| {
            let orders = if self == Self::Full { l } else { 0 };
            (0..=orders).map(move |m| (l, l * (l + 1) / 2 + m))
        })
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
    /// What an entry holds.
    pub form: Form,
    /// First byte, counted from behind the header.
    pub offset: usize,
}

impl Block {
    /// Number of entries.
    #[must_use]
    pub fn entries(&self) -> usize {
        self.axes.iter().map(Axis::len).product()
    }

    /// Number of bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.entries() * (4 + 2 * self.form.ratios() + if self.form.shifted() { 2 } else { 0 })
    }

    /// Values of the axes at an entry.
    #[must_use]
    pub fn place(&self, mut i: usize) -> Vec<f64> {
        let mut place: Vec<f64> = Vec::with_capacity(self.axes.len());
        for axis in self.axes.iter().rev() {
            place.push(axis.nodes()[i % axis.len()]);
            i /= axis.len();
        }
        place.reverse();
        place
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

/// What `tables build` made.
static EMBEDDED: &[u8] = include_bytes!("../../../data/tables/default.zht");

impl Tables {
    /// The tables that come with the program.
    ///
    /// # Errors
    ///
    /// If they were built by another version of it.
    pub fn embedded() -> Result<Self, FileError> {
        Self::from_bytes(EMBEDDED)
    }

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
            if end.is_none_or(|end| body - start < end) || !b.axes.iter().all(Axis::is_sound) {
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

    /// BLAKE3 of everything in the file before its checksum, in hexadecimal digits.
    #[must_use]
    pub fn checksum(&self) -> String {
        self.bytes[self.bytes.len() - 32..].iter().map(|b| format!("{b:02x}")).collect()
    }

    /// The block for an emitter and part.
    #[must_use]
    pub fn block(&self, emitter: Emitter, part: Part) -> Option<&Block> {
        self.header.blocks.iter().find(|b| b.emitter == emitter && b.part == part)
    }

    /// An entry.
    #[must_use]
    pub fn entry(&self, block: &Block, i: usize) -> Entry {
        let n = block.entries();
        let at = self.start + block.offset;
        let word = |byte: usize| f64::from(i16::from_le_bytes([self.bytes[byte], self.bytes[byte + 1]]));
        let first = &self.bytes[at + 4 * i..at + 4 * i + 4];
        let log = f64::from(f32::from_le_bytes([first[0], first[1], first[2], first[3]]));
        let mut ratios = [0.0; HALF];
        ratios[0] = 1.0;
        let words = at + 4 * n + 2 * block.form.ratios() * i;
        let root: &Zh64 = &ROOTS;
        for (k, (l, place)) in block.form.places().skip(1).enumerate() {
            ratios[place] = word(words + 2 * k) / STEPS * root[l];
        }
        let shift = if block.form.shifted() {
            word(at + 4 * n + 2 * block.form.ratios() * n + 2 * i) / STEPS * PI
        } else {
            0.0
        };
        Entry { log, ratios, shift }
    }

    /// Interpolated coefficients about the way to the emitter at a value for each axis, times exp(`log_factor`), and the shift.
    #[must_use]
    pub fn interpolate(&self, block: &Block, at: &[f64], log_factor: f64) -> (Response, f64) {
        // Columns of g are linear in the coefficients themselves, and the last axis.
        let columns = match (block.axes.last(), at.last()) {
            (Some(axis @ Axis::Columns { .. }), Some(&g)) => axis.at(g),
            _ => Vec::new(),
        };
        let rest = &block.axes[..block.axes.len() - usize::from(!columns.is_empty())];
        let mut terms = vec![(0, 1.0)];
        for (axis, &x) in rest.iter().zip(at) {
            let nodes = axis.at(x);
            terms = terms
                .iter()
                .flat_map(|&(i, w)| nodes.iter().map(move |&(j, v)| (i * axis.len() + j, w * v)))
                .collect();
        }
        if columns.is_empty() {
            return self.mix(block, &terms, log_factor);
        }
        let n = block.axes.last().map_or(1, Axis::len);
        let mut sum = ([0.0; HALF], 0.0);
        for (j, weight) in columns {
            let column: Vec<(usize, f64)> = terms.iter().map(|&(i, w)| (i * n + j, w)).collect();
            let part = self.mix(block, &column, log_factor);
            sum.0.iter_mut().zip(part.0).for_each(|(s, p)| *s += weight * p);
            sum.1 += weight * part.1;
        }
        sum
    }

    /// First coefficients differ by many orders of magnitude along an axis, so their logarithms are interpolated, and the others as
    /// parts of them.
    fn mix(&self, block: &Block, terms: &[(usize, f64)], log_factor: f64) -> (Response, f64) {
        let (n, width, at) = (block.entries(), block.form.ratios(), self.start + block.offset);
        let word = |pair: &[u8]| f64::from(i16::from_le_bytes([pair[0], pair[1]]));
        let (mut steps, mut log, mut shift) = ([0.0; HALF], log_factor, 0.0);
        for &(i, w) in terms {
            let first = &self.bytes[at + 4 * i..at + 4 * i + 4];
            log += w * f64::from(f32::from_le_bytes([first[0], first[1], first[2], first[3]]));
            let begin = at + 4 * n + 2 * width * i;
            for (step, pair) in steps.iter_mut().zip(self.bytes[begin..begin + 2 * width].chunks_exact(2)) {
                *step += w * word(pair);
            }
            if block.form.shifted() {
                let begin = at + 4 * n + 2 * width * n + 2 * i;
                shift += w * word(&self.bytes[begin..begin + 2]) / STEPS * PI;
            }
        }
        let mut ratios = [0.0; HALF];
        ratios[0] = 1.0;
        let root: &Zh64 = &ROOTS;
        for ((l, place), step) in block.form.places().skip(1).zip(steps) {
            ratios[place] = step / STEPS * root[l];
        }
        let (first, shift) = (log.exp(), shift.clamp(0.0, PI));
        let mut out = ratios.map(|r| r * first);
        if block.form == Form::Lobe {
            let zh: Zh64 = std::array::from_fn(|l| out[l * (l + 1) / 2]);
            out = patch::lobe(&zh, patch::axis(shift));
        }
        (out, shift)
    }
}

/// sqrt(2 l + 1): the greatest that a coefficient can be as a part of the first one.
static ROOTS: LazyLock<Zh64> = LazyLock::new(|| std::array::from_fn(|l| ((2 * l + 1) as f64).sqrt()));

/// An entry of a block.
#[derive(Clone, Copy, Debug)]
pub struct Entry {
    /// Logarithm of the first coefficient.
    pub log: f64,
    /// Coefficients as parts of the first one: of a lobe about its own axis, of anything else about the way to the emitter.
    pub ratios: Response,
    /// Angle of the axis that fits best, radians.
    pub shift: f64,
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
    /// Axes; columns of g are the last.
    pub axes: Vec<Axis>,
    /// What of the entries counts.
    pub form: Form,
    /// Entries: coefficients with m >= 0, of lobes about their own axis.
    pub entries: Vec<Response>,
    /// What is to be added to the logarithms of entries, or none.
    pub logs: Vec<f64>,
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
            form: c.form,
            offset: data.len(),
        });
        let more = c.logs.iter().copied().chain(std::iter::repeat(0.0));
        data.extend(c.entries.iter().zip(more).flat_map(|(e, log)| ((e[0].ln() + log) as f32).to_le_bytes()));
        for e in &c.entries {
            for (l, place) in c.form.places().skip(1) {
                let ratio = e[place] / (e[0] * ((2 * l + 1) as f64).sqrt());
                let ratio = if ratio.is_finite() { ratio.clamp(-1.0, 1.0) } else { 0.0 };
                data.extend(((ratio * STEPS).round() as i16).to_le_bytes());
            }
        }
        data.extend(c.shifts.iter().flat_map(|s| ((s / PI * STEPS).round() as i16).to_le_bytes()));
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
        let axes = vec![Axis::Distance { first: 0.1, last: 10.0, n: 5, neighbours: 4 }];
        let entries = (0..5)
            .map(|i| {
                let mut e = [0.0; HALF];
                for l in 0..BANDS {
                    for m in 0..=l {
                        e[l * (l + 1) / 2 + m] = f64::from(i + 1) / (l + m + 1) as f64;
                    }
                }
                e
            })
            .collect();
        write(
            "test",
            &[Content {
                emitter: Emitter::Area,
                part: Part::Order(1),
                axes,
                form: Form::Full,
                entries,
                logs: vec![1.0; 5],
                shifts: vec![0.25; 5],
            }],
        )
    }

    #[test]
    fn what_is_written_is_read() {
        let tables = Tables::from_bytes(small()).expect("a file");
        let block = tables.block(Emitter::Area, Part::Order(1)).expect("the block");
        let entry = tables.entry(block, 3);
        assert!((entry.log - 4f64.ln() - 1.0).abs() < 1e-6);
        for l in 0..BANDS {
            for m in 0..=l {
                let v = entry.ratios[l * (l + 1) / 2 + m];
                assert!((v - 1.0 / (l + m + 1) as f64).abs() < 1e-4, "{l} {m} {v}");
            }
        }
        assert!((entry.shift - 0.25).abs() < 5e-5);
        assert!((block.place(1)[0] / 0.1 - 100f64.powf(0.25)).abs() < 1e-12);
        // The middle of the axis is a node.
        assert!((tables.interpolate(block, &[1.0], -1.0).0[0] - 3.0).abs() < 1e-5);
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
