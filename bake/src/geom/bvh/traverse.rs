//! The ways through the tree, the same for every [`Kernel`].

use super::Bvh;
use super::node::{Block, Child, Hits, Lanes, Node};
use crate::geom::ray::{Hit, Ray, WatertightRay};
use glam::Vec3A;
use std::mem::MaybeUninit;

/// Children that wait, at most. The build refuses trees that need more.
pub(super) const STACK: usize = 512;

/// One ray against eight boxes or triangles. Bit `i` of a mask speaks of lane `i`.
pub(super) trait Kernel {
    fn new(ray: &Ray) -> Self;

    /// Which boxes the ray may meet at a distance up to `limit`, and `near`, at most the distances at
    /// which it enters them, 0 from inside. No box is left out that holds a hit; some may be let in
    /// that hold none.
    fn boxes(&self, node: &Node, limit: f32, near: &mut Lanes) -> u32;

    /// Which triangles the ray hits before `limit`: to the bit what
    /// [`crate::geom::ray::WatertightRay::intersect`] says.
    fn triangles(&self, block: &Block, limit: f32, hits: &mut Hits) -> u32;
}

/// The slabs of a ray, ready for `plane * inv + shift`.
///
/// With the unit of rounding `u = 2^-24` the distance to a plane is off by at most `3 u` of itself,
/// from the reciprocal, the product and the difference, and by `2 u` of the distance between the
/// origin and zero along the ray, from the products. The triangle test shifts hits sideways by some
/// more `u`. Near ends are lowered and far ends raised by a multiple of both, after \[Ize13\].
#[derive(Clone, Copy, Debug)]
pub(super) struct Slabs {
    pub(super) inv_near: Vec3A,
    pub(super) inv_far: Vec3A,
    pub(super) shift_near: Vec3A,
    pub(super) shift_far: Vec3A,
    /// Rows of [`Node::rows`] where the ray enters and leaves, by axis.
    pub(super) rows_near: [usize; 3],
    pub(super) rows_far: [usize; 3],
}

impl Slabs {
    #[inline(always)]
    pub(super) fn new(ray: &Ray) -> Self {
        const U: f32 = f32::EPSILON / 2.0;
        // A zero component becomes tiny: no 0 * inf, and no box is left out by it.
        let tiny = Vec3A::splat(1e-30);
        let d = Vec3A::select(ray.direction.abs().cmplt(tiny), tiny.copysign(ray.direction), ray.direction);
        let inv = d.recip();
        let (inv_near, inv_far) = (inv * (1.0 - 16.0 * U), inv * (1.0 + 16.0 * U));
        let origin = ray.origin * inv;
        let slack = origin.abs() * (4.0 * U);
        let negative = d.is_negative_bitmask() as usize;
        let row = |axis: usize| 2 * axis + (negative >> axis & 1);
        let rows_near = [row(0), row(1), row(2)];
        Self {
            inv_near,
            inv_far,
            shift_near: -(ray.origin * inv_near + slack),
            shift_far: slack - ray.origin * inv_far,
            rows_near,
            rows_far: rows_near.map(|r| r ^ 1),
        }
    }
}

/// A stack that is not filled before it is used: clearing it would take as long as some nodes do.
struct Stack<'a, T> {
    /// Not in here, so that `len` stays in a register.
    items: &'a mut [MaybeUninit<T>; STACK],
    len: usize,
}

/// Room for a [`Stack`].
#[inline(always)]
const fn room<T>() -> [MaybeUninit<T>; STACK] {
    [const { MaybeUninit::uninit() }; STACK]
}

#[expect(unsafe_code, reason = "bounds checks in the innermost loop; the build bounds the height")]
impl<'a, T: Copy> Stack<'a, T> {
    #[inline(always)]
    fn new(items: &'a mut [MaybeUninit<T>; STACK]) -> Self {
        Self { items, len: 0 }
    }

    #[inline(always)]
    fn push(&mut self, item: T) {
        debug_assert!(self.len < STACK);
        // SAFETY: the build checked that no way through the tree pushes more than `STACK` items.
        unsafe { self.items.get_unchecked_mut(self.len) }.write(item);
        self.len += 1;
    }

    #[inline(always)]
    fn pop(&mut self) -> Option<T> {
        self.len = self.len.checked_sub(1)?;
        // SAFETY: `push` wrote all items below the old `len`, which was at most `STACK`.
        Some(unsafe { self.items.get_unchecked(self.len).assume_init() })
    }

    /// Sorts what was pushed since `base` so that the lowest is popped first.
    #[inline(always)]
    fn sort(&mut self, base: usize)
    where
        T: Ord,
    {
        for i in base + 1..self.len {
            // SAFETY: `base <= j < i < len`, and `push` wrote all items below `len`.
            unsafe {
                let item = self.items.get_unchecked(i).assume_init();
                let mut j = i;
                while base < j && self.items.get_unchecked(j - 1).assume_init() < item {
                    *self.items.get_unchecked_mut(j) = *self.items.get_unchecked(j - 1);
                    j -= 1;
                }
                self.items.get_unchecked_mut(j).write(item);
            }
        }
    }
}

/// A waiting child and where the ray enters it: distances are not negative, so that their bits
/// compare as they do.
#[inline(always)]
fn entry(near: &Lanes, node: &Node, lane: usize) -> u64 {
    u64::from(near.0[lane].to_bits()) << 32 | u64::from(node.child[lane].0)
}

/// The child of an [`entry`].
#[inline(always)]
#[expect(clippy::cast_possible_truncation, reason = "the lower half")]
fn child(entry: u64) -> Child {
    Child(entry as u32)
}

