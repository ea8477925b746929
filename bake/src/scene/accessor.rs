//! Accessors: from views with strides, sparse parts and compression to tightly packed values.

use std::sync::Arc;

use serde_json::Value;

use super::{
    document::Document,
    meshopt::{self, Compressed},
    read::index_of,
};
use crate::error::Finding;

/// Zero-filled accessors (no buffer view) may take this much, plus a multiple of the file's size.
const FREE_BYTES: u64 = 64 << 20;

/// Shape of an element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One component.
    Scalar,
    /// Two components.
    Vec2,
    /// Three components.
    Vec3,
    /// Four components.
    Vec4,
    /// Four components, by columns.
    Mat2,
    /// Nine components, by columns.
    Mat3,
    /// Sixteen components, by columns.
    Mat4,
}

impl Kind {
    /// Components of an element.
    pub fn components(self) -> usize {
        self.columns() * self.rows()
    }

    /// The name in glTF, such as `VEC3`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Scalar => "SCALAR",
            Self::Vec2 => "VEC2",
            Self::Vec3 => "VEC3",
            Self::Vec4 => "VEC4",
            Self::Mat2 => "MAT2",
            Self::Mat3 => "MAT3",
            Self::Mat4 => "MAT4",
        }
    }

    fn parse(text: &str) -> Option<Self> {
        [Self::Scalar, Self::Vec2, Self::Vec3, Self::Vec4, Self::Mat2, Self::Mat3, Self::Mat4]
            .into_iter()
            .find(|k| k.name() == text)
    }

    fn columns(self) -> usize {
        match self {
            Self::Mat2 => 2,
            Self::Mat3 => 3,
            Self::Mat4 => 4,
            _ => 1,
        }
    }

    fn rows(self) -> usize {
        match self {
            Self::Scalar => 1,
            Self::Vec2 | Self::Mat2 => 2,
            Self::Vec3 | Self::Mat3 => 3,
            Self::Vec4 | Self::Mat4 => 4,
        }
    }
}

/// Values of an accessor, tightly packed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AccessorData {
    /// 5120 i8, 5121 u8, 5122 i16, 5123 u16, 5125 u32, 5126 f32.
    pub component_type: u32,
    /// Shape of an element.
    pub kind: Kind,
    /// Whether integers stand for fractions in [0, 1] or [-1, 1].
    pub normalized: bool,
    /// Elements.
    pub count: usize,
    /// `count * kind.components()` components, little-endian, no padding.
    pub bytes: Vec<u8>,
}

impl AccessorData {
    /// All components as numbers; normalised integers become fractions. Length `count * kind.components()`.
    pub fn floats(&self) -> Vec<f32> {
        let n = self.normalized;
        let scale = |v: f32, most: f32| if n { (v / most).max(-1.0) } else { v };
        let two = |c: &[u8]| [c[0], c[1]];
        let four = |c: &[u8]| [c[0], c[1], c[2], c[3]];
        #[expect(
            clippy::cast_precision_loss,
            reason = "32-bit integers are indices, which nobody reads as numbers"
        )]
        match self.component_type {
            5120 => self.bytes.iter().map(|b| scale(f32::from(b.cast_signed()), 127.0)).collect(),
            5121 => self.bytes.iter().map(|b| scale(f32::from(*b), 255.0)).collect(),
            5122 => {
                let read = |c| scale(f32::from(i16::from_le_bytes(two(c))), 32767.0);
                self.bytes.chunks_exact(2).map(read).collect()
            }
            5123 => {
                let read = |c| scale(f32::from(u16::from_le_bytes(two(c))), 65535.0);
                self.bytes.chunks_exact(2).map(read).collect()
            }
            5125 => self.bytes.chunks_exact(4).map(|c| u32::from_le_bytes(four(c)) as f32).collect(),
            _ => self.bytes.chunks_exact(4).map(|c| f32::from_le_bytes(four(c))).collect(),
        }
    }

    /// Unsigned integers as they are; `None` for signed and float components.
    pub fn unsigned(&self) -> Option<Vec<u32>> {
        match self.component_type {
            5121 => Some(self.bytes.iter().map(|b| u32::from(*b)).collect()),
            5123 => Some(
                self.bytes.chunks_exact(2).map(|c| u32::from(u16::from_le_bytes([c[0], c[1]]))).collect(),
            ),
            5125 => Some(
                self.bytes.chunks_exact(4).map(|c| u32::from_le_bytes([c[0], c[1], c[2], c[3]])).collect(),
            ),
            _ => None,
        }
    }
}

/// The bytes of a buffer view.
pub(super) struct View {
    data: Arc<[u8]>,
    start: usize,
    end: usize,
    stride: Option<usize>,
}

impl View {
    pub(super) fn bytes(&self) -> &[u8] {
        &self.data[self.start..self.end]
    }
}

