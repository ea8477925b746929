//! Unpacks what Blosc 1 has packed with LZ4, which is what OpenVDB asks of it.

use crate::scene::voxels::Unusable;

const HEAD: usize = 16;
/// Flags.
const SHUFFLED: u8 = 1;
const STORED: u8 = 2;
const BITS_SHUFFLED: u8 = 4;
const NOT_SPLIT: u8 = 16;
/// Names of codecs by their number.
const CODECS: [&str; 5] = ["BloscLZ", "LZ4", "Snappy", "zlib", "Zstandard"];
const LZ4: u8 = 1;
/// A block is split into the bytes of its elements if these are not larger than this, and are at least so many.
const LARGEST_SPLIT: usize = 16;
const LEAST_SPLIT: usize = 128;

/// Unpacks what has exactly the size of `out`.
///
/// # Errors
/// Where the data are damaged, or packed with another codec.
pub(super) fn unpack(packed: &[u8], out: &mut [u8]) -> Result<(), Unusable> {
    let head: &[u8; HEAD] = packed.first_chunk().ok_or_else(damaged)?;
    let (flags, element) = (head[2], usize::from(head[3]).max(1));
    let [size, block, all] = [4, 8, 12].map(|i| number(head, i));
    let packed = all.and_then(|all| packed.get(..all)).ok_or_else(damaged)?;
    if size != Some(out.len()) {
        return Err(damaged());
    }
    if flags & STORED != 0 {
        let stored = packed.get(HEAD..HEAD + out.len()).ok_or_else(damaged)?;
        out.copy_from_slice(stored);
        return Ok(());
    }
    let codec = flags >> 5;
    if codec != LZ4 || flags & BITS_SHUFFLED != 0 {
        let name = if codec == LZ4 {
            "shuffled bits"
        } else {
            CODECS.get(usize::from(codec)).unwrap_or(&"an unknown codec")
        };
        return Err(Unusable::new(
            format!("the file is packed by Blosc with {name}; LZ4 alone is supported"),
            "save it again with OpenVDB's own settings",
        ));
    }
    let block = block.filter(|b| *b != 0).ok_or_else(damaged)?;
    for (i, out) in out.chunks_mut(block).enumerate() {
        let start = number(packed, HEAD + 4 * i).ok_or_else(damaged)?;
        // A block at the end that is shorter is not split.
        let split = flags & NOT_SPLIT == 0
            && element <= LARGEST_SPLIT
            && LEAST_SPLIT <= block / element
            && out.len() == block;
        let parts = if split { element } else { 1 };
        if flags & SHUFFLED != 0 && 1 < element {
            let mut shuffled = vec![0; out.len()];
            parts_of(packed, start, parts, &mut shuffled)?;
            unshuffle(&shuffled, element, out);
        } else {
            parts_of(packed, start, parts, out)?;
        }
    }
    Ok(())
}

/// Unpacks the parts of a block that begins at `at`.
fn parts_of(packed: &[u8], mut at: usize, parts: usize, out: &mut [u8]) -> Result<(), Unusable> {
    let part = out.len() / parts;
    for out in out.chunks_mut(part.max(1)) {
        let count = number(packed, at).ok_or_else(damaged)?;
        at += 4;
        let data = at.checked_add(count).and_then(|end| packed.get(at..end)).ok_or_else(damaged)?;
        at += count;
        if count == out.len() {
            out.copy_from_slice(data);
        } else if lz4_flex::block::decompress_into(data, out).ok() != Some(out.len()) {
            return Err(damaged());
        }
    }
    Ok(())
}

/// Puts elements together whose first bytes come first, then their second ones, and so on.
fn unshuffle(shuffled: &[u8], element: usize, out: &mut [u8]) {
    let count = out.len() / element;
    let (whole, rest) = shuffled.split_at(count * element);
    for (byte, from) in whole.chunks_exact(count.max(1)).enumerate() {
        for (i, v) in from.iter().enumerate() {
            out[i * element + byte] = *v;
        }
    }
    out[count * element..].copy_from_slice(rest);
}

fn number(bytes: &[u8], at: usize) -> Option<usize> {
    let four = bytes.get(at..)?.first_chunk()?;
    usize::try_from(i32::from_le_bytes(*four)).ok()
}

fn damaged() -> Unusable {
    Unusable::new("the file's Blosc data are damaged", "export it again")
}
