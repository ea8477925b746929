//! Where one surface goes on from one place of the atlas to another.
//!
//! A *seam* is a piece of an edge along which two triangles lie on one another in the world and continue each
//! other's surface smoothly, while their texels are at different places of the atlas: a chart that was cut open, two
//! charts or primitives of a mesh, or two objects that touch. Edges may overlap in part, as a long edge does with the
//! two short ones that end in its middle.
//!
//! Two edges lie on one another where they are closer than `GAP` of a texel and `PART` of the shorter edge, or
//! than positions are exact; they continue each other where the triangles lie on opposite sides of the edge and the
//! shading normals there differ by at most `MOST_TURN` degrees. A corner that is meant as one is no seam.
//!
//! Edges are cut into pieces of `PIECE` texels, so that their boxes are small, and a tree over those finds the
//! pairs: about `n log n` for `n` edges. Where copies lie in the same place, an edge is joined to `DEEP` others at most at any of its points, and knows
//! `NEAR` at most: a chain of seams does what a seam for every pair would. For Sponza (262,087 triangles, 13,605 seams) that is less than unwrapping varies
//! by from run to run, a tenth of a second. No length is absolute.

#[cfg(test)]
mod tests;

use glam::{DVec3, Vec2, Vec3, Vec3A};
use obvhs::Boundable;
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};
use rayon::prelude::*;

use crate::geom::atlas::{Atlas, Layout, NO_CHART};
use crate::geom::bvh::Bvh;
use crate::geom::ray::{Ray, offset_distance};
use crate::geom::world::World;
use crate::scene::model::Scene;

/// Widest gap between edges that touch, texels: less than light or a filter can show.
const GAP: f64 = 0.05;

/// Widest gap as a part of the shorter edge, so that small triangles do not touch everything around them.
const PART: f64 = 0.02;

/// Rounding of positions as a part of the scene's radius: four steps of `f32`.
const ROUNDING: f64 = 4.0 * f32::EPSILON as f64;

/// Most degrees between the shading normals of both sides. Flat neighbours have none, those that share vertex normals
/// next to none; 5 degrees let light that comes at 45 degrees differ by a twelfth.
const MOST_TURN: f32 = 5.0;

/// Length of a piece of an edge, texels.
const PIECE: f64 = 16.0;

/// Most pieces of an edge.
const MOST_PIECES: f64 = 4096.0;

/// Most edges that an edge is joined to at one of its points.
const DEEP: usize = 4;

/// Most edges near a piece that are looked at.
const NEAR: usize = 1024;

/// Coordinates that differ by less are the same place of the atlas, texels: below what `f32` resolves on a large page.
const SAME_PLACE: f32 = 1.0 / 512.0;

/// Places a texel along a seam, at least, at which both sides are compared.
const PLACES: f32 = 2.0;

/// Where the test for things that stand on a seam starts and ends, texels beside it.
const BESIDE: f32 = 1.0;

/// How far above the surface that test goes, texels: over the fold of a sphere of few triangles.
const ABOVE: f32 = 0.5;

/// A piece of an edge that two triangles share in the world and not in the atlas.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seam {
    /// World triangles.
    pub triangles: [u32; 2],
    /// Edge of each triangle: from corner `n` to the next.
    pub edges: [u8; 2],
    /// Where the piece begins and ends on each edge, from 0 to 1; both begin at the same place.
    pub spans: [[f32; 2]; 2],
    /// Whether the front of one side goes on in the front of the other, and not in the back of a double-sided one.
    pub aligned: bool,
}

/// The seams of a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Seams {
    /// Sorted by triangles.
    pub list: Vec<Seam>,
    bytes_to_find: usize,
}

/// A point of a seam, seen from one side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Page of the atlas.
    pub page: usize,
    /// Where on the page, texels.
    pub at: Vec2,
}