/// Lowest lane of a mask that is not empty; clears it.
#[inline(always)]
fn take(mask: &mut u32) -> usize {
    let lane = mask.trailing_zeros() as usize & 7;
    *mask &= *mask - 1;
    lane
}

impl Hits {
    #[inline(always)]
    fn get(&self, lane: usize, triangle: u32) -> Hit {
        Hit { t: self.t.0[lane], triangle, bary: [0, 1, 2].map(|i| self.bary[i].0[lane]) }
    }
}

/// Whether the ray can hit anything at all.
fn is_valid(ray: &Ray) -> bool {
    ray.origin.is_finite() && ray.direction.is_finite() && 0.0 < ray.t_max
}

/// [`occluded`] asks about no triangle: all of them are [`super::Opacity::Opaque`].
pub(super) const NONE: u8 = 0;

/// It asks about those that are [`super::Opacity::Ask`].
pub(super) const SOME: u8 = 1;

/// It asks about every triangle.
pub(super) const ALL: u8 = 2;

/// See [`Bvh::closest`]; without `ASKS` every triangle counts.
#[inline(always)]
pub(super) fn closest<K: Kernel, const ASKS: bool>(
    bvh: &Bvh,
    ray: &Ray,
    accept: impl Fn(&Hit) -> bool,
) -> Option<Hit> {
    if !is_valid(ray) {
        return None;
    }
    let kernel = K::new(ray);
    let mut best = Hit { t: ray.t_max, triangle: u32::MAX, bary: [0.0; 3] };
    // Ties stay visible to later triangles: the limit is the next float above the nearest hit.
    let mut limit = ray.t_max;
    let mut room = room();
    let mut stack = Stack::new(&mut room);
    let mut near = Lanes::default();
    let mut hits = Hits::default();
    let mut current = bvh.root;
    loop {
        while !current.is_leaf() {
            let node = bvh.node(current);
            let mut mask = kernel.boxes(node, limit, &mut near);
            if mask == 0 {
                break;
            }
            let first = take(&mut mask);
            bvh.prefetch(node.child[first]);
            if mask == 0 {
                current = node.child[first];
                continue;
            }
            let a = entry(&near, node, first);
            let b = entry(&near, node, take(&mut mask));
            let (mut low, high) = (a.min(b), a.max(b));
            let base = stack.len;
            bvh.prefetch(child(b));
            stack.push(high);
            if mask != 0 {
                stack.push(low);
                while mask != 0 {
                    let e = entry(&near, node, take(&mut mask));
                    bvh.prefetch(child(e));
                    stack.push(e);
                }
                stack.sort(base);
                low = stack.pop().unwrap_or(high);
            }
            current = child(low);
        }
        if current.is_leaf() {
            let block = bvh.block(current);
            let mut mask = kernel.triangles(block, limit, &mut hits);
            while mask != 0 {
                let lane = take(&mut mask);
                let hit = hits.get(lane, block.triangle[lane]);
                let nearer = hit.t < best.t || (hit.t == best.t && hit.triangle < best.triangle);
                if nearer && (!ASKS || !bvh.asks(current, lane) || ask(&accept, &hit)) {
                    best = hit;
                    limit = hit.t.next_up();
                }
            }
        }
        current = loop {
            match stack.pop() {
                None => return (best.triangle != u32::MAX).then_some(best),
                Some(e) if (e >> 32) as u32 <= limit.to_bits() => break child(e),
                Some(_) => {}
            }
        }
    }
}

/// See [`Bvh::occluded`]; `ASKED` says about which triangles: [`NONE`], [`SOME`] or [`ALL`].
#[inline(always)]
pub(super) fn occluded<K: Kernel, const ASKED: u8>(
    bvh: &Bvh,
    ray: &Ray,
    mut blocks: impl FnMut(&Hit) -> bool,
) -> bool {
    if !is_valid(ray) {
        return false;
    }
    let kernel = K::new(ray);
    let mut room = room();
    let mut stack = Stack::new(&mut room);
    let mut near = Lanes::default();
    let mut hits = Hits::default();
    let mut current = bvh.root;
    loop {
        if current.is_leaf() {
            let block = bvh.block(current);
            let mut mask = kernel.triangles(block, ray.t_max, &mut hits);
            if mask != 0 {
                if ASKED == NONE || (ASKED == SOME && mask & !bvh.asking(current) != 0) {
                    return true;
                }
                while mask != 0 {
                    let lane = take(&mut mask);
                    if ask(&mut blocks, &hits.get(lane, block.triangle[lane])) {
                        return true;
                    }
                }
            }
        } else {
            let node = bvh.node(current);
            let mut mask = kernel.boxes(node, ray.t_max, &mut near);
            while mask != 0 {
                let c = node.child[take(&mut mask)];
                bvh.prefetch(c);
                stack.push(c);
            }
        }
        match stack.pop() {
            None => return false,
            Some(next) => current = next,
        }
    }
}

/// Keeps what the caller does with a hit out of the loops.
#[inline(never)]
fn ask(mut accept: impl FnMut(&Hit) -> bool, hit: &Hit) -> bool {
    accept(hit)
}

/// Tests the triangles of `lanes` one by one, where an edge function was zero.
#[cold]
#[inline(never)]
pub(super) fn edges(ray: &WatertightRay, block: &Block, limit: f32, mut lanes: u32, hits: &mut Hits) -> u32 {
    let mut found = 0;
    while lanes != 0 {
        let lane = take(&mut lanes);
        if let Some((t, bary)) = ray.intersect(&block.corners(lane), limit) {
            found |= 1 << lane;
            hits.t.0[lane] = t;
            for (to, b) in hits.bary.iter_mut().zip(bary) {
                to.0[lane] = b;
            }
        }
    }
    found
}
