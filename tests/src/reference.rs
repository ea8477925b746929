//! Bakes of other tools as textures, and figures that compare a bake of ours with them.

use std::{fs, io::Read, path::Path};

use glam::{DVec2, DVec3, Vec2};
use serde_json::Value;

use crate::baked::Triangle;

/// A texture of floats.
#[derive(Clone, Debug)]
pub struct Texels {
    /// Columns, rows, slices.
    pub size: [usize; 3],
    /// Red, green, blue; columns first, then rows, then slices.
    pub rgb: Vec<DVec3>,
}

impl Texels {
    /// Reads the first level of a KTX2 file of `B10G11R11_UFLOAT` or `E5B9G9R9_UFLOAT` texels, plain or packed by Zstandard.
    ///
    /// # Errors
    /// What is missing, broken or of another format.
    pub fn read(path: &Path) -> Result<Self, String> {
        let fault = |e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
        let bytes = fs::read(path).map_err(|e| fault(&e))?;
        let reader = ktx2::Reader::new(&bytes[..]).map_err(|e| fault(&e))?;
        let header = reader.header();
        let level = reader.levels().next().ok_or_else(|| fault(&"no level"))?;
        let mut data = Vec::new();
        match header.supercompression_scheme {
            None => data.extend_from_slice(level.data),
            Some(ktx2::SupercompressionScheme::Zstandard) => {
                let mut frame = ruzstd::decoding::StreamingDecoder::new(level.data).map_err(|e| fault(&e))?;
                frame.read_to_end(&mut data).map_err(|e| fault(&e))?;
            }
            Some(other) => return Err(fault(&format!("packed by {other:?}"))),
        }
        let unpack = match header.format {
            Some(ktx2::Format::B10G11R11_UFLOAT_PACK32) => small_floats,
            Some(ktx2::Format::E5B9G9R9_UFLOAT_PACK32) => shared_exponent,
            other => return Err(fault(&format!("texels of {other:?}"))),
        };
        let side = |n: u32| n.max(1) as usize;
        let size = [side(header.pixel_width), side(header.pixel_height), side(header.pixel_depth)];
        let words = data.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let rgb: Vec<DVec3> = words.map(unpack).collect();
        if rgb.len() != size.iter().product::<usize>() {
            return Err(fault(&format!("{} texels for {size:?}", rgb.len())));
        }
        Ok(Self { size, rgb })
    }

    /// One texel.
    #[must_use]
    pub fn get(&self, x: usize, y: usize, z: usize) -> DVec3 {
        self.rgb[(z * self.size[1] + y) * self.size[0] + x]
    }

    /// The first slice at texture coordinates, interpolated between texel centres as a GPU does.
    #[must_use]
    pub fn bilinear(&self, uv: Vec2) -> DVec3 {
        let size = DVec2::new(self.size[0] as f64, self.size[1] as f64);
        let at = (uv.as_dvec2() * size - 0.5).clamp(DVec2::ZERO, size - 1.0);
        let (low, part) = (at.floor(), at.fract());
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the texture")]
        let (x, y) = (low.x as usize, low.y as usize);
        let (x1, y1) = ((x + 1).min(self.size[0] - 1), (y + 1).min(self.size[1] - 1));
        let row = |y| self.get(x, y, 0).lerp(self.get(x1, y, 0), part.x);
        row(y).lerp(row(y1), part.y)
    }

    /// Every value put through `f`.
    #[must_use]
    pub fn map(mut self, f: impl Fn(f64) -> f64) -> Self {
        self.rgb.iter_mut().for_each(|v| *v = v.map(&f));
        self
    }
}

/// Two floats of 11 bits and one of 10, without signs: 5 bits of exponent each.
fn small_floats(word: u32) -> DVec3 {
    let float = |bits: u32, mantissa: u32| {
        let part = f64::from(bits & ((1 << mantissa) - 1)) / f64::from(1u32 << mantissa);
        match bits >> mantissa {
            0 => part * 2f64.powi(-14),
            e => (1.0 + part) * 2f64.powf(f64::from(e) - 15.0),
        }
    };
    DVec3::new(float(word & 0x7ff, 6), float(word >> 11 & 0x7ff, 6), float(word >> 22, 5))
}

