//! `probes.bin`: a [`ProbeVolume`] as arrays that can be uploaded as they are.
//!
//! Little-endian, every value four bytes wide. A header of 16 words: the text `BAKEPRB1`, version, basis
//! (0 `l1`, 1 `l2`, 2 `l3`, 3 `zh3`), coefficients n, the lattice's size along x, y and z, its levels, its spacing in metres (f32), its first corner (3 f32),
//! and the numbers of bricks, occlusions and probes. Behind it, each array after the one before:
//!
//! | array | elements | of |
//! |---|---|---|
//! | index | size x * y * z | u32: brick or `0xffffffff` |
//! | bricks | bricks | 193 u32: corner x, y, z, level, 125 probes, 64 occlusions or `0xffffffff` |
//! | occlusions | occlusions | 4 planes (4 f32), 16 regions of 8 u8, 16 u32: 256 bytes |
//! | positions | probes | 3 f32 and validity |
//! | light | probes | n times 3 f32, red, green and blue of each coefficient |
//! | figures | probes | 2 f32: standard error of the mean luminance, window |
//!
//! and 32 bytes of BLAKE3 of all before them. How a place is looked up is said by [`ProbeVolume::weights`]; in WGSL, with the
//! arrays as storage buffers (`light` an array of f32) and `L2` light:
//!
//! ```wgsl
//! // `origin`, `spacing`, `size`: uniforms from the header; `index`, `bricks`, `occlusions`: array<u32>, `light`: array<f32>, all in storage.
//! // E / pi at `p` for the normal `n`, nits, not negative.
//! fn probes(p: vec3f, n: vec3f) -> vec3f {
//!     let inside = p - origin;
//!     let at = clamp(inside / spacing, vec3f(0), vec3f(4u * size));
//!     let b = min(vec3u(at / 4.0), size - 1u);
//!     let brick = index[(b.z * size.y + b.y) * size.x + b.x];
//!     if brick == 0xffffffffu { return vec3f(0); }
//!     let base = brick * 193u;
//!     let corner = vec3f(f32(bricks[base]), f32(bricks[base + 1u]), f32(bricks[base + 2u]));
//!     let local = (at - corner) / f32(1u << bricks[base + 3u]);
//!     let cell = min(vec3u(local), vec3u(3));
//!     let part = clamp(local - vec3f(cell), vec3f(0), vec3f(1));
//!     let occlusion = bricks[base + 129u + (cell.z * 4u + cell.y) * 4u + cell.x];
//!     var region = 0u;
//!     if occlusion != 0xffffffffu {
//!         for (var k = 0u; k < 4u; k++) {
//!             let o = occlusion * 64u + 4u * k;
//!             let plane = vec4f(bitcast<f32>(occlusions[o]), bitcast<f32>(occlusions[o + 1u]),
//!                 bitcast<f32>(occlusions[o + 2u]), bitcast<f32>(occlusions[o + 3u]));
//!             region |= select(0u, 1u, plane.w < dot(plane.xyz, inside)) << k;
//!         }
//!         let own = occlusions[occlusion * 64u + 48u + region];
//!         if own != 0xffffffffu { return irradiance(own, n); }
//!     }
//!     var sum = vec3f(0); var weights = 0.0;
//!     for (var k = 0u; k < 8u; k++) {
//!         let far = vec3u(k & 1u, (k >> 1u) & 1u, k >> 2u);
//!         let side = select(1.0 - part, part, far == vec3u(1));
//!         var w = side.x * side.y * side.z;
//!         if occlusion != 0xffffffffu {
//!             let bytes = occlusions[occlusion * 64u + 16u + region * 2u + k / 4u];
//!             w = max(w, 1e-4) * f32((bytes >> (8u * (k % 4u))) & 255u);
//!         }
//!         let node = cell + far;
//!         if 0.0 < w { sum += w * irradiance(bricks[base + 4u + (node.z * 5u + node.y) * 5u + node.x], n); weights += w; }
//!     }
//!     return sum / max(weights, 1e-6);
//! }
//! fn irradiance(probe: u32, n: vec3f) -> vec3f {
//!     var y = array<f32, 9>(0.282095, 0.325735 * n.y, 0.325735 * n.z, 0.325735 * n.x, 0.273137 * n.x * n.y,
//!         0.273137 * n.y * n.z, 0.078848 * (3.0 * n.z * n.z - 1.0), 0.273137 * n.x * n.z,
//!         0.136569 * (n.x * n.x - n.y * n.y));
//!     var sum = vec3f(0);
//!     for (var i = 0u; i < 9u; i++) { let o = probe * 27u + 3u * i; sum += y[i] * vec3f(light[o], light[o + 1u], light[o + 2u]); }
//!     return max(vec3f(0), sum);
//! }
//! ```
//!
//! A place on a surface is asked for a little in front of it, a hundredth of a cell along its normal.

use super::light::{Basis, Light};
use super::volume::{
    Brick, CELLS, CORNERS, Lattice, NODES, NONE, Occlusion, PLANES, Probe, ProbeVolume, REGIONS,
};