impl Seams {
    /// Finds the seams of a scene with the given atlas.
    #[must_use]
    pub fn find(scene: &Scene, world: &World, atlas: &Atlas) -> Self {
        let edges = borders(world, atlas);
        let list = pairs(scene, world, atlas, &edges);
        // For each piece its owner, box, two lists of clusters, number and two nodes.
        let pieces: usize = edges.iter().map(|e| usize::from(e.pieces)).sum();
        let bytes_to_find = size_of_val(edges.as_slice()) + pieces * (16 + 32 + 2 * 48 + 16 + 2 * 48);
        Self { list, bytes_to_find }
    }

    /// Whether some lead from one page to another.
    #[must_use]
    pub fn join_pages(&self, world: &World, atlas: &Atlas) -> bool {
        self.list.iter().any(|s| s.page(world, atlas, 0) != s.page(world, atlas, 1))
    }

    /// Places a page along the seams, [`Seam::n_places`] each; seams between pages count with the first of theirs.
    #[must_use]
    pub fn places(&self, world: &World, atlas: &Atlas) -> Vec<u64> {
        let mut sums = vec![0; atlas.pages.len()];
        for seam in &self.list {
            sums[seam.page(world, atlas, 0)] += u64::from(seam.n_places(world, atlas));
        }
        sums
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(self.list.as_slice())
    }

    /// Bytes that finding needed for a moment.
    #[must_use]
    pub fn bytes_to_find(&self) -> usize {
        self.bytes_to_find
    }
}

impl Seam {
    /// Page of one side.
    #[must_use]
    pub fn page(&self, world: &World, atlas: &Atlas, side: usize) -> usize {
        atlas.placements[world.surface(self.triangles[side])].map_or(0, |p| p.page)
    }

    /// The point at `t`, from 0 to 1 along the seam, on one side's place of the atlas.
    #[must_use]
    pub fn place(&self, world: &World, atlas: &Atlas, side: usize, t: f32) -> Place {
        let (surface, local) = world.locate(self.triangles[side]);
        let Some(p) = &atlas.placements[surface] else { return Place { page: 0, at: Vec2::ZERO } };
        let corners = atlas.layouts[p.layout].triangles[local];
        let [a, b] = ends(corners, self.edges[side]).map(|v| atlas.texel_position(p, v));
        Place { page: p.page, at: a.lerp(b, self.along(side, t)) }
    }

    /// Length on each side's place of the atlas, texels.
    #[must_use]
    pub fn texels(&self, world: &World, atlas: &Atlas) -> [f32; 2] {
        [0, 1].map(|side| {
            let [a, b] = [0.0, 1.0].map(|t| self.place(world, atlas, side, t).at);
            a.distance(b)
        })
    }

    /// At how many places, evenly spread, both sides are compared: `PLACES` a texel.
    #[must_use]
    pub fn n_places(&self, world: &World, atlas: &Atlas) -> u16 {
        let [a, b] = self.texels(world, atlas);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the cast saturates")]
        let n = (PLACES * a.max(b)).ceil().max(1.0) as u16;
        n
    }

    /// Length, metres.
    #[must_use]
    pub fn length(&self, world: &World) -> f32 {
        let [a, b] = ends(world.corners(self.triangles[0]), self.edges[0]);
        let [from, to] = self.spans[0];
        a.distance(b) * (to - from).abs()
    }

