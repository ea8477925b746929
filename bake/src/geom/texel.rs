//! Which triangles cover which texels, and where in them.
//!
//! A [`TexelMap`] lists the covered texels of one atlas page with the triangles in each. Coverage
//! is conservative: a texel counts as soon as a triangle covers any area of its square. A
//! [`TexelSampler`] turns points of the unit square into points of the surface inside one texel,
//! uniformly by area of texture.

pub(crate) mod clip;
mod sampler;

use glam::{DVec2, Vec2};
use rayon::prelude::*;

pub use sampler::{TexelSample, TexelSampler};

use super::atlas::{Atlas, NO_CHART};
use crate::scene::model::Scene;

/// Texels along the side of a tile.
const TILE: u32 = 16;

/// The covered texels of one page.
///
/// A *world triangle* is counted over all surfaces of the scene: the first triangle of a surface
/// is the number of triangles of all surfaces before it.
#[derive(Clone, Debug, Default)]
pub struct TexelMap {
    /// Texels per row of the page.
    pub width: u32,
    /// Rows of the page.
    pub height: u32,
    /// Covered texels as `y * width + x`, tile by tile of 16 x 16, row by row inside a tile.
    pub texels: Vec<u32>,
    /// Where each texel's triangles start in `triangles`; one more entry than `texels`.
    pub offsets: Vec<u32>,
    /// World triangles in each texel, ascending within a texel.
    pub triangles: Vec<u32>,
    /// Surfaces on this page, by first world triangle.
    spans: Vec<Span>,
    /// Corners of the triangles of those surfaces on the page, texels.
    corners: Vec<[Vec2; 3]>,
}

/// A surface's triangles.
#[derive(Clone, Copy, Debug)]
struct Span {
    /// First world triangle.
    first: u32,
    /// First entry in [`TexelMap::corners`].
    start: u32,
    /// First chart, counted over the page.
    chart: u32,
    /// Layout, for the chart of each triangle.
    layout: usize,
}

impl TexelMap {
    /// Finds the covered texels of page `page`.
    ///
    /// Where charts of different kind share a texel, which only kept texture coordinates do, the
    /// triangles of the chart that covers most of it are listed alone. A page without surfaces, or
    /// a page that does not exist, gives an empty map.
    pub fn build(scene: &Scene, atlas: &Atlas, page: usize) -> Self {
        let mut map = Self { offsets: vec![0], ..Self::default() };
        let Some(size) = atlas.pages.get(page) else {
            return map;
        };
        (map.width, map.height) = (size.width, size.height);
        map.collect(scene, atlas, page);
        let bins = Bins::new(&map);
        for row in 0..bins.rows {
            let tiles: Vec<Tile> =
                (0..bins.columns).into_par_iter().map(|column| map.tile(atlas, &bins, column, row)).collect();
            for tile in tiles {
                map.texels.extend(tile.texels);
                for n in tile.counts {
                    let end = map.offsets.last().copied().unwrap_or(0) + n;
                    map.offsets.push(end);
                }
                map.triangles.extend(tile.triangles);
            }
        }
        map
    }

    /// The same page with at most `n` of its covered texels, evenly spread, for measuring.
    #[must_use]
    pub fn thinned(&self, n: usize) -> Self {
        let step = self.texels.len().div_ceil(n.max(1)).max(1);
        let mut map = Self { texels: Vec::new(), offsets: vec![0], triangles: Vec::new(), ..self.clone() };
        for i in (0..self.texels.len()).step_by(step) {
            map.texels.push(self.texels[i]);
            map.triangles.extend_from_slice(self.triangles_of(i));
            map.offsets.push(index(map.triangles.len()));
        }
        map
    }

    /// The world triangles in the covered texel number `index`.
    pub fn triangles_of(&self, index: usize) -> &[u32] {
        &self.triangles[self.offsets[index] as usize..self.offsets[index + 1] as usize]
    }