/// Name of the file in a bake's folder.
pub const FILE_NAME: &str = "probes.bin";

/// What this release writes, and the newest that it reads.
pub const FORMAT_VERSION: u32 = 1;

const MAGIC: [u8; 8] = *b"BAKEPRB1";

/// Bytes of BLAKE3 at the end.
const CHECKSUM: usize = 32;

/// Why a file cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProbeFileError {
    /// Another kind of file.
    #[error("not a probe file: it does not begin with BAKEPRB1")]
    Format,
    /// Written by a later release.
    #[error("version {0} is newer than {FORMAT_VERSION}, the newest this release reads: update the tool")]
    Newer(u32),
    /// Shorter or longer than its own numbers say, or changed since it was written.
    #[error("damaged at byte {at}: {what}")]
    Damaged {
        /// Where.
        at: usize,
        /// What is wrong there.
        what: &'static str,
    },
}

impl ProbeVolume {
    /// The bytes of `probes.bin`.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "fewer bricks and probes than 2^32")]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut out = Writer(MAGIC.to_vec());
        let l = &self.lattice;
        let basis = Basis::ALL.iter().position(|b| *b == self.basis).unwrap_or_default();
        out.words([FORMAT_VERSION, basis as u32, self.basis.coefficients() as u32]);
        out.words(l.size);
        out.words([l.levels]);
        out.floats([l.spacing]);
        out.floats(l.origin);
        out.words([self.bricks.len(), self.occlusions.len(), self.probes.len()].map(|n| n as u32));
        out.words(self.index.iter().copied());
        for b in &self.bricks {
            out.words(b.corner);
            out.words([b.level]);
            out.words(b.probes);
            out.words(b.cells);
        }
        for o in &self.occlusions {
            out.floats(o.planes.into_iter().flatten());
            out.0.extend(o.weights.into_iter().flatten());
            out.words(o.own);
        }
        for p in &self.probes {
            out.floats(p.position);
            out.floats([p.validity]);
        }
        for p in &self.probes {
            out.floats(p.light.coefficients().iter().copied().flatten());
        }
        for p in &self.probes {
            out.floats([p.std_err, p.window]);
        }
        let checksum = blake3::hash(&out.0);
        out.0.extend(checksum.as_bytes());
        out.0
    }

    /// Reads what [`ProbeVolume::to_bytes`] wrote.
    ///
    /// # Errors
    ///
    /// Where the bytes are something else, newer or damaged; numbers that point nowhere are damage.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ProbeFileError> {
        if !bytes.starts_with(&MAGIC) {
            return Err(ProbeFileError::Format);
        }
        let mut r = Reader { bytes, at: MAGIC.len() };
        let version = r.word()?;
        if FORMAT_VERSION < version {
            return Err(ProbeFileError::Newer(version));
        }
        let end = bytes.len().saturating_sub(CHECKSUM);
        if bytes.len() < CHECKSUM || blake3::hash(&bytes[..end]).as_bytes()[..] != bytes[end..] {
            return Err(ProbeFileError::Damaged { at: end, what: "the checksum differs" });
        }
        r.bytes = &bytes[..end];
        let basis = Basis::ALL.get(r.word()? as usize).copied().ok_or(r.damage("an unknown basis"))?;
        if r.word()? as usize != basis.coefficients() {
            return Err(r.damage("another number of coefficients than the basis has"));
        }
        let size = r.words()?;
        let [levels] = r.words()?;
        let [spacing] = r.floats()?;
        let origin = r.floats()?;
        let lattice = Lattice { origin, spacing, size, levels };
        let [bricks, occlusions, probes] = r.words()?;
        // A size that does not fit is found before room is made for it.
        let cells = size.iter().try_fold(1usize, |n, s| n.checked_mul(*s as usize));
        let n = |count: u32, bytes: usize| (count as usize).checked_mul(bytes);
        let wanted = [
            cells.and_then(|c| c.checked_mul(4)),
            n(bricks, 193 * 4),
            n(occlusions, 256),
            n(probes, (6 + 3 * basis.coefficients()) * 4),
        ];
        let wanted = wanted.into_iter().try_fold(r.at, |a, b| a.checked_add(b?));
        if wanted != Some(end) {
            return Err(r.damage("another length than its numbers say"));
        }
        let mut v = Self { basis, lattice, ..Self::default() };
        for _ in 0..cells.unwrap_or(0) {
            let brick = r.word()?;
            v.index.push(r.number(brick, bricks)?);
        }
        for _ in 0..bricks {
            let corner = r.words()?;
            let [level] = r.words()?;
            if levels.max(1) <= level || 31 < level {
                return Err(r.damage("a brick of no level"));
            }
            let all = r.words::<{ NODES * NODES * NODES }>()?;
            let cells = r.words::<{ CELLS * CELLS * CELLS }>()?;
            if all.iter().any(|p| probes <= *p) {
                return Err(r.damage("a probe that is not there"));
            }
            for c in cells {
                r.number(c, occlusions)?;
            }
            v.bricks.push(Brick { corner, level, probes: all, cells });
        }
        for _ in 0..occlusions {
            let mut planes = [[0.0; 4]; PLANES];
            for p in &mut planes {
                *p = r.floats()?;
            }
            let mut weights = [[0; CORNERS]; REGIONS];
            for w in &mut weights {
                w.copy_from_slice(r.take(CORNERS)?);
            }
            let own = r.words::<REGIONS>()?;
            for o in own {
                r.number(o, probes)?;
            }
            v.occlusions.push(Occlusion { planes, weights, own });
        }
        for _ in 0..probes {
            let [x, y, z, validity] = r.floats()?;
            let light = Light::black(basis);
            v.probes.push(Probe { position: [x, y, z], light, std_err: 0.0, validity, window: 0.0 });
        }
        for probe in &mut v.probes {
            let mut c = [[0.0; 3]; super::MOST_COEFFICIENTS];
            for c in &mut c[..basis.coefficients()] {
                *c = r.floats()?;
            }
            probe.light = Light::new(basis, &c);
        }
        for probe in &mut v.probes {
            [probe.std_err, probe.window] = r.floats()?;
        }
        Ok(v)
    }
}