    /// Whether nothing opaque stands on the seam at `t`: a short way over it, from a texel beside it on one side to a
    /// texel beside it on the other, is free. A wall on the seam between two floors parts their light. Sides that are
    /// `turned` show their backs.
    #[must_use]
    pub fn is_open(&self, world: &World, atlas: &Atlas, bvh: &Bvh, t: f32, turned: [bool; 2]) -> bool {
        let mut over = [Vec3A::ZERO; 2];
        for side in [0, 1] {
            let triangle = self.triangles[side];
            let point = world.point(triangle, weights(self.edges[side], self.along(side, t)));
            let density = atlas.placements[world.surface(triangle)].map_or(0.0, |p| p.texels_per_metre);
            if density <= 0.0 {
                return false;
            }
            let up = if turned[side] { -point.shading_normal } else { point.shading_normal };
            let height = (ABOVE / density).max(offset_distance(world.radius));
            let [a, b] = ends(world.corners(triangle), self.edges[side]).map(Vec3A::from);
            let c = Vec3A::from(world.corners(triangle)[usize::from(self.edges[side] + 2) % 3]);
            let inward = (c - a).reject_from(b - a).normalize_or_zero();
            over[side] = point.position + inward * (BESIDE / density) + up * height;
        }
        let way = over[1] - over[0];
        let ray = Ray { origin: over[0], direction: way.normalize_or_zero(), t_max: way.length() };
        !bvh.occluded(&ray, |_| false)
    }

    /// Where `t` along the seam is on one side's edge.
    fn along(&self, side: usize, t: f32) -> f32 {
        let [from, to] = self.spans[side];
        from + (to - from) * t
    }
}

/// The two ends of edge `n` of a triangle.
fn ends<T: Copy>(corners: [T; 3], n: u8) -> [T; 2] {
    [corners[usize::from(n)], corners[usize::from(n + 1) % 3]]
}

/// Barycentric weights at `t` along edge `n`.
fn weights(n: u8, t: f32) -> [f32; 3] {
    let mut w = [0.0; 3];
    w[usize::from(n)] = 1.0 - t;
    w[usize::from(n + 1) % 3] = t;
    w
}

/// An edge at a chart's border.
#[derive(Clone, Copy, Debug)]
struct Edge {
    triangle: u32,
    number: u8,
    ends: [Vec3; 2],
    /// Widest gap to what touches it, metres.
    gap: f32,
    /// Pieces for the tree.
    pieces: u16,
    /// Boxes are larger by this factor of the gap. It differs from edge to edge: a tree over equal boxes takes as many steps as there are.
    margin: f32,
}

/// The borders of all charts, in the order of triangles.
fn borders(world: &World, atlas: &Atlas) -> Vec<Edge> {
    let of_layout: Vec<Vec<(u32, u8)>> = atlas.layouts.par_iter().map(border).collect();
    let mut edges = Vec::new();
    for (surface, placement) in atlas.placements.iter().enumerate() {
        let Some(p) = placement else { continue };
        let density = f64::from(p.texels_per_metre);
        if density <= 0.0 {
            continue;
        }
        for &(local, number) in &of_layout[p.layout] {
            let triangle = world.first_triangle[surface] + local;
            let ends = ends(world.corners(triangle), number);
            let length = ends[0].as_dvec3().distance(ends[1].as_dvec3());
            if !(0.0 < length && length.is_finite()) || world.geometric_normal(triangle) == Vec3A::ZERO {
                continue;
            }
            let gap = (GAP / density).min(PART * length).max(ROUNDING * f64::from(world.radius));
            let pieces = (length * density / PIECE).ceil().clamp(1.0, MOST_PIECES);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped; a length")]
            edges.push(Edge {
                triangle,
                number,
                ends,
                gap: gap as f32,
                pieces: pieces as u16,
                margin: margin(edges.len()),
            });
        }
    }
    edges
}

/// A factor from 2 to 4 for the edge of a number.
#[expect(clippy::cast_possible_truncation, reason = "any bits do")]
fn margin(i: usize) -> f32 {
    let bits = (i as u32).wrapping_mul(0x9e37_79b9) >> 8;
    2.0 + 2.0 * bits as f32 / (1 << 24) as f32
}

