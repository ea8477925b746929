//! Numbers of a glTF buffer, of any component type.

use anyhow::{Context, Result, ensure};
use gltf::accessor::DataType;

/// Elements of `N` numbers each; integers that are normalised become parts of one. Missing components are 0.
pub(super) fn floats<const N: usize>(accessor: &gltf::Accessor<'_>, blob: &[u8]) -> Result<Vec<[f32; N]>> {
    let of = accessor.dimensions().multiplicity();
    let number = |bytes: &[u8], i: usize| number(accessor.data_type(), accessor.normalized(), bytes, i);
    let element = |bytes: &[u8]| std::array::from_fn(|i| if i < of { number(bytes, i) } else { 0.0 });
    elements(accessor, blob, element)
}

/// Indices.
pub(super) fn indices(accessor: &gltf::Accessor<'_>, blob: &[u8]) -> Result<Vec<usize>> {
    let wide = accessor.data_type().size();
    elements(accessor, blob, |bytes| bytes[..wide].iter().rev().fold(0, |n, b| n << 8 | usize::from(*b)))
}

fn elements<T: Clone>(
    accessor: &gltf::Accessor<'_>,
    blob: &[u8],
    element: impl Fn(&[u8]) -> T,
) -> Result<Vec<T>> {
    let (n, size) = (accessor.count(), accessor.size());
    let what = || format!("accessor {}", accessor.index());
    let mut out = match accessor.view() {
        Some(view) => {
            let bytes = bytes(&view, blob).with_context(what)?;
            let stride = view.stride().unwrap_or(size);
            let end = accessor
                .offset()
                .checked_add(n.saturating_sub(1).saturating_mul(stride).saturating_add(size));
            ensure!(
                n == 0 || end.is_some_and(|end| end <= bytes.len()),
                "{}: it ends beyond its view",
                what()
            );
            (0..n).map(|i| element(&bytes[accessor.offset() + i * stride..])).collect()
        }
        // Zeros, into which sparse elements may be put.
        None => {
            ensure!(n <= MOST_ZEROS, "{}: {n} elements without a view", what());
            vec![element(&[0; 64]); n]
        }
    };
    if let Some(sparse) = accessor.sparse() {
        let (indices, values) = (sparse.indices(), sparse.values());
        let (at, new) = (bytes(&indices.view(), blob)?, bytes(&values.view(), blob)?);
        let wide = match indices.index_type() {
            gltf::accessor::sparse::IndexType::U8 => 1,
            gltf::accessor::sparse::IndexType::U16 => 2,
            gltf::accessor::sparse::IndexType::U32 => 4,
        };
        let (at, new) = (at.get(indices.offset()..), new.get(values.offset()..));
        let (at, new) = (at.with_context(what)?, new.with_context(what)?);
        let count = sparse.count();
        let fits = |each: usize, bytes: &[u8]| count.checked_mul(each).is_some_and(|n| n <= bytes.len());
        ensure!(fits(wide, at) && fits(size, new), "{}: sparse elements are cut off", what());
        for (i, v) in at.chunks_exact(wide).zip(new.chunks_exact(size)).take(count) {
            let i = i.iter().rev().fold(0, |n, b| n << 8 | usize::from(*b));
            *out.get_mut(i).with_context(|| format!("{}: there is no element {i}", what()))? = element(v);
        }
    }
    Ok(out)
}

/// Elements of accessors that no bytes stand for, at most.
const MOST_ZEROS: usize = 1 << 26;

/// The bytes of a view; those of `scene.glb` are all in its one buffer.
pub(super) fn bytes<'a>(view: &gltf::buffer::View<'_>, blob: &'a [u8]) -> Result<&'a [u8]> {
    let end = view.offset().checked_add(view.length());
    let part = end.and_then(|end| blob.get(view.offset()..end));
    part.with_context(|| format!("buffer view {} is cut off", view.index()))
}

fn number(kind: DataType, normalized: bool, bytes: &[u8], i: usize) -> f32 {
    let at = &bytes[i * kind.size()..];
    let (value, most) = match kind {
        DataType::F32 => return f32::from_le_bytes([at[0], at[1], at[2], at[3]]),
        DataType::U32 => return u32::from_le_bytes([at[0], at[1], at[2], at[3]]) as f32,
        DataType::I8 => (f32::from(i8::from_le_bytes([at[0]])), 127.0),
        DataType::U8 => (f32::from(at[0]), 255.0),
        DataType::I16 => (f32::from(i16::from_le_bytes([at[0], at[1]])), 32767.0),
        DataType::U16 => (f32::from(u16::from_le_bytes([at[0], at[1]])), 65535.0),
    };
    if normalized { (value / most).max(-1.0) } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_are_normalised_where_they_say_so() {
        let bytes = [0x80, 0xff, 0x00, 0x80];
        assert_eq!(number(DataType::I8, true, &bytes, 0), -1.0);
        assert_eq!(number(DataType::U8, true, &bytes, 1), 1.0);
        assert_eq!(number(DataType::U8, false, &bytes, 1), 255.0);
        assert_eq!(number(DataType::I16, true, &bytes, 1), -1.0);
        assert_eq!(number(DataType::U16, false, &bytes, 0), 65408.0);
    }
}
