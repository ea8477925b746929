//! Volumetric shadows of a hierarchy's lights: cube maps of what smoke leaves.
//!
//! Each light has a cube map whose texels are as large as a voxel at the light's radius of influence (\[LGH17\] section 4), and each texel what is left of light
//! at a few distances. The published maps march through smoke that is filtered as wide as the light is (equation 6, [`Shadows::marched`]): light begins in the
//! middle of what it stands for and crosses means of density. A fire that glows at its outside as well then loses most of its light, two fifths of it
//! in a fireball of optical depth 3, because the mean of exponentials is above the exponential of the mean. So the maps of a level are means over the lights
//! of the level below that it stands for, each along its own line and by its own map as far as that goes: continuous all the same, and right on every level.
//! Such shadows are as soft as their lights are wide, so that texels need not be finer than two thirds of the spacing at the radius of influence.

use crate::light::hierarchy::quick::{decay, power};
use crate::light::hierarchy::{GridLight, Hierarchy, Level};
use crate::media::Media;
use crate::media::lattice::Lattice;
use crate::scene::model::Rgb;
use glam::{Vec2, Vec3, Vec3A};
use half::f16;
use rayon::prelude::*;

/// Steps along a face at most, in spacings of the level at its radius of influence on both sides. Of a dense explosion of 64^3 voxels 3 and 2.5 bring 2.4 and 2.7 % of mean error on the walls of a
/// room around it at alpha 2, in processor times of 9.4 and 7.1; 8 brought as much as 3.
const MOST_ALONG: f32 = 2.5;

/// Cube maps of all lights.
#[derive(Clone, Debug)]
pub struct Shadows {
    smoke: Lattice,
    /// The same as it is, voxel by voxel.
    grids: Media,
    levels: Vec<Maps>,
    depths: usize,
}

/// Cube maps of a level.
#[derive(Clone, Debug)]
struct Maps {
    /// Texels along a face.
    side: usize,
    /// Spacing, metres.
    cell: f32,
    /// Radius of influence, metres.
    radius: f32,
    /// The nearest that the level counts, metres.
    near: f32,
    /// How far the depths go, metres.
    far: f32,
    /// By light, face, row, column, distance and channel.
    values: Vec<f16>,
}

/// What a light stands for: a level and its number, lights of it, and what each brings.
#[derive(Clone, Copy)]
struct Stands<'a> {
    below: Option<(usize, &'a Level)>,
    parts: &'a [(usize, f32)],
}

/// What the maps of a level take.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Size {
    /// Lights.
    pub lights: usize,
    /// Texels of each light.
    pub texels: usize,
    /// Bytes of a texel.
    pub texel_bytes: usize,
    /// Bytes of the level.
    pub bytes: u64,
}

/// Texels along the faces of a level, from edge to edge.
fn side(level: &Level, voxel: f32) -> usize {
    let most = (MOST_ALONG * level.radius / level.spacing).ceil() + 1.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "limited")]
    let side = ((2.0 * level.radius / voxel).ceil() + 1.0).clamp(2.0, most) as usize;
    side
}

/// What the maps of each level will take, with so many depths in each texel.
#[must_use]
pub fn sizes(hierarchy: &Hierarchy, smoke: &Lattice, depths: usize) -> Vec<Size> {
    let each = hierarchy.levels().iter().map(|level| {
        let side = side(level, smoke.pitch());
        let (lights, texels, texel_bytes) =
            (level.lights.len(), 6 * side * side, 2 * depths * smoke.channels());
        Size { lights, texels, texel_bytes, bytes: (lights * texels * texel_bytes) as u64 }
    });
    each.collect()
}