/// Edges of a layout that belong to one triangle alone: triangle and number of the edge.
fn border(layout: &Layout) -> Vec<(u32, u8)> {
    // Edges by the bits of their ends, so that both triangles at an edge name it alike.
    let mut edges: Vec<([[u32; 2]; 2], u32, u8)> = Vec::with_capacity(3 * layout.triangles.len());
    for ((t, chart), i) in layout.triangles.iter().zip(&layout.charts).zip(0..) {
        if *chart == NO_CHART {
            continue;
        }
        for number in 0..3 {
            // Adding zero makes both zeros the same.
            let bits = |v: u32| (layout.uvs[v as usize] + 0.0).to_array().map(f32::to_bits);
            let mut key = ends(*t, number).map(bits);
            key.sort_unstable();
            edges.push((key, i, number));
        }
    }
    edges.sort_unstable();
    let single = edges.chunk_by(|a, b| a.0 == b.0).filter(|same| same.len() == 1);
    let mut list: Vec<(u32, u8)> = single.map(|same| (same[0].1, same[0].2)).collect();
    list.sort_unstable();
    list
}

struct Boxed(Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

impl Edge {
    /// The box around a piece, with the gap.
    fn bounds(&self, piece: u16) -> Aabb {
        let at = |n: u16| self.ends[0].lerp(self.ends[1], f32::from(n) / f32::from(self.pieces));
        let (a, b) = (Vec3A::from(at(piece)), Vec3A::from(at(piece + 1)));
        // Rounding of the ends is below the gap, which is at least four steps of the largest coordinate.
        let more = Vec3A::splat(self.margin * self.gap);
        Aabb { min: a.min(b) - more, max: a.max(b) + more }
    }
}

fn pairs(scene: &Scene, world: &World, atlas: &Atlas, edges: &[Edge]) -> Vec<Seam> {
    let owners: Vec<(usize, u16)> =
        edges.iter().enumerate().flat_map(|(i, e)| (0..e.pieces).map(move |p| (i, p))).collect();
    let boxes: Vec<Boxed> = owners.iter().map(|&(i, p)| Boxed(edges[i].bounds(p))).collect();
    if boxes.is_empty() {
        return Vec::new();
    }
    #[expect(clippy::cast_possible_truncation, reason = "a border has far fewer than 2^32 texels")]
    let indices = (0..boxes.len() as u32).collect();
    let tree: Bvh2 = PlocBuilder::with_capacity(boxes.len()).build(
        PlocSearchDistance::Minimum,
        &boxes,
        indices,
        SortPrecision::U64,
        1,
    );
    let context = Context { scene, world, atlas, least: MOST_TURN.to_radians().cos() };
    let found: Vec<Vec<Seam>> = edges
        .par_iter()
        .enumerate()
        .map(|(i, edge)| {
            let mut near: Vec<usize> = Vec::new();
            for piece in 0..edge.pieces {
                let most = near.len() + NEAR;
                tree.aabb_traverse(edge.bounds(piece), |tree, node| {
                    let node = &tree.nodes[node as usize];
                    let first = node.first_index as usize;
                    let leaves = &tree.primitive_indices[first..first + node.prim_count as usize];
                    // Each pair once.
                    near.extend(
                        leaves.iter().map(|&leaf| owners[leaf as usize].0).filter(|&other| i < other),
                    );
                    near.len() < most
                });
            }
            near.sort_unstable();
            near.dedup();
            let found = near.iter().filter_map(|&other| context.seam(edge, &edges[other])).collect();
            shallow(found)
        })
        .collect();
    found.into_iter().flatten().collect()
}

/// Those seams of an edge, the first side of each, that lie over none of its points more than [`DEEP`] times; longer ones come first.
fn shallow(mut seams: Vec<Seam>) -> Vec<Seam> {
    if seams.len() <= DEEP {
        return seams;
    }
    let length = |s: &Seam| s.spans[0][1] - s.spans[0][0];
    // Among copies something arbitrary decides, so that none of them is left out by all others.
    let mixed = |s: &Seam| {
        let [a, b] = s.triangles;
        (a ^ b.rotate_left(16)).wrapping_mul(0x9e37_79b9).rotate_left(16).wrapping_mul(0x85eb_ca6b)
    };
    seams.sort_by(|a, b| length(b).total_cmp(&length(a)).then(mixed(a).cmp(&mixed(b))));
    let mut kept: Vec<Seam> = Vec::new();
    for seam in seams {
        let middle = 0.5 * (seam.spans[0][0] + seam.spans[0][1]);
        let over = |s: &&Seam| s.spans[0][0] <= middle && middle <= s.spans[0][1];
        if kept.iter().filter(over).count() < DEEP {
            kept.push(seam);
        }
    }
    kept.sort_by_key(|s| (s.triangles, s.edges));
    kept
}

struct Context<'a> {
    scene: &'a Scene,
    world: &'a World,
    atlas: &'a Atlas,
    /// Least cosine between normals.
    least: f32,
}