struct Writer(Vec<u8>);

impl Writer {
    fn words(&mut self, words: impl IntoIterator<Item = u32>) {
        self.0.extend(words.into_iter().flat_map(u32::to_le_bytes));
    }

    fn floats(&mut self, floats: impl IntoIterator<Item = f32>) {
        self.0.extend(floats.into_iter().flat_map(f32::to_le_bytes));
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn damage(&self, what: &'static str) -> ProbeFileError {
        ProbeFileError::Damaged { at: self.at, what }
    }

    fn take(&mut self, n: usize) -> Result<&'a [u8], ProbeFileError> {
        let part = self.bytes.get(self.at..self.at + n).ok_or(self.damage("the file ends"))?;
        self.at += n;
        Ok(part)
    }

    fn words<const N: usize>(&mut self) -> Result<[u32; N], ProbeFileError> {
        let bytes = self.take(4 * N)?;
        let mut out = [0; N];
        for (o, b) in out.iter_mut().zip(bytes.chunks_exact(4)) {
            *o = u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        }
        Ok(out)
    }

    fn word(&mut self) -> Result<u32, ProbeFileError> {
        self.words::<1>().map(|[w]| w)
    }

    fn floats<const N: usize>(&mut self) -> Result<[f32; N], ProbeFileError> {
        let floats = self.words::<N>()?.map(f32::from_bits);
        if floats.iter().all(|f| f.is_finite()) { Ok(floats) } else { Err(self.damage("not a number")) }
    }

    /// A number below `n`, or [`NONE`].
    fn number(&self, number: u32, n: u32) -> Result<u32, ProbeFileError> {
        if number == NONE || number < n {
            Ok(number)
        } else {
            Err(self.damage("a number that points nowhere"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probes::volume::tests::example;

    #[test]
    fn volumes_are_read_back() {
        for basis in Basis::ALL {
            let v = example(basis);
            assert_eq!(ProbeVolume::from_bytes(&v.to_bytes()), Ok(v));
        }
        let none = ProbeVolume::default();
        assert_eq!(ProbeVolume::from_bytes(&none.to_bytes()), Ok(none));
    }

    /// Every byte that is changed or cut off is noticed, whether or not the checksum is made to fit.
    #[test]
    fn damage_is_noticed() {
        let bytes = example(Basis::L1).to_bytes();
        for at in (0..bytes.len()).step_by(7).chain(bytes.len() - 40..bytes.len()) {
            let mut bad = bytes.clone();
            bad[at] ^= 0x41;
            assert!(ProbeVolume::from_bytes(&bad).is_err(), "byte {at}");
            assert!(ProbeVolume::from_bytes(&bytes[..at]).is_err(), "cut at {at}");
        }
        let again = |mut bad: Vec<u8>| {
            let end = bad.len() - CHECKSUM;
            let sum = blake3::hash(&bad[..end]);
            bad[end..].copy_from_slice(sum.as_bytes());
            ProbeVolume::from_bytes(&bad)
        };
        // Size, bricks, probes; a brick of the index; a probe of the brick; what is not a number.
        let header = 4 * 16;
        for at in [20, 52, 60, header, header + 8 * 4 + 16, bytes.len() - CHECKSUM - 4] {
            let mut bad = bytes.clone();
            bad[at..at + 4].copy_from_slice(&0x7fff_ffff_u32.to_le_bytes());
            assert!(matches!(again(bad), Err(ProbeFileError::Damaged { .. })), "word at {at}");
        }
        let mut newer = bytes.clone();
        newer[8] = 2;
        assert_eq!(again(newer), Err(ProbeFileError::Newer(2)));
        assert_eq!(ProbeVolume::from_bytes(b"BAKE"), Err(ProbeFileError::Format));
    }
}
