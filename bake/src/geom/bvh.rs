//! Bounding volume hierarchy: built by `obvhs`, traversed here.
//!
//! The traversal is conservative (slab distances are widened by their rounding error, \[Ize13\]
//! Ize, "Robust BVH Ray Traversal", JCGT 2(2), 2013) and the triangle test watertight, so that a
//! closed mesh lets no ray through. Ties in distance go to the lower triangle index, so results do
//! not depend on the tree.

use crate::error::Error;
use crate::geom::ray::{Hit, Ray, WatertightRay};
use crate::geom::world::World;
use glam::{Vec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::builder::build_bvh2;
use obvhs::{Boundable, BvhBuildParams};
use std::time::Duration;

/// How a triangle lets light through, as far as the traversal has to know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Opacity {
    /// Every hit counts.
    Opaque,
    /// The caller decides at each hit.
    Ask,
}

/// A tree over the triangles that take part in light transport.
#[derive(Clone, Debug, Default)]
pub struct Bvh {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    /// Nothing to hit.
    empty: bool,
}

/// An inner node holds the boxes of its two children, so that one cache line and a half decides both.
#[derive(Clone, Copy, Debug)]
struct Node {
    lo: [Vec3A; 2],
    hi: [Vec3A; 2],
    /// Inner child: node index. Leaf child: first entry of `leaves`.
    first: [u32; 2],
    /// 0 for an inner child.
    count: [u32; 2],
}

#[derive(Clone, Copy, Debug)]
struct Leaf {
    v: [Vec3; 3],
    triangle: u32,
    ask: bool,
}

struct Boxed(Aabb);

impl Boundable for Boxed {
    fn aabb(&self) -> Aabb {
        self.0
    }
}

/// Deeper than any tree that obvhs builds over fewer than 2^32 triangles.
const STACK: usize = 128;

/// Widens the far slab distance by its rounding error: \[Ize13\] section 3.
const WIDEN: f32 = 1.000_000_4;

impl Bvh {
    /// Builds the tree over the triangles for which `take` is some; triangles without area are left out.
    ///
    /// # Errors
    ///
    /// If the tree is deeper than the traversal's stack, which no real geometry reaches.
    #[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^32 triangles")]
    pub fn build(world: &World, take: impl Fn(u32) -> Option<Opacity>) -> Result<Self, Error> {
        let mut leaves: Vec<Leaf> = Vec::new();
        for (i, &v) in world.triangles.iter().enumerate() {
            let i = i as u32;
            if let Some(opacity) = take(i)
                && v.iter().all(|p| p.is_finite())
                && world.geometric_normal(i) != Vec3A::ZERO
            {
                leaves.push(Leaf { v, triangle: i, ask: opacity == Opacity::Ask });
            }
        }
        if leaves.is_empty() {
            return Ok(Self { empty: true, ..Self::default() });
        }
        let boxes: Vec<Boxed> =
            leaves.iter().map(|l| Boxed(Aabb::from_points(&l.v.map(Vec3A::from)))).collect();
        let tree = build_bvh2(&boxes, BvhBuildParams::medium_build(), &mut Duration::default());
        let ordered = tree.primitive_indices.iter().map(|&i| leaves[i as usize]).collect();
        let mut bvh =
            Self { nodes: Vec::with_capacity(tree.nodes.len() / 2 + 1), leaves: ordered, empty: false };
        bvh.convert(&tree)?;
        Ok(bvh)
    }

    /// Turns obvhs' nodes (a box each) into ours (the boxes of both children).
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 nodes")]
    fn convert(&mut self, tree: &obvhs::bvh2::Bvh2) -> Result<(), Error> {
        // Comparisons with NaN are false: nothing enters such a box.
        let unused = Aabb { min: Vec3A::NAN, max: Vec3A::NAN };
        let root = tree.nodes[0];
        if 0 < root.prim_count {
            self.nodes.push(Node {
                lo: [root.aabb.min, unused.min],
                hi: [root.aabb.max, unused.max],
                first: [root.first_index, 0],
                count: [root.prim_count, 0],
            });
            return Ok(());
        }
        let mut work = vec![(0u32, u32::MAX, 0usize, 0usize)];
        while let Some((source, parent, slot, depth)) = work.pop() {
            if STACK <= depth + 1 {
                return Err(Error::Usage(format!("the ray tree is deeper than {STACK} levels")));
            }
            let here = self.nodes.len() as u32;
            if parent != u32::MAX {
                self.nodes[parent as usize].first[slot] = here;
            }
            let first = tree.nodes[source as usize].first_index as usize;
            let (a, b) = (&tree.nodes[first], &tree.nodes[first + 1]);
            self.nodes.push(Node {
                lo: [a.aabb.min, b.aabb.min],
                hi: [a.aabb.max, b.aabb.max],
                first: [a.first_index, b.first_index],
                count: [a.prim_count, b.prim_count],
            });
            if b.prim_count == 0 {
                work.push((first as u32 + 1, here, 1, depth + 1));
            }
            if a.prim_count == 0 {
                work.push((first as u32, here, 0, depth + 1));
            }
        }
        Ok(())
    }