impl Context<'_> {
    /// The seam where two edges lie on one another, if there is one.
    fn seam(&self, a: &Edge, b: &Edge) -> Option<Seam> {
        if a.triangle == b.triangle {
            return None;
        }
        let spans = overlap(a, b)?;
        let [inward_a, inward_b] = [a, b].map(|e| self.inward(e));
        if 0.0 <= inward_a.dot(inward_b) {
            return None;
        }
        let cosines = [0, 1].map(|end| {
            let normal = |e: &Edge, span: [f32; 2]| {
                self.world.point(e.triangle, weights(e.number, span[end])).shading_normal
            };
            normal(a, spans[0]).dot(normal(b, spans[1]))
        });
        let aligned = if cosines.iter().all(|&c| self.least <= c) {
            true
        } else if cosines.iter().all(|&c| c <= -self.least) && (self.two_sided(a) || self.two_sided(b)) {
            false
        } else {
            return None;
        };
        let seam = Seam { triangles: [a.triangle, b.triangle], edges: [a.number, b.number], spans, aligned };
        let same = [0.0, 1.0].map(|t| {
            let [p, q] = [0, 1].map(|side| seam.place(self.world, self.atlas, side, t));
            p.page == q.page && (p.at - q.at).abs().max_element() < SAME_PLACE
        });
        (same != [true; 2]).then_some(seam)
    }

    fn two_sided(&self, e: &Edge) -> bool {
        self.world.material(self.scene, e.triangle).double_sided
    }

    /// Unit vector in the triangle's plane, from the edge into the triangle.
    fn inward(&self, e: &Edge) -> Vec3 {
        let [a, b] = e.ends;
        let c = self.world.corners(e.triangle)[usize::from(e.number + 2) % 3];
        // Scaled, so that millimetres and 100 km keep their products in range.
        let scale = (b - a).abs().max_element().max((c - a).abs().max_element());
        ((c - a) / scale).reject_from((b - a) / scale).normalize_or_zero()
    }
}

/// Where two edges lie on one another: from and to on each, from 0 to 1.
fn overlap(a: &Edge, b: &Edge) -> Option<[[f32; 2]; 2]> {
    let gap = f64::from(a.gap.min(b.gap));
    let [a0, a1] = a.ends.map(|p| p.as_dvec3());
    let [b0, b1] = b.ends.map(|p| p.as_dvec3());
    let length = a0.distance(a1);
    let along = (a1 - a0) / length;
    let (s0, s1) = ((b0 - a0).dot(along), (b1 - a0).dot(along));
    let (from, to) = (s0.min(s1).max(0.0), s0.max(s1).min(length));
    if to - from <= 2.0 * gap {
        return None;
    }
    let on_b = |s: f64| ((s - s0) / (s1 - s0)).clamp(0.0, 1.0);
    let apart = |s: f64| {
        let p: DVec3 = a0 + along * s;
        p.distance(b0.lerp(b1, on_b(s)))
    };
    if gap < apart(from) || gap < apart(to) {
        return None;
    }
    let part = |s: f64| (s / length).clamp(0.0, 1.0);
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
    let single = |x: f64| x as f32;
    Some([[single(part(from)), single(part(to))], [single(on_b(from)), single(on_b(to))]])
}
