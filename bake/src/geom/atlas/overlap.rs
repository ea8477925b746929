//! Do triangles in the plane overlap?

use glam::DVec2;

use super::group::cross;
use crate::geom::texel::clip::{self, Polygon};

/// Part of the smaller triangle that has to be covered by another before it counts: rounding of
/// shared edges stays far below.
const PAIR: f64 = 1e-2;

/// Whether triangles cover each other by more than the part `tolerance` of their area.
///
/// Every pair is clipped exactly, in a grid so that few pairs meet; the search stops at the first
/// certainty, so stacked charts cost little.
pub(super) fn overlap(triangles: &[[DVec2; 3]], tolerance: f64) -> bool {
    let solid: Vec<[DVec2; 3]> = triangles
        .iter()
        .filter_map(|t| {
            let c = cross(*t);
            let turned = [t[0], t[2], t[1]];
            (c != 0.0).then_some(if c < 0.0 { turned } else { *t })
        })
        .collect();
    let areas: Vec<f64> = solid.iter().map(|t| cross(*t) * 0.5).collect();
    let total: f64 = areas.iter().sum();
    if solid.len() < 2 {
        return false;
    }
    let (lo, hi) = hull(&solid);
    let room = (hi - lo).element_product();
    if (1.0 + 2.0 * tolerance) * room < total {
        return true;
    }
    let grid = Grid::new(&solid, lo, hi);
    let mut doubled = 0.0;
    for cell in 0..grid.starts.len() - 1 {
        let list = &grid.items[grid.starts[cell] as usize..grid.starts[cell + 1] as usize];
        for (i, &a) in list.iter().enumerate() {
            for &b in &list[i + 1..] {
                let (ta, tb) = (&solid[a as usize], &solid[b as usize]);
                let (la, ha) = bounds(ta);
                let (lb, hb) = bounds(tb);
                let (lo, hi) = (la.max(lb), ha.min(hb));
                // A pair that meets in several cells is counted in the one with its lower corner.
                if hi.x <= lo.x || hi.y <= lo.y || grid.cell(lo) != cell || separate(ta, tb) {
                    continue;
                }
                let common = intersection(ta, tb);
                if PAIR * areas[a as usize].min(areas[b as usize]) < common {
                    doubled += common;
                    if tolerance * total < doubled {
                        return true;
                    }
                }
            }
        }
    }
    false
}

/// Whether an edge of one triangle (both counter-clockwise) has the other wholly outside it.
fn separate(a: &[DVec2; 3], b: &[DVec2; 3]) -> bool {
    let outside = |s: &[DVec2; 3], t: &[DVec2; 3]| {
        (0..3).any(|i| {
            let (p, q) = (s[i], s[(i + 1) % 3]);
            t.iter().all(|&r| (q - p).perp_dot(r - p) <= 0.0)
        })
    };
    outside(a, b) || outside(b, a)
}

/// Area common to two counter-clockwise triangles.
fn intersection(a: &[DVec2; 3], b: &[DVec2; 3]) -> f64 {
    let mut polygon = Polygon::triangle(a);
    for i in 0..3 {
        let (p, q) = (b[i], b[(i + 1) % 3]);
        polygon = clip::half_plane(&polygon, |r| (q - p).perp_dot(r - p));
    }
    polygon.area().abs()
}

fn bounds(t: &[DVec2; 3]) -> (DVec2, DVec2) {
    (t[0].min(t[1]).min(t[2]), t[0].max(t[1]).max(t[2]))
}

/// Bounds of all triangles.
fn hull(triangles: &[[DVec2; 3]]) -> (DVec2, DVec2) {
    triangles
        .iter()
        .map(bounds)
        .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |h, b| (h.0.min(b.0), h.1.max(b.1)))
}

