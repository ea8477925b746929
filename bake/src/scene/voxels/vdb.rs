//! Reads OpenVDB files: one grid of floats, as it is laid out by versions 220 to 224 of the format.
//!
//! The crate `vdb-rs` 0.6 aborts the process on grids that are saved as half floats and allocates whatever a damaged file
//! asks for, so this reader is our own. It reads the tree of depth 5-4-3 (sides of 4096, 128 and 8 voxels) that every tool
//! writes, all its compressions, tiles, instances and linear transforms.
//!
//! Voxel i of a file is taken to reach from index i to i + 1, as in Blender and in the bounds of NanoVDB. Houdini has its
//! centre at i: half a voxel away.

mod blosc;
#[cfg(test)]
mod tests;

use super::{BRICK, SIDE, Sparse, Unusable, Voxels, within};
use flate2::read::ZlibDecoder;
use glam::{Affine3A, DAffine3, DMat3, DVec3, IVec3, ivec3, uvec3};
use half::f16;
use std::io::Read;

/// Begins every file.
const MAGIC: &[u8] = b" BDV\0\0\0\0";
/// Oldest and newest version of the format that is read.
const VERSIONS: [u32; 2] = [220, 224];
/// Since this version compression is a property of the grid, and nodes say how their inactive values are kept.
const NODE_COMPRESSION: u32 = 222;

/// Flags of compression.
const ZIP: u32 = 1;
const ACTIVE_MASK: u32 = 2;
const BLOSC: u32 = 4;

/// How a node's inactive values are kept, beside its active ones. 0 is for all at the background, 1 for all at minus that.
mod kept {
    pub(super) const ONE: u8 = 2;
    pub(super) const MASK_OF_BACKGROUNDS: u8 = 3;
    pub(super) const MASK_AND_ONE: u8 = 4;
    pub(super) const MASK_AND_TWO: u8 = 5;
    pub(super) const ALL: u8 = 6;
}

/// Sides of inner nodes as powers of two: in children, and of a child in voxels.
const UPPER: [u32; 2] = [5, 7];
const LOWER: [u32; 2] = [4, 3];

/// A grid as the file's list names it.
struct Entry {
    name: String,
    kind: String,
    /// Name of the grid whose tree this one shares; empty for most.
    parent: String,
    at: usize,
}

/// A grid's head: what is before its tree.
struct Head {
    compression: u32,
    class: String,
    /// `None` for one that is not affine, with the name of what it is.
    place: Result<DAffine3, String>,
    /// Where the tree begins.
    tree: usize,
}

/// How values of a tree are kept.
#[derive(Clone, Copy)]
struct Coding {
    version: u32,
    compression: u32,
    half: bool,
    background: f32,
}

/// A leaf whose values are yet to be read.
struct Leaf {
    /// Index of its first voxel.
    origin: IVec3,
    active: [u64; 8],
}

/// Reads a grid: the one of that name, or else `density`, or else the only one of floats.
///
/// # Errors
/// Where there is no such grid, it is a level set, has a background, negative densities or none at all, takes more than
/// `most_bytes` of memory, or the file is damaged.
pub fn read(file: &[u8], name: Option<&str>, most_bytes: usize) -> Result<Voxels, Unusable> {
    let mut bytes = Bytes { all: file, at: 0 };
    if bytes.take(MAGIC.len(), "its head").ok() != Some(MAGIC) {
        return Err(Unusable::new("this is no OpenVDB file", "name a .vdb file"));
    }
    let version = bytes.u32()?;
    if version < VERSIONS[0] || VERSIONS[1] < version {
        return Err(Unusable::new(
            format!(
                "the file has version {version} of the format; {} to {} are read",
                VERSIONS[0], VERSIONS[1]
            ),
            "save it again with OpenVDB 2 to 12",
        ));
    }
    bytes.take(8, "its head")?;
    let seekable = bytes.u8()? != 0;
    let mut compression = 0;
    if version < NODE_COMPRESSION {
        compression = if bytes.u8()? == 0 { 0 } else { ZIP };
    }
    bytes.take(36, "its head")?;
    bytes.metadata()?;
    let mut file = File { bytes, version, compression, seekable, entries: Vec::new() };
    let number = file.choose(name)?;
    file.grid(number, most_bytes)
}

