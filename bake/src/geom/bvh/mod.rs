//! Bounding volume hierarchy: a binary tree by `obvhs`, made eight-wide and traversed here.
//!
//! The traversal is conservative (slab distances are widened by their rounding error, \[Ize13\]
//! Ize, "Robust BVH Ray Traversal", JCGT 2(2), 2013) and the triangle test watertight, so that a
//! closed mesh lets no ray through. Ties in distance go to the lower triangle index, so results do
//! not depend on the tree.
//!
//! Nodes hold eight boxes and leaves eight triangles, component by component. With AVX2 and FMA one
//! ray meets eight of them at once; without, the same results come from plain loops.
//!
//! Speed against Embree 3.13.5 (`rtcIntersect1`, `rtcOccluded1`, a mesh with default settings, and
//! in brackets with `RTC_SCENE_FLAG_ROBUST`), by `benches/rays` on 2026-11-22, Intel Xeon of family 6
//! model 167 with 2 shared cores, one thread, medians of 9 rounds; above 1 this tree is faster:
//!
//! | scene | triangles | nearest hit, first bounce | second bounce | occlusion, segments | bytes a triangle |
//! |---|---|---|---|---|---|
//! | Sponza | 262,087 | 1.11 (1.27) | 1.15 (1.35) | 1.13 (1.37) | 74 |
//! | staircase | 262,663 | 1.19 (1.40) | 1.20 (1.43) | 1.15 (1.49) | 70 |
//! | stones, generated | 1,048,588 | 0.94 (1.13) | 0.95 (1.14) | 0.93 (1.08) | 72 |
//!
//! Occlusion of bounced half lines: 1.12 to 1.54 in the files, 3.2 to 3.4 in the stones, where the order of
//! children makes large walls come first. The stones mostly wait for memory: other work on the machine has
//! moved their first two figures between 0.85 and 0.99.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod build;
mod node;
mod portable;
#[cfg(test)]
mod tests;
mod traverse;

use crate::error::Error;
use crate::geom::ray::{Hit, Ray};
use crate::geom::world::World;
use node::{Block, Child, Node};
use portable::Portable;
use traverse::{ALL, NONE, SOME};

/// How a triangle lets light through, as far as the traversal has to know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Opacity {
    /// Every hit counts.
    Opaque,
    /// The caller decides at each hit.
    Ask,
}

/// A tree over the triangles that take part in light transport.
#[derive(Clone, Debug)]
pub struct Bvh {
    nodes: Vec<Node>,
    /// The first is empty.
    blocks: Vec<Block>,
    /// Which triangles of each block are [`Opacity::Ask`].
    asking: Vec<u8>,
    /// Whether rays look up which those are.
    asks: bool,
    root: Child,
    #[cfg(target_arch = "x86_64")]
    avx2: Option<avx2::Available>,
}

impl Default for Bvh {
    fn default() -> Self {
        Self {
            nodes: Vec::new(),
            blocks: vec![Block::empty()],
            asking: vec![0],
            asks: false,
            root: Child::NOTHING,
            #[cfg(target_arch = "x86_64")]
            avx2: avx2::Available::detect(),
        }
    }
}

impl Bvh {
    /// Builds the tree over the triangles for which `take` is some; triangles without area are left out.
    ///
    /// # Errors
    ///
    /// If the tree is deeper than the traversal's stack, which no real geometry reaches.
    pub fn build(world: &World, take: impl Fn(u32) -> Option<Opacity>) -> Result<Self, Error> {
        let mut bvh = build::build(world, take)?;
        bvh.asks = bvh.asking.iter().any(|a| *a != 0);
        Ok(bvh)
    }

    /// Whether every triangle is [`Opacity::Opaque`] and rays rely on it: none of them asks its caller.
    #[must_use]
    #[inline]
    pub fn is_opaque(&self) -> bool {
        !self.asks
    }

    /// Lets rays look up whether triangles are [`Opacity::Ask`] although none is.
    pub fn ask_always(&mut self) {
        self.asks = true;
    }