/// Triangles by the cells their bounds touch.
struct Grid {
    lo: DVec2,
    scale: DVec2,
    side: usize,
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Grid {
    /// About one cell a triangle, fewer where triangles are so long that lists would grow large.
    fn new(triangles: &[[DVec2; 3]], lo: DVec2, hi: DVec2) -> Self {
        let mut side = (1..1024_usize).find(|s| triangles.len() <= s * s).unwrap_or(1024);
        let mut grid = Self { lo, scale: DVec2::ONE, side, starts: Vec::new(), items: Vec::new() };
        loop {
            grid.side = side;
            grid.scale = DVec2::splat(side as f64) / (hi - lo);
            let entries: usize = triangles.iter().map(|t| grid.cell_count(t)).sum();
            if entries <= 16 * triangles.len() || side == 1 {
                break;
            }
            side /= 2;
        }
        grid.starts = vec![0; side * side + 1];
        for t in triangles {
            grid.each_cell(t).for_each(|c| grid.starts[c + 1] += 1);
        }
        for i in 1..grid.starts.len() {
            grid.starts[i] += grid.starts[i - 1];
        }
        let mut next = grid.starts.clone();
        grid.items = vec![0; next[side * side] as usize];
        for (i, t) in (0_u32..).zip(triangles) {
            for c in grid.each_cell(t) {
                grid.items[next[c] as usize] = i;
                next[c] += 1;
            }
        }
        grid
    }

    fn axis(&self, x: f64) -> usize {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the cast saturates and the result is clamped to the grid"
        )]
        let i = x as usize;
        i.min(self.side - 1)
    }

    fn column_row(&self, p: DVec2) -> (usize, usize) {
        let q = (p - self.lo) * self.scale;
        (self.axis(q.x), self.axis(q.y))
    }

    fn cell(&self, p: DVec2) -> usize {
        let (x, y) = self.column_row(p);
        y * self.side + x
    }

    fn cell_count(&self, t: &[DVec2; 3]) -> usize {
        let (lo, hi) = bounds(t);
        let ((x0, y0), (x1, y1)) = (self.column_row(lo), self.column_row(hi));
        (x1 - x0 + 1) * (y1 - y0 + 1)
    }

    fn each_cell(&self, t: &[DVec2; 3]) -> impl Iterator<Item = usize> + use<> {
        let (lo, hi) = bounds(t);
        let ((x0, y0), (x1, y1)) = (self.column_row(lo), self.column_row(hi));
        let side = self.side;
        (y0..=y1).flat_map(move |y| (x0..=x1).map(move |x| y * side + x))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(n: u32, offset: DVec2) -> Vec<[DVec2; 3]> {
        let mut out = Vec::new();
        for i in 0..n * n {
            let at = |x: u32, y: u32| {
                DVec2::new(f64::from(i % n + x), f64::from(i / n + y)) / f64::from(n) * 0.3 + offset
            };
            out.push([at(0, 0), at(1, 0), at(1, 1)]);
            out.push([at(0, 0), at(0, 1), at(1, 1)]);
        }
        out
    }

    #[test]
    fn touching_triangles_do_not_overlap() {
        assert!(!overlap(&grid(40, DVec2::ZERO), 1e-3));
    }

    #[test]
    fn a_small_stacked_part_is_found() {
        let mut all = grid(30, DVec2::ZERO);
        all.push([DVec2::new(0.1, 0.1), DVec2::new(0.12, 0.1), DVec2::new(0.1, 0.12)]);
        assert!(overlap(&all, 1e-3));
    }

    #[test]
    fn grids_beside_each_other_do_not_overlap_and_shifted_ones_do() {
        let mut beside = grid(20, DVec2::ZERO);
        beside.extend(grid(20, DVec2::new(0.3, 0.0)));
        assert!(!overlap(&beside, 1e-3));
        let mut shifted = grid(20, DVec2::ZERO);
        shifted.extend(grid(20, DVec2::new(0.29, 0.0)));
        assert!(overlap(&shifted, 1e-3));
    }

    #[test]
    fn large_stacks_are_found_quickly() {
        let t = [DVec2::ZERO, DVec2::X, DVec2::Y];
        assert!(overlap(&vec![t; 100_000], 1e-3));
    }
}