    /// The nearest hit. `accept` is asked about triangles built with [`Opacity::Ask`].
    #[must_use]
    pub fn closest(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
        let mut best: Option<Hit> = None;
        self.traverse(ray, |hit, ask| {
            let nearer = best.is_none_or(|b| hit.t < b.t || (hit.t == b.t && hit.triangle < b.triangle));
            if nearer && (!ask || accept(&hit)) {
                best = Some(hit);
            }
            // Ties stay visible to later triangles: the limit is the next float above.
            best.map_or(ray.t_max, |b| b.t.next_up())
        });
        best
    }

    /// Whether anything blocks the ray before its end. `blocks` is asked about triangles built with
    /// [`Opacity::Ask`] and may keep account of what it lets pass; it sees each hit once, in an order
    /// that is the same on every run.
    #[must_use]
    pub fn occluded(&self, ray: &Ray, mut blocks: impl FnMut(&Hit) -> bool) -> bool {
        let mut blocked = false;
        self.traverse(ray, |hit, ask| {
            if !ask || blocks(&hit) {
                blocked = true;
                return 0.0;
            }
            ray.t_max
        });
        blocked
    }

    /// Visits every triangle hit within a limit that `visit` returns and may shrink; 0 stops.
    #[inline]
    fn traverse(&self, ray: &Ray, mut visit: impl FnMut(Hit, bool) -> f32) {
        if self.empty || !ray.origin.is_finite() || !ray.direction.is_finite() {
            return;
        }
        // A zero component becomes tiny: no 0 * inf, and no box is left out by it.
        let tiny = Vec3A::splat(1e-30);
        let d = Vec3A::select(ray.direction.abs().cmplt(tiny), tiny.copysign(ray.direction), ray.direction);
        let inv = d.recip();
        let exact = WatertightRay::new(ray);
        let mut limit = ray.t_max;
        let mut stack = [(0u32, 0.0f32); STACK];
        let mut top = 0;
        let mut current = 0u32;
        loop {
            let node = &self.nodes[current as usize];
            let mut near = [f32::INFINITY; 2];
            let mut open = [false; 2];
            for k in 0..2 {
                let a = (node.lo[k] - ray.origin) * inv;
                let b = (node.hi[k] - ray.origin) * inv;
                near[k] = a.min(b).max_element().max(0.0);
                let far = a.max(b).min_element() * WIDEN;
                open[k] = near[k] <= far && near[k] <= limit;
            }
            for (k, open) in open.iter_mut().enumerate() {
                if *open && 0 < node.count[k] {
                    *open = false;
                    let first = node.first[k] as usize;
                    for leaf in &self.leaves[first..first + node.count[k] as usize] {
                        if let Some((t, bary)) = exact.intersect(&leaf.v, limit) {
                            limit = visit(Hit { t, triangle: leaf.triangle, bary }, leaf.ask);
                            if limit <= 0.0 {
                                return;
                            }
                        }
                    }
                }
            }
            if open[0] && open[1] {
                let far = usize::from(near[0] <= near[1]);
                stack[top] = (node.first[far], near[far]);
                top += 1;
                current = node.first[1 - far];
            } else if open[0] || open[1] {
                current = node.first[usize::from(open[1])];
            } else {
                loop {
                    if top == 0 {
                        return;
                    }
                    top -= 1;
                    if stack[top].1 <= limit {
                        break;
                    }
                }
                current = stack[top].0;
            }
        }
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.leaves.as_slice())
    }
}

#[cfg(test)]
#[expect(clippy::cast_possible_truncation, reason = "small meshes")]
mod tests {
    use super::*;
    use crate::sample::{Sequence, sequence::key};