/// Three mantissas of 9 bits and an exponent of 5.
fn shared_exponent(word: u32) -> DVec3 {
    let unit = 2f64.powf(f64::from(word >> 27) - 24.0);
    DVec3::from_array([word, word >> 9, word >> 18].map(|m| f64::from(m & 0x1ff) * unit))
}

/// Light from what the transfer function of sRGB made of it, continued beyond 1.
#[must_use]
pub fn from_srgb(v: f64) -> f64 {
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// A glTF document and its only buffer as one binary file.
///
/// # Errors
/// What cannot be written as JSON.
pub fn glb(document: &Value, buffer: &[u8]) -> Result<Vec<u8>, String> {
    let mut document = document.clone();
    if let Some(first) = document["buffers"][0].as_object_mut() {
        first.remove("uri");
    }
    let mut text = serde_json::to_vec(&document).map_err(|e| e.to_string())?;
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut buffer = buffer.to_vec();
    buffer.resize(buffer.len().next_multiple_of(4), 0);
    let length = |n: usize| u32::try_from(n).map(u32::to_le_bytes).map_err(|e| e.to_string());
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend(length(12 + 8 + text.len() + 8 + buffer.len())?);
    out.extend(length(text.len())?);
    out.extend(b"JSON");
    out.extend(text);
    out.extend(length(buffer.len())?);
    out.extend(b"BIN\0");
    out.extend(buffer);
    Ok(out)
}

/// Document and buffer of a binary file.
///
/// # Errors
/// What is broken.
pub fn parts(glb: &[u8]) -> Result<(Value, Vec<u8>), String> {
    let glb = gltf::Glb::from_slice(glb).map_err(|e| e.to_string())?;
    let document = serde_json::from_slice(&glb.json).map_err(|e| e.to_string())?;
    Ok((document, glb.bin.unwrap_or_default().into_owned()))
}

/// The same triangle in a file and in what a bake made of it.
#[derive(Clone, Debug)]
pub struct Twin {
    /// With the file's own texture coordinates.
    pub file: Triangle,
    /// With coordinates in the bake's atlas.
    pub baked: Triangle,
}

/// Pairs the triangles of every node, which a bake that keeps coordinates leaves in order.
///
/// # Panics
/// Where they differ in more than texture coordinates.
#[must_use]
pub fn twins(file: &[Triangle], baked: &[Triangle]) -> Vec<Twin> {
    let mut out = Vec::new();
    for node in file.iter().map(|t| &t.node).collect::<std::collections::BTreeSet<_>>() {
        let of =
            |all: &[Triangle]| -> Vec<Triangle> { all.iter().filter(|t| t.node == *node).cloned().collect() };
        let (file, baked) = (of(file), of(baked));
        // A node without a lightmap has no coordinates in the bake.
        if baked.is_empty() {
            continue;
        }
        assert_eq!(file.len(), baked.len(), "{node}");
        for (file, baked) in file.into_iter().zip(baked) {
            for (a, b) in file.positions.iter().zip(&baked.positions) {
                assert!((*a - *b).length() <= 1e-3 * a.length().max(1.0), "{node}: {a} is not {b}");
            }
            out.push(Twin { file, baked });
        }
    }
    out
}

impl Twin {
    /// `n * n` points spread evenly over the triangle: place, normal, the file's and the bake's coordinates, square metres.
    #[must_use]
    pub fn points(&self, n: u16) -> Vec<(DVec3, DVec3, Vec2, Vec2, f64)> {
        let p = self.file.positions.map(|p| p.as_dvec3());
        let cross = (p[1] - p[0]).cross(p[2] - p[0]);
        let area = 0.5 * cross.length() / f64::from(n).powi(2);
        let mut out = Vec::new();
        let side = f64::from(n);
        for a in 0..n {
            for b in 0..n - a {
                for third in [1.0, 2.0] {
                    // The second of each pair of small triangles lies beyond the long side for the last one.
                    if third > 1.0 && a + b + 1 == n {
                        continue;
                    }
                    let u = (f64::from(a) + third / 3.0) / side;
                    let v = (f64::from(b) + third / 3.0) / side;
                    let at = p[0] + (p[1] - p[0]) * u + (p[2] - p[0]) * v;
                    let uv = |t: &Triangle| {
                        let [o, x, y] = t.uvs.map(Vec2::as_dvec2);
                        (o + (x - o) * u + (y - o) * v).as_vec2()
                    };
                    out.push((at, cross.normalize_or_zero(), uv(&self.file), uv(&self.baked), area));
                }
            }
        }
        out
    }
}

/// One place in both bakes.
#[derive(Clone, Copy, Debug)]
pub struct Pair {
    /// Ours.
    pub ours: DVec3,
    /// The other tool's.
    pub reference: DVec3,
    /// What it counts for.
    pub weight: f64,
}

/// How two bakes differ.
#[derive(Clone, Copy, Debug)]
pub struct Agreement {
    /// The reference's mean over places and channels.
    pub mean: f64,
    /// The reference's mean over ours.
    pub scale: f64,
    /// The same by channel, divided by `scale`.
    pub channels: DVec3,
    /// Root of the mean square of what remains after scaling, over `mean`.
    pub rms: f64,
    /// Correlation over places and channels.
    pub correlation: f64,
    /// Weight of places where a channel differs by more than 5 % of `mean` after scaling, over that of all.
    pub beyond: f64,
}

impl Agreement {
    /// Compares after scaling ours so that the means are equal.
    #[must_use]
    pub fn of(pairs: &[Pair]) -> Self {
        let weight: f64 = pairs.iter().map(|p| p.weight).sum();
        let mean = |f: &dyn Fn(&Pair) -> DVec3| pairs.iter().map(|p| f(p) * p.weight).sum::<DVec3>() / weight;
        let (ours, reference) = (mean(&|p| p.ours), mean(&|p| p.reference));
        let scale = reference.element_sum() / ours.element_sum();
        let all = reference.element_sum() / 3.0;
        let left = |p: &Pair| p.ours * scale - p.reference;
        let centre = (ours.element_sum() / 3.0, all);
        let co = |a: &dyn Fn(&Pair) -> DVec3, b: &dyn Fn(&Pair) -> DVec3| {
            pairs.iter().map(|p| p.weight * a(p).dot(b(p))).sum::<f64>()
        };
        let (o, r) = (|p: &Pair| p.ours - centre.0, |p: &Pair| p.reference - centre.1);
        let far = |p: &&Pair| left(p).abs().max_element() > 0.05 * all;
        Self {
            mean: all,
            scale,
            channels: reference / ours / scale,
            rms: (co(&left, &left) / weight / 3.0).sqrt() / all,
            correlation: co(&o, &r) / (co(&o, &o) * co(&r, &r)).sqrt(),
            beyond: pairs.iter().filter(far).map(|p| p.weight).sum::<f64>() / weight,
        }
    }
}

impl std::fmt::Display for Agreement {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { mean, scale, channels: c, rms, correlation, beyond } = self;
        write!(
            f,
            "mean {mean:.4}, scale {scale:.5}, channels {:.3} {:.3} {:.3}, rms {:.1} %, correlation {correlation:.4}, \
             beyond 5 %: {:.1} %",
            c.x,
            c.y,
            c.z,
            100.0 * rms,
            100.0 * beyond
        )
    }
}

