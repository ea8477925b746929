//! Eight lanes at once with AVX2 and FMA.
//!
//! Products and sums of the triangle test are rounded one by one, as everywhere: a fused product
//! would give other bits, and other signs on both sides of a shared edge. Box tests may fuse.

use super::Bvh;
use super::node::{Block, Hits, Lanes, Node};
use super::traverse::{self, ALL, Kernel, Slabs};
use crate::geom::ray::{Hit, Ray, WatertightRay};
use std::arch::x86_64::{
    __m256, _CMP_EQ_OQ, _CMP_LE_OQ, _CMP_LT_OQ, _CMP_NEQ_UQ, _mm256_add_ps, _mm256_and_ps, _mm256_andnot_ps,
    _mm256_cmp_ps, _mm256_div_ps, _mm256_fmadd_ps, _mm256_load_ps, _mm256_max_ps, _mm256_min_ps,
    _mm256_movemask_ps, _mm256_mul_ps, _mm256_or_ps, _mm256_set1_ps, _mm256_setzero_ps, _mm256_store_ps,
    _mm256_sub_ps,
};

/// Says that the processor has what this module needs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Available(());

impl Available {
    pub(super) fn detect() -> Option<Self> {
        (is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1"))
        .then_some(Self(()))
    }

    #[inline]
    #[expect(unsafe_code, reason = "needs the processor's features")]
    pub(super) fn closest<const ASKS: bool>(
        self,
        bvh: &Bvh,
        ray: &Ray,
        accept: impl Fn(&Hit) -> bool,
    ) -> Option<Hit> {
        // SAFETY: `self` exists only where `detect` found the features.
        unsafe { closest::<ASKS>(bvh, ray, accept) }
    }

    #[inline]
    #[expect(unsafe_code, reason = "needs the processor's features")]
    pub(super) fn occluded<const ASKED: u8>(
        self,
        bvh: &Bvh,
        ray: &Ray,
        blocks: impl FnMut(&Hit) -> bool,
    ) -> bool {
        // SAFETY: as above.
        unsafe { occluded::<ASKED>(bvh, ray, blocks) }
    }

    #[inline]
    #[expect(unsafe_code, reason = "needs the processor's features")]
    pub(super) fn every(self, bvh: &Bvh, ray: &Ray, mut visit: impl FnMut(&Hit)) {
        let pass = |hit: &Hit| {
            visit(hit);
            false
        };
        // SAFETY: as above.
        unsafe { occluded::<ALL>(bvh, ray, pass) };
    }
}

#[target_feature(enable = "avx2,fma,bmi1")]
fn closest<const ASKS: bool>(bvh: &Bvh, ray: &Ray, accept: impl Fn(&Hit) -> bool) -> Option<Hit> {
    traverse::closest::<Avx2, ASKS>(bvh, ray, accept)
}

#[target_feature(enable = "avx2,fma,bmi1")]
fn occluded<const ASKED: u8>(bvh: &Bvh, ray: &Ray, blocks: impl FnMut(&Hit) -> bool) -> bool {
    traverse::occluded::<Avx2, ASKED>(bvh, ray, blocks)
}

struct Avx2 {
    inv_near: [__m256; 3],
    inv_far: [__m256; 3],
    shift_near: [__m256; 3],
    shift_far: [__m256; 3],
    rows_near: [usize; 3],
    rows_far: [usize; 3],
    exact: WatertightRay,
}

/// Only [`closest`] and [`occluded`] of this module use it, which have the features.
#[expect(unsafe_code, reason = "a trait's functions cannot name the features")]
impl Kernel for Avx2 {
    #[inline(always)]
    fn new(ray: &Ray) -> Self {
        // SAFETY: only callers with the features get here.
        unsafe { prepare(ray) }
    }

    #[inline(always)]
    fn boxes(&self, node: &Node, limit: f32, near: &mut Lanes) -> u32 {
        // SAFETY: only callers with the features get here.
        unsafe { boxes(self, node, limit, near) }
    }