impl Shadows {
    /// Fills the maps, those of the finest level first; once `stopped` says so they stay as they are, and are of no use.
    #[must_use]
    pub fn new(
        hierarchy: &Hierarchy,
        (smoke, grids): (Lattice, Media),
        depths: usize,
        stopped: &(dyn Fn() -> bool + Sync),
    ) -> Self {
        let levels = hierarchy.levels();
        let last = levels.len() - 1;
        let mut shadows = Self { smoke, grids, levels: Vec::new(), depths: depths.max(2) };
        for (l, level) in levels.iter().enumerate() {
            // Nearer than the radius below, a level brings nothing.
            let near = if l == 0 { 0.0 } else { levels[l - 1].radius };
            let far = if l == last {
                // Without bounds, as far as the smoke goes.
                let each = level.lights.iter().map(|light| shadows.smoke.farthest(light.position));
                each.fold(level.reach, f32::max)
            } else {
                level.reach
            };
            let side = side(level, shadows.smoke.pitch());
            let mut maps =
                Maps { side, cell: level.spacing, radius: level.radius, near, far, values: Vec::new() };
            let parts = if l == 0 { vec![Vec::new(); level.lights.len()] } else { hierarchy.parts(l) };
            let each = shadows.depths * shadows.smoke.channels();
            let texels = 6 * side * side;
            let mut values = vec![f16::ZERO; level.lights.len() * texels * each];
            values.par_chunks_mut(texels * each).zip(&level.lights).zip(&parts).for_each(
                |((out, light), parts)| {
                    let below = l.checked_sub(1).map(|l| (l, &levels[l]));
                    for (k, out) in out.chunks_mut(each).enumerate() {
                        if k % (side * side) == 0 && stopped() {
                            return;
                        }
                        let (face, y, x) = (k / (side * side), k / side % side, k % side);
                        let direction = direction(face, Vec2::new(x as f32, y as f32) / (side - 1) as f32);
                        shadows.texel(&maps, light, Stands { below, parts }, direction, out);
                    }
                },
            );
            maps.values = values;
            shadows.levels.push(maps);
        }
        shadows
    }

    /// What is left at the distances of a texel.
    fn texel(
        &self,
        maps: &Maps,
        light: &GridLight,
        Stands { below, parts }: Stands<'_>,
        direction: Vec3A,
        out: &mut [f16],
    ) {
        let channels = self.smoke.channels();
        let mut put = |k: usize, left: Rgb| {
            for (c, out) in out[k * channels..(k + 1) * channels].iter_mut().enumerate() {
                *out = f16::from_f32(left[c]);
            }
        };
        let Some(below) = below.filter(|_| !parts.is_empty()) else {
            let (mut depth, mut from) = (Vec3::ZERO, 0.0);
            // The light begins anywhere in its voxel, not in the middle: the mean over a line through it is larger than what the half of it leaves.
            let own = self.within(light.position, direction, (0.0, 0.5 * maps.cell));
            // (1 - e^-2x) / 2x instead of e^-x, x being what that half has.
            let mean = own.map(|x| if x < 1e-3 { 1.0 - x } else { -(-2.0 * x).exp_m1() / (2.0 * x) });
            for k in 0..self.depths {
                let to = maps.place(k, self.depths);
                depth += self.within(light.position, direction, (from, to));
                from = to;
                put(k, (-(depth - own).max(Vec3::ZERO)).exp() * mean);
            }
            return;
        };
        for k in 0..self.depths {
            put(k, self.through(below, parts, (light.position, direction, maps.place(k, self.depths))));
        }
    }

    /// What is left of lights of the level below at a place, taken together: by their maps as far as these go, then along their own lines.
    ///
    /// Of smoke that glows, the side that faces a place is seen, which is nearer than the middle. So each counts by what it brings to a surface that faces the light of the level, over what
    /// that would bring from where it is, at the distance `from`: a harmonic function, whose mean over what shines evenly around its middle is 1.
    fn through(
        &self,
        (level, Level { lights, spacing, .. }): (usize, &Level),
        parts: &[(usize, f32)],
        (origin, line, from): (Vec3A, Vec3A, f32),
    ) -> Rgb {
        let maps = &self.levels[level];
        let place = origin + line * from;
        let (mut left, mut all) = (Vec3::ZERO, 0.0);
        for &(i, weight) in parts {
            let way = place - lights[i].position;
            let distance = way.length();
            let direction = way.normalize_or(Vec3A::Y);
            let mut here = self.left(level, i, direction, distance);
            // What is nearer brings more, and what is aside less.
            let ratio = from / distance.max(0.5 * spacing);
            let turned = ratio * ratio * direction.dot(line).max(0.0);
            if maps.far < distance {
                here *= self.within(lights[i].position, direction, (maps.far, distance)).map(decay);
            }
            left += weight * turned * here;
            all += weight;
        }
        left / all
    }