/// The factors x for which the sum over `rows` of (a . x - b)^2 is least, and the root of its mean.
#[must_use]
pub fn least_squares<const N: usize>(rows: &[([f64; N], f64)]) -> ([f64; N], f64) {
    let mut m = [[0.0; N]; N];
    let mut y = [0.0; N];
    for (a, b) in rows {
        for i in 0..N {
            y[i] += a[i] * b;
            for j in 0..N {
                m[i][j] += a[i] * a[j];
            }
        }
    }
    // The matrix is symmetric and positive: no pivots are needed.
    for i in 0..N {
        for k in i + 1..N {
            let f = m[k][i] / m[i][i];
            let pivot = m[i];
            m[k].iter_mut().zip(pivot).skip(i).for_each(|(m, p)| *m -= f * p);
            y[k] -= f * y[i];
        }
    }
    let mut x = [0.0; N];
    for i in (0..N).rev() {
        x[i] = (y[i] - (i + 1..N).map(|j| m[i][j] * x[j]).sum::<f64>()) / m[i][i];
    }
    let left = |(a, b): &([f64; N], f64)| a.iter().zip(&x).map(|(a, x)| a * x).sum::<f64>() - b;
    let sum: f64 = rows.iter().map(|r| left(r).powi(2)).sum();
    (x, (sum / rows.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packed_floats_are_read() {
        // One in each channel: exponent 15, mantissa 0; 1.5 with the highest bit of the mantissa.
        assert_eq!(small_floats(15 << 6 | 15 << 17 | 15 << 27), DVec3::ONE);
        assert_eq!(small_floats((15 << 6 | 32) | 16 << 17 | 1 << 22), DVec3::new(1.5, 2.0, 2f64.powi(-19)));
        assert_eq!(shared_exponent(16 << 27 | 256 | 128 << 9 | 1 << 18), DVec3::new(1.0, 0.5, 1.0 / 256.0));
    }

    #[test]
    fn factors_are_found() {
        let rows: Vec<_> = (0..9)
            .map(|i| {
                let t = f64::from(i);
                ([t, t * t, 1.0], 2.0 * t - 0.5 * t * t + 3.0)
            })
            .collect();
        let (x, rms) = least_squares(&rows);
        assert!(
            x.iter().zip([2.0, -0.5, 3.0]).all(|(x, w)| (x - w).abs() < 1e-9) && rms < 1e-9,
            "{x:?} {rms}"
        );
    }

    #[test]
    fn what_differs_by_a_factor_agrees() {
        let pair = |x: f64, f: f64| {
            let ours = DVec3::new(x, 2.0, 1.0);
            Pair { ours, reference: ours * f, weight: 1.0 + x }
        };
        let same: Vec<Pair> = (0..5).map(|i| pair(f64::from(i), 0.25)).collect();
        let a = Agreement::of(&same);
        assert!((a.scale - 0.25).abs() < 1e-12 && a.rms < 1e-12 && a.beyond == 0.0, "{a}");
        assert!((a.correlation - 1.0).abs() < 1e-12 && (a.channels - 1.0).length() < 1e-12, "{a}");
        let mut other = same;
        other[4].reference.x *= 1.5;
        let a = Agreement::of(&other);
        assert!(0.05 < a.rms && 0.0 < a.beyond && a.correlation < 1.0, "{a}");
    }

    #[test]
    fn points_fill_a_triangle() {
        let corners = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 3.0]].map(glam::Vec3::from);
        let t = Triangle { node: "t".into(), positions: corners, uvs: corners.map(|c| Vec2::new(c.x, c.z)) };
        let points = Twin { file: t.clone(), baked: t }.points(7);
        assert_eq!(points.len(), 49);
        assert!((points.iter().map(|p| p.4).sum::<f64>() - 3.0).abs() < 1e-9);
        let mean = points.iter().map(|p| p.0).sum::<DVec3>() / 49.0;
        assert!((mean - DVec3::new(2.0 / 3.0, 0.0, 1.0)).length() < 1e-9, "{mean}");
        assert!(points.iter().all(|p| (p.2 - p.3).length() == 0.0 && p.1.y.abs() == 1.0));
    }
}
