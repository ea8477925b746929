//! What media take from light, on a lattice of cubes along the axes, and averages of it over larger cubes.

use super::{Density, Media, Shape, density};
use crate::scene::model::Rgb;
use glam::{Affine3A, USizeVec3, Vec3, Vec3A};
use rayon::prelude::*;

/// Most cubes along an axis.
const MOST_ALONG: f32 = 192.0;

/// Coefficients of media that are grids of voxels.
#[derive(Clone, Debug)]
pub struct Lattice {
    corner: Vec3A,
    /// What holds all cubes that take anything.
    low: Vec3A,
    high: Vec3A,
    pitch: f32,
    channels: usize,
    /// Whether its cubes are the voxels of the only grid.
    one_grid: bool,
    /// The finest first, each half as fine as the one before.
    mips: Vec<Mip>,
}

#[derive(Clone, Debug)]
struct Mip {
    size: USizeVec3,
    pitch: f32,
    /// sigma_t, per metre; x fastest, then y, then z, by channel. Around it there is a border of cubes that take nothing.
    values: Vec<f32>,
}

impl Mip {
    /// Number of a cube's first value; cubes of size 0 and beyond the last are the border.
    fn number(&self, [x, y, z]: [usize; 3], channels: usize) -> usize {
        let along = self.size + 2;
        (x + along.x * (y + along.y * z)) * channels
    }

    fn of(&self, number: usize, channels: usize) -> Rgb {
        let v = &self.values[number..number + channels];
        if channels == 1 { Vec3::splat(v[0]) } else { Vec3::new(v[0], v[1], v[2]) }
    }

    /// In the cube that holds a place.
    fn nearest(&self, p: Vec3A, channels: usize) -> Rgb {
        let most = (self.size + 1).as_vec3().into();
        let at = (p / self.pitch + 1.0).clamp(Vec3A::ZERO, most);
        self.of(self.number(index(at), channels), channels)
    }

    /// Between the centres of cubes; 0 beyond the border.
    fn interpolated(&self, p: Vec3A, channels: usize) -> Rgb {
        // Off the last of the border's cubes by less than can be seen.
        let most = Vec3A::from(self.size.as_vec3()) + 0.999_99;
        let at = (p / self.pitch + 0.5).clamp(Vec3A::ZERO, most);
        let low = at.floor();
        let t = at - low;
        let first = self.number(index(low), channels);
        let along = self.size + 2;
        let (dx, dy, dz) = (channels, along.x * channels, along.x * along.y * channels);
        if channels == 1 {
            let v = |i: usize| self.values[first + i];
            let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
            let near = mix(mix(v(0), v(dx), t.x), mix(v(dy), v(dy + dx), t.x), t.y);
            let far = mix(mix(v(dz), v(dz + dx), t.x), mix(v(dz + dy), v(dz + dy + dx), t.x), t.y);
            return Vec3::splat(mix(near, far, t.z));
        }
        let v = |i: usize| self.of(first + i, channels);
        let near = v(0).lerp(v(dx), t.x).lerp(v(dy).lerp(v(dy + dx), t.x), t.y);
        let far = v(dz).lerp(v(dz + dx), t.x).lerp(v(dz + dy).lerp(v(dz + dy + dx), t.x), t.y);
        near.lerp(far, t.z)
    }
}

/// Numbers of a cube along the axes, of coordinates that are not negative.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped before")]
#[inline]
fn index(at: Vec3A) -> [usize; 3] {
    at.to_array().map(|v| v as usize)
}