    /// Whether rays meet eight boxes at once with AVX2.
    #[must_use]
    pub fn uses_avx2(&self) -> bool {
        #[cfg(target_arch = "x86_64")]
        return self.avx2.is_some();
        #[cfg(not(target_arch = "x86_64"))]
        false
    }

    /// Takes the plain loops even where the processor has AVX2: the same results.
    pub fn use_plain_loops(&mut self) {
        #[cfg(target_arch = "x86_64")]
        {
            self.avx2 = None;
        }
    }

    /// The nearest hit. `accept` is asked about triangles built with [`Opacity::Ask`].
    #[must_use]
    #[inline]
    pub fn closest(&self, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return if self.asks {
                avx2.closest::<true>(self, ray, accept)
            } else {
                avx2.closest::<false>(self, ray, accept)
            };
        }
        if self.asks {
            traverse::closest::<Portable, true>(self, ray, accept)
        } else {
            traverse::closest::<Portable, false>(self, ray, accept)
        }
    }

    /// Whether anything blocks the ray before its end. `blocks` is asked about triangles built with
    /// [`Opacity::Ask`] and may keep account of what it lets pass; it sees each hit once, in an order
    /// that is the same on every run.
    #[must_use]
    #[inline]
    pub fn occluded(&self, ray: &Ray, blocks: impl FnMut(&Hit) -> bool) -> bool {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return if self.asks {
                avx2.occluded::<SOME>(self, ray, blocks)
            } else {
                avx2.occluded::<NONE>(self, ray, blocks)
            };
        }
        if self.asks {
            traverse::occluded::<Portable, SOME>(self, ray, blocks)
        } else {
            traverse::occluded::<Portable, NONE>(self, ray, blocks)
        }
    }

    /// Visits every hit before the ray's end once, in an order that is the same on every run.
    pub fn every(&self, ray: &Ray, mut visit: impl FnMut(&Hit)) {
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return avx2.every(self, ray, visit);
        }
        traverse::occluded::<Portable, ALL>(self, ray, |hit| {
            visit(hit);
            false
        });
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(self.nodes.as_slice()) + size_of_val(self.blocks.as_slice()) + self.asking.len()
    }

    #[inline(always)]
    #[expect(unsafe_code, reason = "a bounds check in the innermost loop")]
    fn node(&self, child: Child) -> &Node {
        debug_assert!(child.index() < self.nodes.len());
        // SAFETY: the build names only nodes that it made.
        unsafe { self.nodes.get_unchecked(child.index()) }
    }

    #[inline(always)]
    #[expect(unsafe_code, reason = "a bounds check in the innermost loop")]
    fn block(&self, child: Child) -> &Block {
        debug_assert!(child.index() < self.blocks.len());
        // SAFETY: the build names only blocks that it made.
        unsafe { self.blocks.get_unchecked(child.index()) }
    }

    /// Starts to fetch what a child refers to.
    #[inline(always)]
    #[expect(unsafe_code, reason = "an instruction that Rust does not have")]
    fn prefetch(&self, child: Child) {
        #[cfg(not(target_arch = "x86_64"))]
        let _ = child;
        #[cfg(target_arch = "x86_64")]
        {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            let at = if child.is_leaf() {
                std::ptr::from_ref(self.block(child)).cast::<i8>()
            } else {
                std::ptr::from_ref(self.node(child)).cast::<i8>()
            };
            for line in 0..5 {
                // SAFETY: prefetching reads nothing, and x86-64 always has it.
                unsafe { _mm_prefetch::<_MM_HINT_T0>(at.wrapping_add(64 * line)) };
            }
        }
    }

    /// Which triangles of a block are [`Opacity::Ask`].
    fn asking(&self, child: Child) -> u32 {
        u32::from(self.asking[child.index()])
    }

    fn asks(&self, child: Child, lane: usize) -> bool {
        self.asking(child) >> lane & 1 != 0
    }
}