    #[inline(always)]
    fn triangles(&self, block: &Block, limit: f32, hits: &mut Hits) -> u32 {
        // SAFETY: only callers with the features get here.
        unsafe { triangles(self, block, limit, hits) }
    }
}

#[target_feature(enable = "avx2,fma,bmi1")]
#[inline]
fn prepare(ray: &Ray) -> Avx2 {
    let s = Slabs::new(ray);
    let splat = |v: glam::Vec3A| [_mm256_set1_ps(v.x), _mm256_set1_ps(v.y), _mm256_set1_ps(v.z)];
    Avx2 {
        inv_near: splat(s.inv_near),
        inv_far: splat(s.inv_far),
        shift_near: splat(s.shift_near),
        shift_far: splat(s.shift_far),
        rows_near: s.rows_near,
        rows_far: s.rows_far,
        exact: WatertightRay::new(ray),
    }
}

#[target_feature(enable = "avx2,fma,bmi1")]
#[inline]
#[expect(unsafe_code, reason = "loads without bounds checks")]
fn row(rows: &[Lanes], index: usize) -> __m256 {
    debug_assert!(index < rows.len());
    // SAFETY: callers take `index` from `Slabs` or from `WatertightRay::axes`, where it is below 6
    // or 3, or name it; `Lanes` is 32 bytes and aligned to them.
    unsafe { _mm256_load_ps(rows.as_ptr().add(index).cast()) }
}

#[target_feature(enable = "avx2,fma,bmi1")]
#[inline]
#[expect(unsafe_code, reason = "an aligned store")]
fn store(to: &mut Lanes, x: __m256) {
    // SAFETY: `Lanes` is 32 bytes and aligned to them.
    unsafe { _mm256_store_ps(to.0.as_mut_ptr(), x) }
}

#[target_feature(enable = "avx2,fma,bmi1")]
#[inline]
fn mask(x: __m256) -> u32 {
    _mm256_movemask_ps(x).cast_unsigned()
}

#[target_feature(enable = "avx2,fma,bmi1")]
#[inline]
fn boxes(k: &Avx2, node: &Node, limit: f32, near: &mut Lanes) -> u32 {
    let enter = |a: usize| _mm256_fmadd_ps(row(&node.rows, k.rows_near[a]), k.inv_near[a], k.shift_near[a]);
    let leave = |a: usize| _mm256_fmadd_ps(row(&node.rows, k.rows_far[a]), k.inv_far[a], k.shift_far[a]);
    // Where one operand is NaN both functions give the second: such an axis does not bound the ray.
    let begin =
        _mm256_max_ps(_mm256_max_ps(enter(1), enter(2)), _mm256_max_ps(enter(0), _mm256_setzero_ps()));
    let end =
        _mm256_min_ps(_mm256_min_ps(leave(1), leave(2)), _mm256_min_ps(leave(0), _mm256_set1_ps(limit)));
    store(near, begin);
    mask(_mm256_cmp_ps::<_CMP_LE_OQ>(begin, end))
}

#[target_feature(enable = "avx2,fma,bmi1")]
#[inline]
fn triangles(k: &Avx2, block: &Block, limit: f32, hits: &mut Hits) -> u32 {
    let [kx, ky, kz] = k.exact.axes();
    let [ox, oy, oz] = k.exact.origin().map(|x| _mm256_set1_ps(x));
    let [sx, sy, sz] = k.exact.shear().map(|x| _mm256_set1_ps(x));
    let relative = |corner: usize| {
        let rows = &block.rows;
        let z = _mm256_sub_ps(row(rows, 3 * corner + kz), oz);
        let x = _mm256_sub_ps(row(rows, 3 * corner + kx), ox);
        let y = _mm256_sub_ps(row(rows, 3 * corner + ky), oy);
        [_mm256_sub_ps(x, _mm256_mul_ps(sx, z)), _mm256_sub_ps(y, _mm256_mul_ps(sy, z)), z]
    };
    let (a, b, c) = (relative(0), relative(1), relative(2));
    let cross =
        |p: [__m256; 3], q: [__m256; 3]| _mm256_sub_ps(_mm256_mul_ps(p[0], q[1]), _mm256_mul_ps(p[1], q[0]));
    let e = [cross(c, b), cross(a, c), cross(b, a)];
    let zero = _mm256_setzero_ps();
    let lowest = _mm256_min_ps(_mm256_min_ps(e[0], e[1]), e[2]);
    let highest = _mm256_max_ps(_mm256_max_ps(e[0], e[1]), e[2]);
    // All of one sign, zeros among them. Signs of numbers that are not zero are right, so that the
    // test in f64 would reject the same triangles. Lanes without a triangle are NaN and fall out.
    let inside = mask(_mm256_or_ps(
        _mm256_cmp_ps::<_CMP_LE_OQ>(zero, lowest),
        _mm256_cmp_ps::<_CMP_LE_OQ>(highest, zero),
    ));
    if inside == 0 {
        return 0;
    }
    let det = _mm256_add_ps(_mm256_add_ps(e[0], e[1]), e[2]);
    let inv = _mm256_div_ps(_mm256_set1_ps(1.0), det);
    let sum = _mm256_add_ps(
        _mm256_add_ps(_mm256_mul_ps(e[0], a[2]), _mm256_mul_ps(e[1], b[2])),
        _mm256_mul_ps(e[2], c[2]),
    );
    let t = _mm256_mul_ps(_mm256_mul_ps(sum, sz), inv);
    let within = _mm256_and_ps(
        _mm256_and_ps(
            _mm256_cmp_ps::<_CMP_LT_OQ>(zero, t),
            _mm256_cmp_ps::<_CMP_LT_OQ>(t, _mm256_set1_ps(limit)),
        ),
        _mm256_cmp_ps::<_CMP_NEQ_UQ>(det, zero),
    );
    let zeros = e.map(|e| _mm256_cmp_ps::<_CMP_EQ_OQ>(e, zero));
    let on_edge = _mm256_or_ps(_mm256_or_ps(zeros[0], zeros[1]), zeros[2]);
    let edge = mask(on_edge) & inside;
    let found = mask(_mm256_andnot_ps(on_edge, within)) & inside;
    if found | edge == 0 {
        return 0;
    }
    store(&mut hits.t, t);
    for (to, e) in hits.bary.iter_mut().zip(e) {
        store(to, _mm256_mul_ps(e, inv));
    }
    if edge == 0 { found } else { found | traverse::edges(&k.exact, block, limit, edge, hits) }
}