impl Lattice {
    /// The lattice of all media of a scene that are grids; `None` where no grid takes anything.
    #[must_use]
    pub fn new(media: &Media) -> Option<Self> {
        let grids: Vec<_> = media.bodies.iter().filter(|b| b.is_smoke()).collect();
        let (mut low, mut high, mut pitch) = (Vec3::INFINITY, Vec3::NEG_INFINITY, f32::INFINITY);
        for b in &grids {
            let (min, max) = b.bounds()?;
            let Density::Voxels { voxels_from_world, .. } = &b.density else { continue };
            (low, high) = (low.min(min), high.max(max));
            pitch = pitch.min(voxels_from_world.matrix3.determinant().abs().cbrt().recip());
        }
        if !(low.cmplt(high).all() && 0.0 < pitch) {
            return None;
        }
        let one_grid = match &grids[..] {
            [b] => {
                matches!(&b.density, Density::Voxels { voxels_from_world, .. } if is_lattice(voxels_from_world, low))
            }
            _ => false,
        };
        let least = (high - low).max_element() / MOST_ALONG;
        let coarse = pitch < least;
        pitch = pitch.max(least);
        let channels = media.channels();
        let size = ((high - low) / pitch).ceil().max(Vec3::ONE).as_usizevec3();
        let along = size + 2;
        let mut values = vec![0.0; along.element_product() * channels];
        values.par_chunks_mut(along.x * along.y * channels).enumerate().for_each(|(z, out)| {
            for (i, out) in out.chunks_mut(channels).enumerate() {
                let cell = [i % along.x, i / along.x, z];
                if (0..3).any(|k| cell[k] == 0 || size[k] < cell[k]) {
                    continue;
                }
                let p = Vec3A::from(low) + (Vec3A::from(cell.map(|v| v as f32)) - 0.5) * pitch;
                let mut sum = Vec3::ZERO;
                for b in &grids {
                    if b.holds(p) {
                        sum += (b.sigma_s + b.sigma_a) * density(&b.density, p);
                    }
                }
                out.copy_from_slice(&sum.to_array()[..channels]);
            }
        });
        let first = Mip { size, pitch, values };
        let corner = Vec3A::from(low);
        // What is smaller than a cube may be in none of their middles.
        let (low_taken, high_taken) = match first.taken(channels).filter(|_| !coarse) {
            Some((least, most)) => (corner + (least - 1.0) * pitch, corner + most * pitch),
            None => (corner, Vec3A::from(high)),
        };
        let mut mips = vec![first];
        while let Some(last) = mips.last()
            && 1 < last.size.max_element()
        {
            let next = last.halved(channels);
            mips.push(next);
        }
        Some(Self {
            corner,
            low: low_taken,
            high: high_taken,
            pitch,
            channels,
            one_grid: one_grid && !coarse,
            mips,
        })
    }

    /// Side of the finest cubes, metres.
    #[must_use]
    pub fn pitch(&self) -> f32 {
        self.pitch
    }

    /// Channels that are kept: 1 where all are alike.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// sigma_t at a place through a tent whose half width is `width` metres, per metre; unfiltered where that is 0.
    #[must_use]
    pub fn filtered(&self, p: Vec3A, width: f32) -> Rgb {
        let p = p - self.corner;
        if width <= 0.0 {
            return self.mips[0].nearest(p, self.channels);
        }
        let last = (self.mips.len() - 1) as f32;
        let level = (width / self.pitch).log2().clamp(0.0, last);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
        let k = level as usize;
        let (t, next) = (level - k as f32, (k + 1).min(self.mips.len() - 1));
        let fine = self.mips[k].interpolated(p, self.channels);
        if t <= 0.0 { fine } else { fine.lerp(self.mips[next].interpolated(p, self.channels), t) }
    }

    /// Whether its finest cubes are the voxels of the only grid, so that [`Self::optical_depth`] is exact.
    #[must_use]
    pub fn is_one_grid(&self) -> bool {
        self.one_grid
    }