    /// Column and row of the covered texel number `index`.
    pub fn position(&self, index: usize) -> [u32; 2] {
        [self.texels[index] % self.width, self.texels[index] / self.width]
    }

    /// Corners of a world triangle on the page, in texels.
    ///
    /// The triangle has to belong to a surface on this page, as those in `triangles` do.
    pub fn corners(&self, triangle: u32) -> [Vec2; 3] {
        let span = self.spans[self.span(triangle)];
        self.corners[(span.start + (triangle - span.first)) as usize]
    }

    fn span(&self, triangle: u32) -> usize {
        self.spans.partition_point(|s| s.first <= triangle) - 1
    }

    /// Corners relative to a texel's own corner.
    fn local(&self, triangle: u32, texel: u32) -> [DVec2; 3] {
        let origin = DVec2::new(f64::from(texel % self.width), f64::from(texel / self.width));
        self.corners(triangle).map(|c| c.as_dvec2() - origin)
    }

    fn collect(&mut self, scene: &Scene, atlas: &Atlas, page: usize) {
        let (mut first, mut chart) = (0, 0);
        for (surface, placement) in scene.surfaces.iter().zip(&atlas.placements) {
            let count = index(scene.meshes[surface.mesh].triangles.len());
            if let Some(p) = placement.filter(|p| p.page == page) {
                let layout = &atlas.layouts[p.layout];
                let start = index(self.corners.len());
                self.spans.push(Span { first, start, chart, layout: p.layout });
                self.corners.extend(layout.triangles.iter().zip(&layout.charts).map(|(t, c)| {
                    // A triangle without a chart is a point, and so covers nothing.
                    let corners = t.map(|v| atlas.texel_position(&p, v));
                    if *c == NO_CHART { [corners[0]; 3] } else { corners }
                }));
                let most = layout.charts.iter().filter(|c| **c != NO_CHART).max();
                chart += most.map_or(0, |c| c + 1);
            }
            first += count;
        }
    }

    /// Chart of a world triangle, counted over the page.
    pub fn chart(&self, atlas: &Atlas, triangle: u32) -> u32 {
        let span = self.spans[self.span(triangle)];
        span.chart + atlas.layouts[span.layout].charts[(triangle - span.first) as usize]
    }

    fn tile(&self, atlas: &Atlas, bins: &Bins, column: u32, row: u32) -> Tile {
        // Texel within the tile, triangle, area.
        let mut parts: Vec<(u32, u32, f64)> = Vec::new();
        let origin = DVec2::new(f64::from(column * TILE), f64::from(row * TILE));
        let (w, h) = (TILE.min(self.width - column * TILE), TILE.min(self.height - row * TILE));
        for &local in bins.list(column, row) {
            let corners = self.corners[local as usize].map(|c| c.as_dvec2() - origin);
            let triangle = self.world(local);
            coverage(&corners, w, h, |x, y| {
                let texel = DVec2::new(f64::from(x), f64::from(y));
                let area = clip::unit_square(&corners.map(|c| c - texel)).area().abs();
                if 0.0 < area {
                    parts.push((y * TILE + x, triangle, area));
                }
            });
        }
        parts.sort_unstable_by_key(|p| (p.0, p.1));
        let mut out = Tile::default();
        for texel in parts.chunk_by(|a, b| a.0 == b.0) {
            let (x, y) = (column * TILE + texel[0].0 % TILE, row * TILE + texel[0].0 / TILE);
            let before = out.triangles.len();
            let chart = self.widest_chart(atlas, texel);
            out.triangles.extend(
                texel.iter().map(|p| p.1).filter(|&t| chart.is_none_or(|c| self.chart(atlas, t) == c)),
            );
            out.texels.push(y * self.width + x);
            out.counts.push(index(out.triangles.len() - before));
        }
        out
    }