struct File<'a> {
    bytes: Bytes<'a>,
    version: u32,
    /// Of the whole file, before [`NODE_COMPRESSION`].
    compression: u32,
    /// Whether entries tell where the next one is.
    seekable: bool,
    entries: Vec<Entry>,
}

impl File<'_> {
    /// Reads the list of grids and chooses one.
    fn choose(&mut self, name: Option<&str>) -> Result<usize, Unusable> {
        let count = self.bytes.u32()?;
        for _ in 0..count {
            let name = self.bytes.text()?;
            let kind = self.bytes.text()?;
            let parent = self.bytes.text()?;
            self.bytes.take(16, "the list of grids")?;
            let end = self.bytes.u64()?;
            let at = self.bytes.at;
            self.entries.push(Entry { name, kind, parent, at });
            if self.entries.len() == count as usize {
                break;
            }
            if self.seekable {
                self.bytes.at = usize::try_from(end).ok().filter(|e| at <= *e).ok_or_else(damaged)?;
            } else {
                // The next one begins where this one's values end.
                self.skip(self.entries.len() - 1)?;
            }
        }
        let floats: Vec<usize> =
            (0..self.entries.len()).filter(|i| self.entries[*i].half().is_some()).collect();
        let called = |wanted: &str| self.entries.iter().position(|e| e.plain_name() == wanted);
        let list = || {
            let all = self.entries.iter().map(|e| format!("`{}` ({})", e.plain_name(), e.kind_in_words()));
            all.collect::<Vec<_>>().join(", ")
        };
        let found = match name {
            Some(name) => called(name).ok_or_else(|| {
                Unusable::new(
                    format!("there is no grid `{name}` in the file, which has: {}", list()),
                    "name one of these",
                )
            })?,
            None => match (called("density"), floats.as_slice()) {
                (Some(i), _) | (None, &[i]) => i,
                (None, []) => {
                    return Err(Unusable::new(
                        format!("there is no grid of floats in the file, which has: {}", list()),
                        "export the density as a grid of floats",
                    ));
                }
                _ => {
                    return Err(Unusable::new(
                        format!("none of the file's grids is called `density`: {}", list()),
                        "name the grid",
                    ));
                }
            },
        };
        let entry = &self.entries[found];
        if entry.half().is_none() {
            return Err(Unusable::new(
                format!("the grid `{}` is one of {}", entry.plain_name(), entry.kind_in_words()),
                "name a grid of floats, or export the density as one",
            ));
        }
        Ok(found)
    }

    /// Goes to the end of a grid in a file that does not say where that is.
    fn skip(&mut self, number: usize) -> Result<(), Unusable> {
        let head = self.head(number)?;
        let entry = &self.entries[number];
        if !entry.parent.is_empty() {
            return Ok(());
        }
        let Some(half) = entry.half() else {
            return Err(Unusable::new(
                format!(
                    "the file was written as a stream, in which a grid of {} cannot be passed over",
                    entry.kind_in_words()
                ),
                "save it again as a file, or without that grid",
            ));
        };
        let mut coding =
            Coding { version: self.version, compression: head.compression, half, background: 0.0 };
        self.bytes.at = head.tree;
        let leaves = self.bytes.topology(&mut coding, &mut |_, _, _, _| Ok(()))?;
        for leaf in &leaves {
            self.bytes.leaf(coding, leaf)?;
        }
        Ok(())
    }

    /// Reads what is before a grid's tree.
    fn head(&mut self, number: usize) -> Result<Head, Unusable> {
        self.bytes.at = self.entries[number].at;
        let compression =
            if self.version < NODE_COMPRESSION { self.compression } else { self.bytes.u32()? };
        if compression & !(ZIP | ACTIVE_MASK | BLOSC) != 0 {
            return Err(Unusable::new(
                format!("the file's compression {compression:#x} is not known"),
                "save it again with zip, Blosc or no compression",
            ));
        }
        let class = self.bytes.metadata()?;
        let place = self.bytes.transform()?;
        Ok(Head { compression, class, place, tree: self.bytes.at })
    }

    /// Reads a grid.
    fn grid(&mut self, number: usize, most_bytes: usize) -> Result<Voxels, Unusable> {
        let own = self.head(number)?;
        let name = self.entries[number].plain_name().to_owned();
        let tree = match self.entries[number].parent.as_str() {
            "" => number,
            parent => {
                let of = |e: &Entry| e.name == parent && e.parent.is_empty() && e.half().is_some();
                self.entries.iter().position(of).ok_or_else(|| {
                    Unusable::new(
                        format!(
                            "the grid `{name}` has the voxels of `{}`, which is not there",
                            plain(parent)
                        ),
                        "export the grid again",
                    )
                })?
            }
        };
        if own.class == "level set" {
            return Err(Unusable::new(
                format!("the grid `{name}` is a level set: distances to a surface, not densities"),
                "convert it to a fog volume with vdb_tool (-ls2fog) or Houdini (Convert VDB)",
            ));
        }
        let place = own.place.map_err(|kind| {
            Unusable::new(
                format!(
                    "the grid `{name}` has a transform of the kind {kind}; only affine ones are supported"
                ),
                "resample it to a grid without perspective",
            )
        })?;
        let usable = place.is_finite() && place.matrix3.determinant() != 0.0;
        if !usable {
            return Err(Unusable::new(
                format!("the grid `{name}` has a transform without volume"),
                "export the grid again",
            ));
        }
        let head = self.head(tree)?;
        let half = self.entries[tree].half().ok_or_else(damaged)?;
        let mut coding =
            Coding { version: self.version, compression: head.compression, half, background: 0.0 };
        let mut grid = Sparse::new(most_bytes);
        self.bytes.at = head.tree;
        let leaves = self.bytes.topology(&mut coding, &mut |origin, side, value, active| {
            if active {
                grid.hold(origin, origin.saturating_add(IVec3::splat(side - 1)));
            }
            grid.cube(origin >> 3, side.unsigned_abs() / SIDE, value)
        })?;
        if coding.background != 0.0 {
            return Err(Unusable::new(
                format!(
                    "the grid `{name}` has the background {}, which would go on for ever",
                    coding.background
                ),
                "set its background to 0",
            ));
        }
        grid.expect(leaves.len())?;
        for leaf in &leaves {
            let values = self.bytes.leaf(coding, leaf)?;
            if let Some((first, last)) = extent(&leaf.active) {
                grid.hold(leaf.origin + first, leaf.origin + last);
            }
            grid.brick(leaf.origin >> 3, &values)?;
        }
        grid.finish(|first| Some(narrow(place * DAffine3::from_translation(first.as_dvec3()))))
    }
}