    /// The integral of sigma_t over `length` metres of a ray that is within the lattice, cube by cube (Amanatides and Woo,
    /// "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987).
    #[must_use]
    pub fn optical_depth(&self, origin: Vec3A, direction: Vec3A, length: f32) -> Rgb {
        let first = &self.mips[0];
        let most: Vec3A = first.size.as_vec3().into();
        // Cubes are counted from 1.
        let at = (origin - self.corner) / self.pitch + 1.0;
        let cell = at.floor().clamp(Vec3A::ONE, most);
        let forward = direction.cmpge(Vec3A::ZERO);
        let inverse = direction.abs().max(Vec3A::splat(1e-20)).recip();
        let to_plane = Vec3A::select(forward, cell + 1.0 - at, at - cell).max(Vec3A::ZERO);
        // In cubes.
        let (mut next, length) = ((to_plane * inverse).to_array(), length / self.pitch);
        let inverse = inverse.to_array();
        let along = first.size + 2;
        let strides = [1, along.x, along.x * along.y].map(|s| s * self.channels);
        let steps: [usize; 3] =
            std::array::from_fn(|k| if forward.test(k) { strides[k] } else { strides[k].wrapping_neg() });
        let mut number = first.number(index(cell), self.channels);
        let (mut sum, mut t) = (Vec3::ZERO, 0.0);
        while number < first.values.len() {
            let axis = if next[0] <= next[1] && next[0] <= next[2] {
                0
            } else if next[1] <= next[2] {
                1
            } else {
                2
            };
            let until = next[axis].min(length);
            sum += first.of(number, self.channels) * (until - t);
            if length <= next[axis] {
                break;
            }
            t = until;
            next[axis] += inverse[axis];
            number = number.wrapping_add(steps[axis]);
        }
        sum * self.pitch
    }

    /// From where to where a ray's first `t_max` metres are within `beyond` metres of the lattice.
    #[must_use]
    pub fn span(&self, origin: Vec3A, direction: Vec3A, t_max: f32, beyond: f32) -> (f32, f32) {
        super::slabs(self.low - beyond, self.high + beyond, origin, direction, t_max)
    }

    /// Distance to the farthest corner.
    #[must_use]
    pub fn farthest(&self, p: Vec3A) -> f32 {
        (p - self.low).abs().max((self.high - p).abs()).length()
    }

    /// Bytes of all averages.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.mips.iter().map(|m| 4 * m.values.len() as u64).sum()
    }
}

impl Mip {
    /// First and last cubes along each axis that take anything, counted from 1; `None` where none does.
    fn taken(&self, channels: usize) -> Option<(Vec3A, Vec3A)> {
        let along = self.size + 2;
        let (mut least, mut most) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        for (i, v) in self.values.chunks(channels).enumerate() {
            if v.iter().any(|v| 0.0 < *v) {
                let at = [i % along.x, i / along.x % along.y, i / (along.x * along.y)].map(|v| v as f32);
                least = least.min(at.into());
                most = most.max(at.into());
            }
        }
        least.cmple(most).all().then_some((least, most))
    }

    /// Averages over cubes twice as large.
    fn halved(&self, channels: usize) -> Self {
        let size = self.size.map(|n| n.div_ceil(2));
        let mut half = Self { size, pitch: 2.0 * self.pitch, values: Vec::new() };
        half.values = vec![0.0; (size + 2).element_product() * channels];
        for z in 1..=size.z {
            for y in 1..=size.y {
                for x in 1..=size.x {
                    let fine = |n: usize, bit: usize, size: usize| (2 * n - 1 + bit).min(size + 1);
                    let sum: Vec3 = (0..8usize)
                        .map(|k| {
                            [
                                fine(x, k & 1, self.size.x),
                                fine(y, k >> 1 & 1, self.size.y),
                                fine(z, k >> 2, self.size.z),
                            ]
                        })
                        .map(|at| self.of(self.number(at, channels), channels))
                        .sum();
                    let number = half.number([x, y, z], channels);
                    half.values[number..number + channels]
                        .copy_from_slice(&(sum / 8.0).to_array()[..channels]);
                }
            }
        }
        half
    }
}

/// Whether voxels are cubes along the axes, with one beginning at a place.
fn is_lattice(voxels_from_world: &Affine3A, corner: Vec3) -> bool {
    let m = voxels_from_world.matrix3;
    let scale = m.x_axis.x;
    let even = (m - glam::Mat3A::from_diagonal(Vec3::splat(scale))).to_cols_array();
    let at = voxels_from_world.transform_point3(corner);
    0.0 < scale && even.iter().all(|v| v.abs() < 1e-5 * scale) && (at - at.round()).abs().max_element() < 1e-3
}

impl super::Body {
    /// Whether it is a grid that takes light.
    pub(super) fn is_smoke(&self) -> bool {
        matches!(self.density, Density::Voxels { .. }) && self.sigma_s + self.sigma_a != Vec3::ZERO
    }