    /// Optical depth of a part of a ray, exactly: samples of it would be right in the mean, and what is left then too bright.
    fn within(&self, origin: Vec3A, direction: Vec3A, (from, to): (f32, f32)) -> Rgb {
        let (begin, end) = self.smoke.span(origin, direction, to, 0.0);
        let begin = begin.max(from);
        if end <= begin {
            return Vec3::ZERO;
        }
        let origin = origin + direction * begin;
        if self.smoke.is_one_grid() {
            return self.smoke.optical_depth(origin, direction, end - begin);
        }
        self.grids.optical_depth(origin, direction, end - begin)
    }

    /// Optical depth of a part of a ray through smoke that is filtered as wide as `width` says of distances.
    fn along(
        &self,
        origin: Vec3A,
        direction: Vec3A,
        (from, to): (f32, f32),
        width: impl Fn(f32) -> f32,
    ) -> Rgb {
        let h = self.smoke.pitch();
        let (begin, end) = self.smoke.span(origin, direction, to, width(0.0));
        let mut t = begin.max(from);
        let mut depth = Vec3::ZERO;
        while t < end {
            let width = width(t);
            let next = (t + h.max(0.5 * width)).min(end);
            if next <= t {
                break;
            }
            depth += self.smoke.filtered(origin + direction * (0.5 * (t + next)), width) * (next - t);
            t = next;
        }
        depth
    }

    /// What smoke leaves of a light of a level at a place so far away in a direction from it, channel by channel: means of neighbouring directions, because
    /// that of their depths is darker, and exponentials between distances.
    #[must_use]
    #[inline]
    pub fn left(&self, level: usize, light: usize, direction: Vec3A, distance: f32) -> Rgb {
        let maps = &self.levels[level];
        let channels = self.smoke.channels();
        let (face, uv) = face(direction);
        // The outermost texels are on the edges of the face, where those of the next one are as well: nothing jumps there.
        let at = uv.clamp(Vec2::ZERO, Vec2::ONE) * (maps.side - 1) as f32;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "indices")]
        let (x, y) = (at.x as usize, at.y as usize);
        let t = at - Vec2::new(x as f32, y as f32);
        let (x1, y1) = ((x + 1).min(maps.side - 1), (y + 1).min(maps.side - 1));
        let (k, part) = maps.between(distance, self.depths);
        let first = (light * 6 + face) * maps.side * maps.side;
        let texel = |x: usize, y: usize, k: usize| {
            let at = ((first + y * maps.side + x) * self.depths + k) * channels;
            let v = &maps.values[at..at + channels];
            Vec3::new(widened(v[0]), widened(v[1]), widened(v[2]))
        };
        if channels == 1 {
            let texel = |x: usize, y: usize, k: usize| {
                widened(maps.values[(first + y * maps.side + x) * self.depths + k])
            };
            let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
            let one = |k: usize| {
                mix(
                    mix(texel(x, y, k), texel(x1, y, k), t.x),
                    mix(texel(x, y1, k), texel(x1, y1, k), t.x),
                    t.y,
                )
            };
            let before = k.checked_sub(1).map_or(1.0, one);
            let left = if part == 0.0 || before <= 1e-30 {
                before
            } else {
                before * power((one(k) / before).max(1e-30), part)
            };
            return Vec3::splat(left);
        }
        let one = |k: usize| {
            let upper = texel(x, y, k).lerp(texel(x1, y, k), t.x);
            let lower = texel(x, y1, k).lerp(texel(x1, y1, k), t.x);
            upper.lerp(lower, t.y)
        };
        // Before the first distance there is the light.
        let before = k.checked_sub(1).map_or(Vec3::ONE, one);
        if part == 0.0 {
            return before;
        }
        let ratio = one(k) / before.max(Vec3::splat(1e-30));
        before * ratio.map(|r| power(r.max(1e-30), part))
    }

    /// The same by marching through filtered smoke from the light, as published, at the time of asking: what the maps save.
    #[must_use]
    pub fn marched(&self, level: usize, light: &GridLight, direction: Vec3A, distance: f32) -> Rgb {
        let (radius, h) = (self.levels[level].radius, self.smoke.pitch());
        // Equation 6, in which the filter's last size is the voxel's.
        let width = |t: f32| {
            let d = t / radius;
            if d < 1.0 { (1.0 - d) * light.size + d * h } else { 0.0 }
        };
        self.along(light.position, direction, (0.0, distance), width)
    }

    /// Bytes of maps and smoke.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.levels.iter().map(|l| 2 * l.values.len() as u64).sum::<u64>() + self.smoke.bytes()
    }
}