    /// The chart with the largest area among the parts of a texel; `None` if there is only one.
    fn widest_chart(&self, atlas: &Atlas, parts: &[(u32, u32, f64)]) -> Option<u32> {
        let first = self.chart(atlas, parts[0].1);
        if parts.iter().all(|p| self.chart(atlas, p.1) == first) {
            return None;
        }
        let mut areas: Vec<(u32, f64)> = Vec::new();
        for &(_, triangle, area) in parts {
            let chart = self.chart(atlas, triangle);
            match areas.iter_mut().find(|a| a.0 == chart) {
                Some(a) => a.1 += area,
                None => areas.push((chart, area)),
            }
        }
        areas.into_iter().min_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0))).map(|a| a.0)
    }

    /// World triangle of an entry of `corners`.
    fn world(&self, local: u32) -> u32 {
        let span = self.spans[self.spans.partition_point(|s| s.start <= local) - 1];
        span.first + (local - span.start)
    }
}

/// What one tile adds to the map.
#[derive(Default)]
struct Tile {
    texels: Vec<u32>,
    counts: Vec<u32>,
    triangles: Vec<u32>,
}

/// Triangles by the tiles they cover.
struct Bins {
    columns: u32,
    rows: u32,
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Bins {
    fn new(map: &TexelMap) -> Self {
        let (columns, rows) = (map.width.div_ceil(TILE), map.height.div_ceil(TILE));
        let tiles = columns as usize * rows as usize;
        let each = |corners: &[Vec2; 3], f: &mut dyn FnMut(usize)| {
            let scaled = corners.map(|c| c.as_dvec2() / f64::from(TILE));
            coverage(&scaled, columns, rows, |x, y| f(y as usize * columns as usize + x as usize));
        };
        let mut starts = vec![0_u32; tiles + 1];
        for c in &map.corners {
            each(c, &mut |tile| starts[tile + 1] += 1);
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut items = vec![0; starts[tiles] as usize];
        for (i, c) in (0_u32..).zip(&map.corners) {
            each(c, &mut |tile| {
                items[next[tile] as usize] = i;
                next[tile] += 1;
            });
        }
        Self { columns, rows, starts, items }
    }

    fn list(&self, column: u32, row: u32) -> &[u32] {
        let tile = row as usize * self.columns as usize + column as usize;
        &self.items[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }
}

/// Calls `f(x, y)` for every cell of a `width` x `height` grid of unit squares in which the
/// triangle has area, row by row. Rounding may add a cell that the triangle only touches; none is
/// left out.
pub(crate) fn coverage(t: &[DVec2; 3], width: u32, height: u32, mut f: impl FnMut(u32, u32)) {
    let lo = t[0].min(t[1]).min(t[2]);
    let hi = t[0].max(t[1]).max(t[2]);
    if super::atlas::cross(*t) == 0.0 || !(lo.is_finite() && hi.is_finite()) {
        return;
    }
    for y in cells(lo.y, hi.y, height) {
        let (top, bottom) = (f64::from(y), f64::from(y) + 1.0);
        let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut reach = |x: f64| (left, right) = (left.min(x), right.max(x));
        for i in 0..3 {
            let (a, b) = (t[i], t[(i + 1) % 3]);
            if top <= a.y && a.y <= bottom {
                reach(a.x);
            }
            for line in [top, bottom] {
                if (a.y < line && line < b.y) || (b.y < line && line < a.y) {
                    reach(a.x + (b.x - a.x) * ((line - a.y) / (b.y - a.y)));
                }
            }
        }
        for x in cells(left.max(lo.x), right.min(hi.x), width) {
            f(x, y);
        }
    }
}

/// Cells of unit length that an open interval meets.
fn cells(lo: f64, hi: f64, count: u32) -> std::ops::Range<u32> {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the casts saturate and the results are limited to the grid"
    )]
    let (from, to) = (lo.floor() as u32, hi.ceil() as u32);
    from..to.min(count)
}

/// Numbers of triangles and texels, which the loader keeps below 2^32.
fn index(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

#[cfg(test)]
#[expect(clippy::cast_possible_truncation, reason = "small meshes and cell numbers")]
mod tests;