    /// Whether a place is inside.
    pub(super) fn holds(&self, p: Vec3A) -> bool {
        if let Shape::Everywhere = self.shape {
            return true;
        }
        let mut inside = false;
        let step = p.abs().max_element().max(1.0) * 1e-5;
        self.parts(p, Vec3A::X, step, |from, to| inside |= from <= 0.0 && 0.0 < to);
        inside
    }
}

impl Media {
    /// The media that are no grids that take light, which a [`Lattice`] does not know; `None` where there are none that take light.
    #[must_use]
    pub fn beside_grids(&self) -> Option<Self> {
        self.those(|b| !b.is_smoke() && b.sigma_s + b.sigma_a != Vec3::ZERO)
    }

    /// The media that a [`Lattice`] knows; `None` where there are none.
    #[must_use]
    pub fn grids(&self) -> Option<Self> {
        self.those(super::Body::is_smoke)
    }

    fn those(&self, are: impl Fn(&super::Body) -> bool) -> Option<Self> {
        let bodies: Vec<_> = self.bodies.iter().filter(|b| are(b)).cloned().collect();
        if bodies.is_empty() {
            return None;
        }
        let mut media = Self { bodies, emission: None, undimmed: None, ..self.clone() };
        media.small = media.smallest();
        Some(media)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::{Sequence, sequence, warp};
    use crate::scene::model::{Medium, Region, Scene};
    use crate::scene::voxels::Voxels;
    use glam::UVec3;
    use std::sync::Arc;

    /// A grid along the axes gives what media do, along any ray; one that is turned is no lattice.
    #[test]
    fn a_grid_along_the_axes_is_marched_exactly() {
        let size = UVec3::new(11, 7, 5);
        let density = |v: UVec3| {
            let [a, ..] =
                Sequence::new(sequence::key(1, 2, u64::from(v.x + 16 * (v.y + 16 * v.z))), 0).next4();
            if a < 0.3 { 0.0 } else { a }
        };
        let values = Arc::new(Voxels::from_fn(size, 1 << 20, density).expect("a grid"));
        for (channels, sigma) in [(1, Vec3::splat(2.0)), (3, Vec3::new(1.0, 2.0, 0.5))] {
            let of = |turn: f32| {
                let place = Affine3A::from_scale(Vec3::splat(4.0))
                    * Affine3A::from_rotation_y(turn)
                    * Affine3A::from_translation(Vec3::new(0.3, -0.1, 7.0));
                let medium = Medium {
                    path: "grid".into(),
                    sigma_s: sigma,
                    sigma_a: Vec3::ZERO,
                    emission: Vec3::ZERO,
                    density: Density::Voxels { values: Arc::clone(&values), voxels_from_world: place },
                    g: 0.0,
                    region: Region::Everywhere,
                };
                Media::new(&Scene { media: vec![medium], ..Scene::default() }, Vec3::ZERO).expect("media")
            };
            let media = of(0.0);
            let lattice = Lattice::new(&media).expect("a lattice");
            assert!(lattice.is_one_grid() && lattice.channels() == channels);
            for i in 0..2000u32 {
                let [a, b, c, d] = Sequence::new(7, i).next4();
                let origin = Vec3A::new(a, b, c) * 4.0 - Vec3A::new(1.0, 1.0, 8.0);
                let direction = match i % 9 {
                    0 => Vec3A::X,
                    1 => Vec3A::NEG_Z,
                    _ => {
                        warp::square_to_cos_hemisphere([d, (7.0 * a).fract()])
                            * if i % 2 == 0 { 1.0 } else { -1.0 }
                    }
                };
                let (begin, end) = lattice.span(origin, direction, 3.0 * c + 0.5, 0.0);
                let want = media.optical_depth(origin, direction, 3.0 * c + 0.5);
                let got = if begin < end {
                    lattice.optical_depth(origin + direction * begin, direction, end - begin)
                } else {
                    Vec3::ZERO
                };
                assert!((got - want).abs().max_element() < 2e-4, "{i}: {got} of {want}");
            }
            assert!(!Lattice::new(&of(0.4)).expect("a lattice").is_one_grid());
        }
    }
}
