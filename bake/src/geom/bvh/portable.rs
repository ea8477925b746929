//! Eight lanes one after the other, written so that compilers may use vectors.

use super::node::{Block, Hits, Lanes, Node, WIDTH};
use super::traverse::{Kernel, Slabs, edges};
use crate::geom::ray::{Ray, WatertightRay};

pub(super) struct Portable {
    slabs: Slabs,
    exact: WatertightRay,
}

impl Kernel for Portable {
    #[inline]
    fn new(ray: &Ray) -> Self {
        Self { slabs: Slabs::new(ray), exact: WatertightRay::new(ray) }
    }

    #[inline]
    fn boxes(&self, node: &Node, limit: f32, near: &mut Lanes) -> u32 {
        let s = &self.slabs;
        let mut far = [limit; WIDTH];
        near.0 = [0.0; WIDTH];
        for axis in 0..3 {
            let (enter, leave) = (&node.rows[s.rows_near[axis]].0, &node.rows[s.rows_far[axis]].0);
            for i in 0..WIDTH {
                // These functions pass over NaN: such an axis does not bound the ray.
                near.0[i] = near.0[i].max(enter[i] * s.inv_near[axis] + s.shift_near[axis]);
                far[i] = far[i].min(leave[i] * s.inv_far[axis] + s.shift_far[axis]);
            }
        }
        (0..WIDTH).fold(0, |mask, i| mask | u32::from(near.0[i] <= far[i]) << i)
    }

    #[inline]
    fn triangles(&self, block: &Block, limit: f32, hits: &mut Hits) -> u32 {
        let ([kx, ky, kz], [ox, oy, oz]) = (self.exact.axes(), self.exact.origin());
        let [sx, sy, _] = self.exact.shear();
        let mut v = [[[0.0; WIDTH]; 2]; 3];
        for (corner, v) in v.iter_mut().enumerate() {
            let [x, y, z] = [kx, ky, kz].map(|axis| &block.rows[3 * corner + axis].0);
            for i in 0..WIDTH {
                v[0][i] = x[i] - ox - sx * (z[i] - oz);
                v[1][i] = y[i] - oy - sy * (z[i] - oz);
            }
        }
        let [a, b, c] = v;
        let mut inside = 0;
        for i in 0..WIDTH {
            let e = [
                c[0][i] * b[1][i] - c[1][i] * b[0][i],
                a[0][i] * c[1][i] - a[1][i] * c[0][i],
                b[0][i] * a[1][i] - b[1][i] * a[0][i],
            ];
            // All of one sign, zeros among them; lanes without a triangle are NaN and fall out.
            let one_sign =
                (0.0 <= e[0]) & (0.0 <= e[1]) & (0.0 <= e[2]) | (e[0] <= 0.0) & (e[1] <= 0.0) & (e[2] <= 0.0);
            inside |= u32::from(one_sign) << i;
        }
        // Few are left: the test of single triangles decides.
        if inside == 0 { 0 } else { edges(&self.exact, block, limit, inside, hits) }
    }
}