fn component_size(component_type: usize) -> Option<usize> {
    match component_type {
        5120 | 5121 => Some(1),
        5122 | 5123 => Some(2),
        5125 | 5126 => Some(4),
        _ => None,
    }
}

/// Reads an integer property, `default` where it is absent.
fn integer(object: &Value, key: &str, path: &str, default: Option<usize>) -> Result<usize, Finding> {
    match object.get(key) {
        None => default.ok_or_else(|| bad(&format!("{path}.{key}"), "missing")),
        Some(v) => index_of(v).ok_or_else(|| {
            let shown: String = v.to_string().chars().take(40).collect();
            bad(&format!("{path}.{key}"), &format!("`{shown}` is not a non-negative integer"))
        }),
    }
}

fn bad(path: &str, what: &str) -> Finding {
    Finding::error(path, what, "the file is damaged or its exporter is at fault; export it again")
}

/// How elements lie in a view.
#[derive(Clone, Copy)]
struct Layout {
    kind: Kind,
    component: usize,
}

impl Layout {
    /// Bytes from the start of one column to the next: columns of matrices begin at multiples of four.
    fn column(self) -> usize {
        let size = self.kind.rows() * self.component;
        if self.kind.columns() == 1 { size } else { size.next_multiple_of(4) }
    }

    fn stored(self) -> usize {
        self.kind.columns() * self.column()
    }

    fn packed(self) -> usize {
        self.kind.components() * self.component
    }
}

impl Document {
    /// Values of `accessors[index]`: strides and padding removed, sparse parts applied,
    /// `EXT_meshopt_compression` decoded.
    ///
    /// # Errors
    /// A finding where any index, offset, type or size involved is bad; its path says which.
    pub fn accessor(&self, index: usize) -> Result<AccessorData, Finding> {
        let path = format!("accessors[{index}]");
        let json = self
            .json
            .get("accessors")
            .and_then(|a| a.get(index))
            .ok_or_else(|| bad(&path, "there is no such accessor"))?;
        let kind = json["type"].as_str().and_then(Kind::parse);
        let kind =
            kind.ok_or_else(|| bad(&format!("{path}.type"), "missing, or not a type that glTF has"))?;
        let component_type = integer(json, "componentType", &path, None)?;
        let component = component_size(component_type).ok_or_else(|| {
            bad(&format!("{path}.componentType"), &format!("{component_type} is not a component type"))
        })?;
        let normalized = match json.get("normalized") {
            None => false,
            Some(Value::Bool(b)) => *b,
            Some(_) => return Err(bad(&format!("{path}.normalized"), "neither true nor false")),
        };
        let count = integer(json, "count", &path, None)?;
        let layout = Layout { kind, component };
        let size = count.checked_mul(layout.packed());
        let size =
            size.ok_or_else(|| bad(&format!("{path}.count"), &format!("{count} elements overflow")))?;

        let mut bytes = if json.get("bufferView").is_some() {
            let offset = integer(json, "byteOffset", &path, Some(0))?;
            let view = self.view(integer(json, "bufferView", &path, None)?)?;
            gather(&view, offset, count, layout, &path)?
        } else {
            let limit = self.total_bytes().saturating_mul(16).saturating_add(FREE_BYTES);
            if limit < size as u64 {
                let what = format!("{count} elements without a bufferView would take {size} bytes of zeros");
                return Err(bad(&format!("{path}.count"), &what));
            }
            vec![0; size]
        };
        if let Some(sparse) = json.get("sparse") {
            self.overlay(sparse, &format!("{path}.sparse"), count, layout, &mut bytes)?;
        }
        #[expect(clippy::cast_possible_truncation, reason = "component_size admits 5120 to 5126 only")]
        let component_type = component_type as u32;
        Ok(AccessorData { component_type, kind, normalized: normalized && component < 4, count, bytes })
    }

    /// The bytes of `bufferViews[index]`, decompressed.
    pub(super) fn view(&self, index: usize) -> Result<View, Finding> {
        let path = format!("bufferViews[{index}]");
        let json = self
            .json
            .get("bufferViews")
            .and_then(|a| a.get(index))
            .ok_or_else(|| bad(&path, "there is no such buffer view"))?;
        let compressed = json.get("extensions").and_then(|e| {
            ["EXT_meshopt_compression", "KHR_meshopt_compression"].iter().find_map(|n| Some((*n, e.get(n)?)))
        });
        if let Some((name, extension)) = compressed {
            let cell =
                self.decoded_views.get(index).ok_or_else(|| bad(&path, "there is no such buffer view"))?;
            let path = format!("{path}.extensions.{name}");
            let data = cell.get_or_init(|| self.decompress(extension, &path)).clone()?;
            let stride = integer(extension, "byteStride", &path, None)?;
            let end = data.len();
            return Ok(View { data, start: 0, end, stride: Some(stride) });
        }
        let stride = match json.get("byteStride") {
            None => None,
            Some(_) => Some(integer(json, "byteStride", &path, None)?),
        };
        let (data, start, end) = self.slice(json, &path)?;
        Ok(View { data, start, end, stride })
    }

