//! Points of the surface inside one texel.

use glam::{DVec2, Vec2};

use super::{
    TexelMap,
    clip::{self, Polygon},
};
use crate::geom::atlas::cross;

/// A point of the surface inside a texel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TexelSample {
    /// World triangle.
    pub triangle: u32,
    /// Weights of the triangle's three corners, each in [0, 1], with sum 1.
    pub bary: [f32; 3],
    /// Position inside the texel, [0, 1] x [0, 1], v downwards.
    pub uv: Vec2,
}

/// Maps the unit square onto the covered part of one texel, keeping areas: points that are well
/// spread in the square are well spread on the surface. Where the texel is fully covered the map
/// is the identity.
///
/// The first number chooses a column by the covered area to its left, the second a point in that
/// column by the covered length above it. Both are exact inverses of the piecewise quadratic and
/// linear sums, so the map is one-to-one and uniform by area of texture.
#[derive(Clone, Debug, Default)]
pub struct TexelSampler {
    fragments: Vec<Fragment>,
    /// Columns where the covered length changes slope, ascending, with the length to their left and
    /// right and the area up to them.
    breaks: Vec<Break>,
    area: f64,
    /// A point for texels whose area is lost to rounding.
    fallback: TexelSample,
}

#[derive(Clone, Copy, Debug)]
struct Fragment {
    triangle: u32,
    /// Of the whole triangle, relative to the texel.
    corners: [DVec2; 3],
    polygon: Polygon,
    left: f64,
    right: f64,
}

#[derive(Clone, Copy, Debug)]
struct Break {
    x: f64,
    /// Covered length just right of `x`.
    from: f64,
    /// Covered length just left of the next break.
    to: f64,
    /// Covered area left of `x`.
    area: f64,
}

/// Fragments of a column that need no list on the heap.
const FEW: usize = 8;

impl TexelSampler {
    /// A sampler for the covered texel number `index` of `map`.
    pub fn new(map: &TexelMap, index: usize) -> Self {
        let mut s = Self::default();
        s.set(map, index);
        s
    }

    /// Makes this the sampler of another texel, reusing its memory.
    pub fn set(&mut self, map: &TexelMap, index: usize) {
        let texel = map.texels[index];
        self.fragments.clear();
        self.breaks.clear();
        for &triangle in map.triangles_of(index) {
            let corners = map.local(triangle, texel);
            let polygon = clip::unit_square(&corners);
            let xs = || polygon.corners().iter().map(|c| c.x);
            let (left, right) = (xs().fold(f64::INFINITY, f64::min), xs().fold(f64::NEG_INFINITY, f64::max));
            if left < right && polygon.area() != 0.0 {
                self.fragments.push(Fragment { triangle, corners, polygon, left, right });
                self.breaks.extend(xs().map(|x| Break { x, from: 0.0, to: 0.0, area: 0.0 }));
            }
        }
        self.breaks.sort_unstable_by(|a, b| a.x.total_cmp(&b.x));
        self.breaks.dedup_by(|a, b| a.x == b.x);
        let triangle = map.triangles_of(index).first().copied().unwrap_or(0);
        let middle = map.local(triangle, texel).iter().sum::<DVec2>() / 3.0;
        let uv = middle.as_vec2().clamp(Vec2::ZERO, Vec2::ONE);
        self.fallback = TexelSample { triangle, bary: [1.0 / 3.0; 3], uv };
        self.area = 0.0;
        for i in 1..self.breaks.len() {
            let (x0, x1) = (self.breaks[i - 1].x, self.breaks[i].x);
            let (mut from, mut to) = (0.0, 0.0);
            for f in self.fragments.iter().filter(|f| f.left <= x0 && x1 <= f.right) {
                // Slightly inside, since a vertical edge has two lengths at its column.
                let (a0, a1) = f.span(x0, x0, x1);
                let (b0, b1) = f.span(x1, x0, x1);
                from += a1 - a0;
                to += b1 - b0;
            }
            let b = &mut self.breaks[i - 1];
            (b.from, b.to, b.area) = (from, to, self.area);
            self.area += 0.5 * (from + to) * (x1 - x0);
        }
        if let Some(last) = self.breaks.last_mut() {
            last.area = self.area;
        }
    }

    /// Covered fraction of the texel, in [0, 1].
    pub fn coverage(&self) -> f32 {
        #[expect(clippy::cast_possible_truncation, reason = "a fraction")]
        let c = self.area.clamp(0.0, 1.0) as f32;
        c
    }