impl Entry {
    /// Whether values are saved as half floats; `None` if this is not a tree of floats.
    fn half(&self) -> Option<bool> {
        match self.kind.as_str() {
            "Tree_float_5_4_3" => Some(false),
            "Tree_float_5_4_3_HalfFloat" => Some(true),
            _ => None,
        }
    }

    fn plain_name(&self) -> &str {
        plain(&self.name)
    }

    /// What the values are, such as `vec3s`.
    fn kind_in_words(&self) -> &str {
        let kind = self.kind.strip_prefix("Tree_").unwrap_or(&self.kind);
        match kind.split_once("_5_4_3") {
            Some((kind, _)) => kind,
            None => kind,
        }
    }
}

/// A name without the number that tells grids of one name apart.
fn plain(name: &str) -> &str {
    name.split('\u{1e}').next().unwrap_or(name)
}

fn damaged() -> Unusable {
    Unusable::new("the file is damaged", "export it again")
}

#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
fn narrow(place: DAffine3) -> Affine3A {
    let columns = place.to_cols_array().map(|v| v as f32);
    Affine3A::from_cols_array(&columns)
}

/// First and last of the voxels that are in a leaf's mask.
fn extent(mask: &[u64; 8]) -> Option<(IVec3, IVec3)> {
    let any = mask.iter().fold(0, |a, b| a | b);
    if any == 0 {
        return None;
    }
    // Words follow x, bytes y, bits z.
    let columns = any.to_le_bytes();
    let row = columns.iter().fold(0, |a, b| a | b);
    let ends = |held: &dyn Fn(i32) -> bool| ((0..8).find(|i| held(*i)), (0..8).rfind(|i| held(*i)));
    let x = ends(&|i| mask[i as usize] != 0);
    let y = ends(&|i| columns[i as usize] != 0);
    let z = ends(&|i| row >> i & 1 != 0);
    Some((ivec3(x.0?, y.0?, z.0?), ivec3(x.1?, y.1?, z.1?)))
}