    fn world(triangles: Vec<[Vec3; 3]>) -> World {
        let mut scene = crate::scene::model::Scene::default();
        let n = triangles.len() as u32;
        scene.meshes.push(crate::scene::model::Mesh {
            positions: triangles.into_iter().flatten().collect(),
            triangles: (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            ..Default::default()
        });
        scene.materials.push(Default::default());
        scene.surfaces.push(crate::scene::model::Surface {
            path: String::new(),
            node: 0,
            gpu_instance: None,
            mesh: 0,
            material: 0,
            world_from_mesh: glam::Affine3A::IDENTITY,
            lightmap: Default::default(),
            casts_shadow: true,
            texels_per_metre: None,
        });
        World::new(&scene)
    }

    fn random_rays(n: u32) -> impl Iterator<Item = Ray> {
        (0..n).map(|i| {
            let mut s = Sequence::new(key(1, 2, u64::from(i)), 0);
            let (a, b) = (s.next4(), s.next4());
            Ray {
                origin: Vec3A::new(a[0], a[1], a[2]) * 3.0 - 1.5,
                direction: (Vec3A::new(b[0], b[1], b[2]) - 0.5).normalize_or(Vec3A::X),
                t_max: f32::INFINITY,
            }
        })
    }

    fn soup(n: u32, size: f32) -> Vec<[Vec3; 3]> {
        (0..n)
            .map(|i| {
                let mut s = Sequence::new(key(3, 4, u64::from(i)), 0);
                let (a, b, c) = (s.next4(), s.next4(), s.next4());
                let p = Vec3::new(a[0], a[1], a[2]) * 2.0 - 1.0;
                [p, p + Vec3::new(b[0], b[1], b[2]) * size, p + Vec3::new(c[0], c[1], c[2]) * size]
            })
            .collect()
    }

    /// The tree gives what a scan over all triangles gives, for 0, 1, 2 and many triangles.
    #[test]
    fn tree_equals_linear_scan() {
        for n in [0, 1, 2, 3, 700] {
            let w = world(soup(n, 0.4));
            let bvh = Bvh::build(&w, |_| Some(Opacity::Opaque)).expect("builds");
            let mut hits = 0;
            for ray in random_rays(2000) {
                let exact = WatertightRay::new(&ray);
                let mut want: Option<Hit> = None;
                for (i, v) in w.triangles.iter().enumerate() {
                    if let Some((t, bary)) = exact.intersect(v, ray.t_max)
                        && want.is_none_or(|h| t < h.t)
                    {
                        want = Some(Hit { t, triangle: i as u32, bary });
                    }
                }
                let got = bvh.closest(&ray, |_| true);
                assert_eq!(got, want, "{ray:?}");
                assert_eq!(bvh.occluded(&ray, |_| true), want.is_some());
                hits += u32::from(want.is_some());
            }
            assert!(n < 100 || 200 < hits);
        }
    }

    /// Nothing leaves a closed, finely subdivided mesh, also where rays are aimed at its edges and corners.
    #[test]
    fn closed_mesh_is_watertight() {
        // A power of two, so that both sides of the cube compute the same corners to the bit.
        let n = 16;
        let mut tris = Vec::new();
        let point = |face: usize, i: u32, j: u32| {
            let (a, b) = (i as f32 / n as f32 * 2.0 - 1.0, j as f32 / n as f32 * 2.0 - 1.0);
            let p = [Vec3::new(a, b, 1.0), Vec3::new(a, 1.0, b), Vec3::new(1.0, a, b)][face % 3];
            (if face < 3 { p } else { -p }).normalize() * 1.3
        };
        for face in 0..6 {
            for i in 0..n {
                for j in 0..n {
                    let q = [
                        point(face, i, j),
                        point(face, i + 1, j),
                        point(face, i + 1, j + 1),
                        point(face, i, j + 1),
                    ];
                    tris.push([q[0], q[1], q[2]]);
                    tris.push([q[0], q[2], q[3]]);
                }
            }
        }
        let corners: Vec<Vec3> = tris.iter().flatten().copied().collect();
        let w = world(tris);
        let bvh = Bvh::build(&w, |_| Some(Opacity::Opaque)).expect("builds");
        let mut escaped = 0;
        for i in 0..200_000u32 {
            let mut s = Sequence::new(key(8, 9, u64::from(i)), 0);
            let a = s.next4();
            let origin = (Vec3A::new(a[0], a[1], a[2]) - 0.5) * 0.8;
            let (c, e) = (corners[i as usize % corners.len()], corners[(i as usize + 1) % corners.len()]);
            let target = Vec3A::from(if i % 2 == 0 { c } else { c + (e - c) * a[3] }) - Vec3A::from(w.origin);
            let ray = Ray { origin, direction: (target - origin).normalize(), t_max: f32::INFINITY };
            escaped += u32::from(bvh.closest(&ray, |_| true).is_none());
        }
        assert_eq!(escaped, 0);
    }

    /// Poison: boxes without volume, points, and coordinates at the end of the range.
    #[test]
    fn poisoned_input_neither_hangs_nor_hits() {
        let mut tris = soup(50, 0.3);
        tris.push([Vec3::ZERO; 3]);
        tris.push([Vec3::X, Vec3::X, Vec3::Y]);
        tris.push([Vec3::splat(1e30), Vec3::new(1e30, -1e30, 0.0), Vec3::NEG_ONE * 1e30]);
        let mut w = world(tris);
        w.triangles[3][0].x = f32::NAN;
        w.triangles[4][1].y = f32::INFINITY;
        let bvh = Bvh::build(&w, |_| Some(Opacity::Opaque)).expect("builds");
        for ray in random_rays(500) {
            if let Some(hit) = bvh.closest(&ray, |_| true) {
                assert!(hit.t.is_finite() && ![3, 4, 50, 51].contains(&hit.triangle));
            }
        }
        let nan = Ray { origin: Vec3A::NAN, direction: Vec3A::X, t_max: 1.0 };
        assert!(bvh.closest(&nan, |_| true).is_none());
    }

    /// Of two coincident triangles the lower index wins, whatever the tree looks like.
    #[test]
    fn ties_go_to_the_lower_index() {
        let mut tris = soup(300, 0.4);
        let copy = tris.clone();
        tris.extend(copy);
        let w = world(tris);
        let bvh = Bvh::build(&w, |_| Some(Opacity::Opaque)).expect("builds");
        let hits: Vec<Hit> = random_rays(1000).filter_map(|r| bvh.closest(&r, |_| true)).collect();
        assert!(100 < hits.len() && hits.iter().all(|h| h.triangle < 300));
    }
}