    /// Buffer and byte range that `json` (a view, or its compressed form) names.
    fn slice(&self, json: &Value, path: &str) -> Result<(Arc<[u8]>, usize, usize), Finding> {
        let buffer = integer(json, "buffer", path, None)?;
        let start = integer(json, "byteOffset", path, Some(0))?;
        let length = integer(json, "byteLength", path, None)?;
        let data = self
            .buffers
            .get(buffer)
            .ok_or_else(|| bad(&format!("{path}.buffer"), &format!("there is no buffer {buffer}")))?
            .clone()?;
        match start.checked_add(length) {
            Some(end) if end <= data.len() => Ok((data, start, end)),
            _ => {
                let what = format!(
                    "{length} bytes from {start} reach beyond the {} bytes of buffer {buffer}",
                    data.len()
                );
                Err(bad(path, &what))
            }
        }
    }

    fn decompress(&self, json: &Value, path: &str) -> Result<Arc<[u8]>, Finding> {
        let (data, start, end) = self.slice(json, path)?;
        let how = Compressed {
            mode: json["mode"].as_str().unwrap_or_default(),
            filter: json["filter"].as_str().unwrap_or("NONE"),
            stride: integer(json, "byteStride", path, None)?,
            count: integer(json, "count", path, None)?,
        };
        meshopt::decode(&data[start..end], how).map(Into::into).map_err(|what| bad(path, &what))
    }

    fn overlay(
        &self,
        json: &Value,
        path: &str,
        count: usize,
        layout: Layout,
        out: &mut [u8],
    ) -> Result<(), Finding> {
        let n = integer(json, "count", path, None)?;
        if count < n {
            return Err(bad(&format!("{path}.count"), &format!("{n} replaced elements of {count}")));
        }
        let (at, with) = (&json["indices"], &json["values"]);
        let (at_path, with_path) = (format!("{path}.indices"), format!("{path}.values"));
        let kind = integer(at, "componentType", &at_path, None)?;
        let component = match kind {
            5121 | 5123 | 5125 => component_size(kind).unwrap_or(4),
            _ => {
                return Err(bad(
                    &format!("{at_path}.componentType"),
                    &format!("{kind} is no unsigned integer type"),
                ));
            }
        };
        let view = self.view(integer(at, "bufferView", &at_path, None)?)?;
        let offset = integer(at, "byteOffset", &at_path, Some(0))?;
        let indices = gather(&view, offset, n, Layout { kind: Kind::Scalar, component }, &at_path)?;
        let view = self.view(integer(with, "bufferView", &with_path, None)?)?;
        let offset = integer(with, "byteOffset", &with_path, Some(0))?;
        let values = gather(&view, offset, n, layout, &with_path)?;
        let size = layout.packed();
        for (i, (index, value)) in indices.chunks_exact(component).zip(values.chunks_exact(size)).enumerate()
        {
            let index = index.iter().rev().fold(0usize, |sum, b| sum << 8 | usize::from(*b));
            let target = index.checked_mul(size).and_then(|at| out.get_mut(at..at + size));
            let target = target.ok_or_else(|| {
                bad(&at_path, &format!("entry {i} replaces element {index} of an accessor of {count}"))
            })?;
            target.copy_from_slice(value);
        }
        Ok(())
    }
}

/// Copies `count` elements out of a view.
fn gather(view: &View, offset: usize, count: usize, layout: Layout, path: &str) -> Result<Vec<u8>, Finding> {
    let bytes = view.bytes();
    let stored = layout.stored();
    let stride = view.stride.unwrap_or(stored);
    if count == 0 {
        return Ok(Vec::new());
    }
    if stride < stored {
        return Err(bad(path, &format!("elements of {stored} bytes overlap at a byteStride of {stride}")));
    }
    let end = (count - 1)
        .checked_mul(stride)
        .and_then(|n| n.checked_add(stored))
        .and_then(|n| n.checked_add(offset));
    if end.is_none_or(|end| bytes.len() < end) {
        let what = format!(
            "{count} elements of {stored} bytes, {stride} apart, from byte {offset} do not fit into the view's {} bytes",
            bytes.len()
        );
        return Err(bad(path, &what));
    }
    if stride == stored && stored == layout.packed() {
        return Ok(bytes[offset..offset + count * stored].to_vec());
    }
    let rows = layout.kind.rows() * layout.component;
    let mut out = Vec::with_capacity(count * layout.packed());
    for i in 0..count {
        let element = &bytes[offset + i * stride..][..stored];
        for column in element.chunks(layout.column()) {
            out.extend_from_slice(&column[..rows]);
        }
    }
    Ok(out)
}