/// A file's bytes, read from front to back.
struct Bytes<'a> {
    all: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], Unusable> {
        let end = self.at.checked_add(count);
        let taken = end.and_then(|end| self.all.get(self.at..end)).ok_or_else(|| {
            Unusable::new(
                format!("the file ends within {what}: it has {} bytes", self.all.len()),
                "copy or export it again",
            )
        })?;
        self.at += count;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, what: &str) -> Result<[u8; N], Unusable> {
        self.take(N, what)?.try_into().map_err(|_| damaged())
    }

    fn u8(&mut self) -> Result<u8, Unusable> {
        Ok(self.array::<1>("a number")?[0])
    }

    fn u32(&mut self) -> Result<u32, Unusable> {
        self.array("a number").map(u32::from_le_bytes)
    }

    fn i32(&mut self) -> Result<i32, Unusable> {
        self.array("a number").map(i32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64, Unusable> {
        self.array("a number").map(u64::from_le_bytes)
    }

    fn f32(&mut self) -> Result<f32, Unusable> {
        self.array("a number").map(f32::from_le_bytes)
    }

    fn vector(&mut self) -> Result<DVec3, Unusable> {
        let mut v = [0.0; 3];
        for c in &mut v {
            *c = f64::from_le_bytes(self.array("a transform")?);
        }
        Ok(v.into())
    }

    /// A count of bytes, and these.
    fn block(&mut self, what: &str) -> Result<&'a [u8], Unusable> {
        let count = self.u32()?;
        self.take(count as usize, what)
    }

    fn text(&mut self) -> Result<String, Unusable> {
        Ok(String::from_utf8_lossy(self.block("a name")?).into_owned())
    }

    /// Passes over metadata; gives the class of the grid if it is among them.
    fn metadata(&mut self) -> Result<String, Unusable> {
        let mut class = String::new();
        for _ in 0..self.u32()? {
            let name = self.text()?;
            self.text()?;
            let value = self.block("metadata")?;
            if name == "class" {
                class = String::from_utf8_lossy(value).into_owned();
            }
        }
        Ok(class)
    }

    /// What leads from indices to the file's world, or the name of what is not affine.
    fn transform(&mut self) -> Result<Result<DAffine3, String>, Unusable> {
        let kind = self.text()?;
        Ok(Ok(match kind.as_str() {
            "ScaleMap" | "UniformScaleMap" => {
                let scale = self.vector()?;
                // Further vectors follow from this one.
                self.take(4 * 24, "a transform")?;
                DAffine3::from_scale(scale)
            }
            "ScaleTranslateMap" | "UniformScaleTranslateMap" => {
                let (translation, scale) = (self.vector()?, self.vector()?);
                self.take(4 * 24, "a transform")?;
                DAffine3 { matrix3: DMat3::from_diagonal(scale), translation }
            }
            "TranslationMap" => DAffine3::from_translation(self.vector()?),
            "AffineMap" | "UnitaryMap" => {
                // Rows of four numbers, the last of which follows; vectors multiply from the left.
                let mut rows = [DVec3::ZERO; 4];
                for row in &mut rows {
                    *row = self.vector()?;
                    self.take(8, "a transform")?;
                }
                DAffine3::from_cols(rows[0], rows[1], rows[2], rows[3])
            }
            _ => return Ok(Err(kind)),
        }))
    }

    /// Reads all of a tree but its leaves' values. Calls `tile` with first voxel, side in voxels, value and activity of each
    /// tile that is active or not 0.
    fn topology(
        &mut self,
        coding: &mut Coding,
        tile: &mut impl FnMut(IVec3, i32, f32, bool) -> Result<(), Unusable>,
    ) -> Result<Vec<Leaf>, Unusable> {
        // Buffers, of which there is one.
        self.u32()?;
        coding.background = self.f32()?;
        let (tiles, children) = (self.u32()?, self.u32()?);
        let mut leaves = Vec::new();
        for _ in 0..tiles {
            let origin = self.origin()?;
            let value = self.f32()?;
            let active = self.u8()? != 0;
            if active || value != 0.0 {
                tile(origin, 1 << (UPPER[0] + UPPER[1]), value, active)?;
            }
        }
        for _ in 0..children {
            let origin = self.origin()?;
            for place in self.node(UPPER, origin, *coding, tile)? {
                for origin in self.node(LOWER, place, *coding, tile)? {
                    let mut active = [0; 8];
                    for word in &mut active {
                        *word = self.u64()?;
                    }
                    leaves.push(Leaf { origin, active });
                }
            }
        }
        Ok(leaves)
    }

    /// First voxel of a child of the root.
    fn origin(&mut self) -> Result<IVec3, Unusable> {
        let origin = ivec3(self.i32()?, self.i32()?, self.i32()?);
        let side = 1 << (UPPER[0] + UPPER[1]);
        if origin % side == IVec3::ZERO { Ok(origin) } else { Err(damaged()) }
    }

    /// Reads an inner node, whose tiles `tile` gets; gives where its children begin.
    fn node(
        &mut self,
        [log_side, log_child]: [u32; 2],
        origin: IVec3,
        coding: Coding,
        tile: &mut impl FnMut(IVec3, i32, f32, bool) -> Result<(), Unusable>,
    ) -> Result<Vec<IVec3>, Unusable> {
        let count = 1usize << (3 * log_side);
        let children = self.mask(count)?;
        let active = self.mask(count)?;
        let is = |mask: &[u64], i: usize| mask[i / 64] >> (i % 64) & 1 != 0;
        let tiles = count - children.iter().map(|w| w.count_ones() as usize).sum::<usize>();
        // Values for children, too, since nodes are compressed.
        let kept = if coding.version < NODE_COMPRESSION { tiles } else { count };
        let mut values = vec![0.0; kept];
        self.values(coding, &active, &mut values)?;
        let mut values = values.into_iter();
        let mut places = Vec::new();
        for i in 0..count {
            let last = (1 << log_side) - 1;
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_possible_wrap,
                reason = "below the side of the node"
            )]
            let along = |axis: u32| (i >> (axis * log_side)) as i32 & last;
            let at = ivec3(along(2), along(1), along(0));
            let place = origin + (at << log_child);
            let child = is(&children, i);
            let value = if child && kept < count { None } else { values.next() };
            if child {
                places.push(place);
            } else if let Some(value) = value
                && (value != 0.0 || is(&active, i))
            {
                tile(place, 1 << log_child, value, is(&active, i))?;
            }
        }
        Ok(places)
    }

    fn mask(&mut self, count: usize) -> Result<Vec<u64>, Unusable> {
        let words = self.take(count / 8, "the tree")?.as_chunks::<8>().0;
        Ok(words.iter().map(|w| u64::from_le_bytes(*w)).collect())
    }

    /// Reads a leaf's values.
    fn leaf(&mut self, coding: Coding, leaf: &Leaf) -> Result<[f32; BRICK], Unusable> {
        // Its mask once more.
        self.take(64, "values")?;
        let mut buffers = 1;
        if coding.version < NODE_COMPRESSION {
            self.take(12, "values")?;
            buffers = self.u8()?;
        }
        let mut values = [0.0; BRICK];
        self.values(coding, &leaf.active, &mut values)?;
        for _ in 1..buffers {
            self.floats(coding, &mut [0.0; BRICK])?;
        }
        let mut turned = [0.0; BRICK];
        for (i, v) in (0..).zip(values) {
            // The file has z fastest, then y, then x.
            turned[within(uvec3(i >> 6, i >> 3 & 7, i & 7))] = v;
        }
        Ok(turned)
    }

    /// Reads the values of a node.
    fn values(&mut self, coding: Coding, active: &[u64], out: &mut [f32]) -> Result<(), Unusable> {
        let kept = if coding.version < NODE_COMPRESSION { kept::ALL } else { self.u8()? };
        if kept::ALL < kept {
            return Err(damaged());
        }
        let mut first = if kept == 0 { coding.background } else { -coding.background };
        let mut second = coding.background;
        if matches!(kept, kept::ONE | kept::MASK_AND_ONE | kept::MASK_AND_TWO) {
            first = self.f32()?;
        }
        if kept == kept::MASK_AND_TWO {
            second = self.f32()?;
        }
        let masked = matches!(kept, kept::MASK_OF_BACKGROUNDS | kept::MASK_AND_ONE | kept::MASK_AND_TWO);
        let seconds = if masked { self.mask(64 * active.len())? } else { Vec::new() };
        if coding.compression & ACTIVE_MASK == 0 || kept == kept::ALL {
            return self.floats(coding, out);
        }
        let count = active.iter().map(|w| w.count_ones() as usize).sum();
        let mut some = vec![0.0; count];
        self.floats(coding, &mut some)?;
        let mut some = some.into_iter();
        for (i, v) in out.iter_mut().enumerate() {
            let is = |mask: &[u64]| mask.get(i / 64).is_some_and(|w| w >> (i % 64) & 1 != 0);
            *v = match is(active).then(|| some.next()).flatten() {
                Some(v) => v,
                None if is(&seconds) => second,
                None => first,
            };
        }
        Ok(())
    }

    /// Reads as many numbers as there is room for.
    fn floats(&mut self, coding: Coding, out: &mut [f32]) -> Result<(), Unusable> {
        if coding.half && out.is_empty() {
            // Nothing was written, not even its size.
            return Ok(());
        }
        let size = out.len() * if coding.half { 2 } else { 4 };
        let mut unpacked;
        let data = if coding.compression & (ZIP | BLOSC) == 0 {
            self.take(size, "values")?
        } else {
            // What does not get smaller is stored as it is, under its size with a minus.
            let count = self.u64()?.cast_signed();
            let packed =
                self.take(usize::try_from(count.unsigned_abs()).map_err(|_| damaged())?, "values")?;
            if count <= 0 {
                packed
            } else {
                unpacked = vec![0; size];
                if coding.compression & BLOSC == 0 {
                    inflate(packed, &mut unpacked)?;
                } else {
                    blosc::unpack(packed, &mut unpacked)?;
                }
                &unpacked
            }
        };
        if data.len() != size {
            return Err(damaged());
        }
        if coding.half {
            let halves = data.as_chunks::<2>().0;
            out.iter_mut().zip(halves).for_each(|(v, b)| *v = f16::from_le_bytes(*b).to_f32());
        } else {
            let floats = data.as_chunks::<4>().0;
            out.iter_mut().zip(floats).for_each(|(v, b)| *v = f32::from_le_bytes(*b));
        }
        Ok(())
    }
}

/// Inflates what has exactly the size of `out`.
fn inflate(packed: &[u8], out: &mut [u8]) -> Result<(), Unusable> {
    let mut decoder = ZlibDecoder::new(packed);
    decoder.read_exact(out).map_err(|_| damaged())?;
    // To the end, where the sum is checked.
    if decoder.read(&mut [0]).is_ok_and(|more| more == 0) { Ok(()) } else { Err(damaged()) }
}
