//! `EXT_meshopt_compression` and its successor `KHR_meshopt_compression`: checked before the decoder sees it.

use bytemuck::{cast_slice, pod_collect_to_vec};

/// How a buffer view is compressed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Compressed<'a> {
    /// `ATTRIBUTES`, `TRIANGLES` or `INDICES`.
    pub(crate) mode: &'a str,
    /// `NONE`, `OCTAHEDRAL`, `QUATERNION`, `EXPONENTIAL` or `COLOR`.
    pub(crate) filter: &'a str,
    /// Bytes per element after decoding.
    pub(crate) stride: usize,
    /// Elements.
    pub(crate) count: usize,
}

/// The densest stream the format allows: one control byte covers a block of up to 256 elements of
/// four bytes each.
const MOST_BYTES_PER_BYTE: usize = 1024;

#[derive(Clone)]
struct Vertex<const N: usize>([u32; N]);

impl<const N: usize> Default for Vertex<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

fn vertices<const N: usize>(data: &[u8], count: usize) -> Option<Vec<u8>> {
    let decoded = meshopt::decode_vertex_buffer::<Vertex<N>>(data, count).ok()?;
    // The words hold raw bytes, hence the native order.
    Some(decoded.iter().flat_map(|v| v.0).flat_map(u32::to_ne_bytes).collect())
}

macro_rules! by_words {
    ($words:expr, $data:expr, $count:expr; $($n:literal)*) => {
        match $words { $($n => vertices::<$n>($data, $count),)* _ => None }
    };
}

/// Decodes `data`. The error is half a sentence for a finding.
pub(crate) fn decode(data: &[u8], how: Compressed<'_>) -> Result<Vec<u8>, String> {
    let Compressed { mode, filter, stride, count } = how;
    let bytes = count.checked_mul(stride).ok_or("count times byteStride overflows")?;
    if data.len().saturating_mul(MOST_BYTES_PER_BYTE) < bytes {
        return Err(format!("{count} elements of {stride} bytes cannot come from {} bytes", data.len()));
    }
    let corrupt = || "the compressed data is damaged".to_owned();
    match mode {
        "ATTRIBUTES" => {
            if stride == 0 || 256 < stride || stride % 4 != 0 {
                return Err(format!("byteStride {stride} is not a multiple of 4 from 4 to 256"));
            }
            let raw = by_words!(stride / 4, data, count;
                1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32
                33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63 64)
            .ok_or_else(corrupt)?;
            unfilter(raw, filter, stride)
        }
        "TRIANGLES" | "INDICES" => {
            if mode == "TRIANGLES" && count % 3 != 0 {
                return Err(format!("{count} indices are not whole triangles"));
            }
            if filter != "NONE" {
                return Err(format!("filter {filter} does not go with mode {mode}"));
            }
            match (mode, stride) {
                ("TRIANGLES", 2) => {
                    meshopt::decode_index_buffer::<u16>(data, count).map(|v| cast_slice(&v).to_vec())
                }
                ("TRIANGLES", 4) => {
                    meshopt::decode_index_buffer::<u32>(data, count).map(|v| cast_slice(&v).to_vec())
                }
                (_, 2) => meshopt::decode_index_sequence::<u16>(data, count).map(|v| cast_slice(&v).to_vec()),
                (_, 4) => meshopt::decode_index_sequence::<u32>(data, count).map(|v| cast_slice(&v).to_vec()),
                _ => return Err(format!("byteStride {stride} of an index buffer is neither 2 nor 4")),
            }
            .map_err(|_| corrupt())
        }
        other => Err(format!("mode `{other}` is none of ATTRIBUTES, TRIANGLES, INDICES")),
    }
}

fn unfilter(raw: Vec<u8>, filter: &str, stride: usize) -> Result<Vec<u8>, String> {
    // `pod_collect_to_vec` copies into memory with the alignment the filters need.
    Ok(match (filter, stride) {
        ("NONE", _) => raw,
        ("OCTAHEDRAL", 4) => {
            let mut v: Vec<[i8; 4]> = pod_collect_to_vec(&raw);
            meshopt::decode_filter_oct(&mut v);
            cast_slice(&v).to_vec()
        }
        ("OCTAHEDRAL", 8) => {
            let mut v: Vec<[i16; 4]> = pod_collect_to_vec(&raw);
            meshopt::decode_filter_oct(&mut v);
            cast_slice(&v).to_vec()
        }
        ("QUATERNION", 8) => {
            let mut v: Vec<[i16; 4]> = pod_collect_to_vec(&raw);
            meshopt::decode_filter_quat(&mut v);
            cast_slice(&v).to_vec()
        }
        ("EXPONENTIAL", _) => {
            let mut v: Vec<[u32; 1]> = pod_collect_to_vec(&raw);
            meshopt::decode_filter_exp(&mut v);
            cast_slice(&v).to_vec()
        }
        ("COLOR", 4) => {
            let mut v: Vec<[u8; 4]> = pod_collect_to_vec(&raw);
            meshopt::decode_filter_color(&mut v);
            cast_slice(&v).to_vec()
        }
        ("COLOR", 8) => {
            let mut v: Vec<[u16; 4]> = pod_collect_to_vec(&raw);
            meshopt::decode_filter_color(&mut v);
            cast_slice(&v).to_vec()
        }
        _ => return Err(format!("filter `{filter}` with byteStride {stride} is not part of the format")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_and_indices_round_trip() {
        let vertices: Vec<[u16; 4]> = (0..300u16).map(|i| [i, i * 7, 1000 - i, 0]).collect();
        let data = meshopt::encode_vertex_buffer(&vertices).expect("encodes");
        let how = Compressed { mode: "ATTRIBUTES", filter: "NONE", stride: 8, count: 300 };
        assert_eq!(decode(&data, how), Ok(cast_slice(&vertices).to_vec()));
        let indices: Vec<u32> = (0..99).flat_map(|i| [i, i + 1, i + 2]).collect();
        let data = meshopt::encode_index_buffer(&indices, 300).expect("encodes");
        let how = Compressed { mode: "TRIANGLES", filter: "NONE", stride: 4, count: indices.len() };
        let back = decode(&data, how).expect("decodes");
        // The codec may rotate the corners of a triangle, so sums are compared.
        let back: Vec<u32> = pod_collect_to_vec(&back);
        let sums = |v: &[u32]| v.chunks(3).map(|t| t.iter().sum()).collect::<Vec<u32>>();
        assert_eq!(sums(&back), sums(&indices));
    }

    #[test]
    fn nonsense_is_refused() {
        let how = Compressed { mode: "ATTRIBUTES", filter: "NONE", stride: 8, count: 300 };
        assert!(decode(&[0xa0; 40], how).is_err(), "damaged");
        assert!(decode(&[], how).is_err(), "empty");
        assert!(decode(&[0xa0; 40], Compressed { count: 1 << 40, ..how }).is_err(), "huge");
        assert!(decode(&[0xa0; 40], Compressed { count: usize::MAX, ..how }).is_err(), "overflow");
        assert!(decode(&[0xa0; 40], Compressed { stride: 6, ..how }).is_err(), "odd stride");
        assert!(decode(&[0xe0; 40], Compressed { mode: "TRIANGLES", stride: 2, count: 4, ..how }).is_err());
        assert!(decode(&[0xe0; 40], Compressed { mode: "X", ..how }).is_err());
    }
}