    /// The surface point for `u` in [0, 1) x [0, 1).
    pub fn sample(&self, u: [f32; 2]) -> TexelSample {
        self.find(u).unwrap_or(self.fallback)
    }

    fn find(&self, u: [f32; 2]) -> Option<TexelSample> {
        if self.area <= 0.0 {
            return None;
        }
        let target = f64::from(u[0].clamp(0.0, 1.0)) * self.area;
        let last = self.breaks.len().checked_sub(2)?;
        let mut slab = self.breaks.partition_point(|b| b.area <= target).clamp(1, last + 1) - 1;
        // A slab without area cannot be meant: rounding at the upper end can lead to one.
        while 0 < slab && self.breaks[slab].from + self.breaks[slab].to <= 0.0 {
            slab -= 1;
        }
        let (b, end) = (self.breaks[slab], self.breaks[slab + 1].x);
        let width = end - b.x;
        let x = b.x + width * invert(b.from, b.to, (target - b.area) / width);
        let x = x.clamp(b.x, end);
        // Fragments of the column with their spans, the first few without a list on the heap.
        let mut few = [(0.0, 0.0, 0); FEW];
        let mut many = Vec::new();
        let mut n = 0;
        let mut length = 0.0;
        for (i, f) in self.fragments.iter().enumerate() {
            if b.x < f.left || f.right < end {
                continue;
            }
            let (lo, hi) = f.span(x, b.x, end);
            length += hi - lo;
            if n < FEW {
                few[n] = (lo, hi, i);
            } else {
                if n == FEW {
                    many.extend_from_slice(&few);
                }
                many.push((lo, hi, i));
            }
            n += 1;
        }
        let column = if n <= FEW { &mut few[..n] } else { many.as_mut_slice() };
        // From top to bottom.
        column.sort_unstable_by(|f, g| {
            let triangle = |i: usize| self.fragments[i].triangle;
            (f.0 + f.1).total_cmp(&(g.0 + g.1)).then_with(|| triangle(f.2).cmp(&triangle(g.2)))
        });
        let mut rest = f64::from(u[1].clamp(0.0, 1.0)) * length;
        let mut chosen = None;
        for &(lo, hi, i) in &*column {
            chosen = Some((&self.fragments[i], DVec2::new(x, (lo + rest).min(hi))));
            if rest < hi - lo {
                break;
            }
            rest -= hi - lo;
        }
        let (fragment, p) = chosen?;
        Some(TexelSample {
            triangle: fragment.triangle,
            bary: barycentric(&fragment.corners, p),
            uv: p.as_vec2().clamp(Vec2::ZERO, Vec2::ONE),
        })
    }
}

impl Fragment {
    /// Lowest and highest y of the polygon at column `x`, from the edges that cross the slab from
    /// `left` to `right`, in which no corner lies.
    fn span(&self, x: f64, left: f64, right: f64) -> (f64, f64) {
        let corners = self.polygon.corners();
        let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut previous = corners[corners.len() - 1];
        for &corner in corners {
            let (a, b) = if previous.x < corner.x { (previous, corner) } else { (corner, previous) };
            if a.x <= left && right <= b.x && a.x < b.x {
                let y = a.y + (b.y - a.y) * ((x - a.x) / (b.x - a.x));
                (lo, hi) = (lo.min(y), hi.max(y));
            }
            previous = corner;
        }
        if lo <= hi { (lo, hi) } else { (0.0, 0.0) }
    }
}

/// Solves `t * from + t^2 * (to - from) / 2 = area` for t in [0, 1].
fn invert(from: f64, to: f64, area: f64) -> f64 {
    let slope = to - from;
    let root = (from * from + 2.0 * slope * area).max(0.0).sqrt();
    // This form of the solution loses nothing where the slope is small.
    let t = 2.0 * area / (from + root);
    if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.5 }
}

/// Weights of the corners at `p`, forced inside the triangle.
fn barycentric(t: &[DVec2; 3], p: DVec2) -> [f32; 3] {
    let total = cross(*t);
    let part = |a: DVec2, b: DVec2| ((a - p).perp_dot(b - p) / total).max(0.0);
    let w = [part(t[1], t[2]), part(t[2], t[0]), part(t[0], t[1])];
    let sum: f64 = w.iter().sum();
    if !(sum.is_finite() && 0.0 < sum) {
        return [1.0 / 3.0; 3];
    }
    #[expect(clippy::cast_possible_truncation, reason = "weights in [0, 1]")]
    let w = w.map(|x| (x / sum) as f32);
    w
}