impl Maps {
    /// The distance that number `k` of `depths` is for: from the nearest that counts to the farthest, or, where the light itself counts, after it.
    fn place(&self, k: usize, depths: usize) -> f32 {
        if self.near == 0.0 {
            return self.far * (k + 1) as f32 / depths as f32;
        }
        self.near + (self.far - self.near) * k as f32 / (depths - 1) as f32
    }

    /// The number of the distance at or after this one, and how far it is on the way there from the one before.
    #[inline]
    fn between(&self, distance: f32, depths: usize) -> (usize, f32) {
        let along = if self.near == 0.0 {
            distance / self.far * depths as f32
        } else {
            (distance - self.near) / (self.far - self.near) * (depths - 1) as f32 + 1.0
        };
        let first = if self.near == 0.0 { 0.0 } else { 1.0 };
        let along = along.clamp(first, depths as f32);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
        let k = (along as usize).min(depths - 1);
        (k, along - k as f32)
    }
}

/// A number of half precision that is not negative: moved to where single precision has exponent and digits, and scaled by the difference of
/// exponents. The usual conversion asks at run time what the processor can, which takes longer than all the rest of a lookup.
#[inline]
fn widened(half: f16) -> f32 {
    f32::from_bits(u32::from(half.to_bits()) << 13) * f32::from_bits(0x7780_0000)
}

/// The direction of a place on a face: +x, -x, +y, -y, +z, -z.
fn direction(face: usize, uv: Vec2) -> Vec3A {
    let (a, b) = (2.0 * uv.x - 1.0, 2.0 * uv.y - 1.0);
    let sign = if face.is_multiple_of(2) { 1.0 } else { -1.0 };
    let v = match face / 2 {
        0 => Vec3A::new(sign, a, b),
        1 => Vec3A::new(b, sign, a),
        _ => Vec3A::new(a, b, sign),
    };
    v.normalize()
}

/// The face and the place on it where a direction points.
fn face(direction: Vec3A) -> (usize, Vec2) {
    let size = direction.abs();
    let axis = if size.y <= size.x && size.z <= size.x {
        0
    } else if size.z <= size.y {
        1
    } else {
        2
    };
    let v = direction / size[axis].max(f32::MIN_POSITIVE);
    let (a, b) = match axis {
        0 => (v.y, v.z),
        1 => (v.z, v.x),
        _ => (v.x, v.y),
    };
    (2 * axis + usize::from(direction[axis] < 0.0), Vec2::new(0.5 * a + 0.5, 0.5 * b + 0.5))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Sequence;
    use crate::sample::warp::Frame;

    /// All numbers of half precision that are not negative.
    #[test]
    fn halves_are_widened_exactly() {
        for bits in 0..=f16::MAX.to_bits() {
            let half = f16::from_bits(bits);
            assert_eq!(widened(half), half.to_f32(), "{bits:#x}");
        }
    }

    /// Directions are on the face and at the place that they came from.
    #[test]
    fn faces_are_where_they_point() {
        for i in 0..6000u32 {
            let [a, b, _, _] = Sequence::new(3, i).next4();
            let k = (i % 6) as usize;
            let (found, uv) = face(direction(k, Vec2::new(a, b)));
            assert_eq!(found, k);
            assert!(uv.distance(Vec2::new(a, b)) < 1e-5, "{uv} of {a}, {b}");
        }
        let frame = Frame::new(Vec3A::Y);
        assert!(face(frame.z).0 < 6);
    }
}
