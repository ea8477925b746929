//! The least squares problem of one island of texels, by conjugate gradients.
//!
//! With `x0` the texels as they are and `s` how far each may move, the unknowns are `y = (x - x0) / s`, and
//!
//! ```text
//! minimise  sum over texels y^2  +  sum over places and filters  w (A x - B x)^2
//! ```
//!
//! where `A x` and `B x` are what a filter reads on both sides of a place. In `y` the matrix is the identity plus
//! something positive, so that it cannot be singular, and texels a million times as bright as others are no trouble.
//! The matrix is never made: both products go over the places in their order, so that sums are the same every time.

use super::filter::{SIDE, Window};

/// Part of the right side's length at which the iteration ends: steps are then closed to about a thousandth.
const TOLERANCE: f64 = 1e-3;

/// Most iterations.
const MOST: usize = 100;

/// A place of a seam within an island.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    /// First texel of each row of the windows on both sides, counted in the island.
    pub(super) texels: [[u32; SIDE]; 2],
    /// Where the point is in both windows.
    pub(super) windows: [Window; 2],
    /// Weight `w` of its squared steps, 1/nits^2.
    pub(super) weight: f64,
}

/// Texels that hang together by places.
#[derive(Clone, Debug, Default)]
pub(super) struct Island {
    /// Texels, ascending; of all sheets, one after the other.
    pub(super) texels: Vec<usize>,
    /// How far each may move, nits: `s`.
    pub(super) free: Vec<f64>,
    pub(super) rows: Vec<Row>,
}

type Colour = [f64; 3];

fn each(f: impl FnMut(usize) -> f64) -> Colour {
    std::array::from_fn(f)
}

impl Row {
    /// Calls `f(texel, weight in A - B)` of the bilinear and of the bicubic filter for every texel that is read.
    fn for_each(&self, mut f: impl FnMut(usize, [f64; 2])) {
        for ((rows, window), sign) in self.texels.iter().zip(&self.windows).zip([1.0, -1.0]) {
            let ([bx, by], [cx, cy]) = (window.bilinear(), window.bicubic());
            for j in 0..SIDE {
                for i in 0..SIDE {
                    f(rows[j] as usize + i, [sign * (by[j] * bx[i]), sign * (cy[j] * cx[i])]);
                }
            }
        }
    }

    /// Steps of both filters.
    fn steps(&self, x: impl Fn(usize) -> Colour) -> [Colour; 2] {
        let mut steps = [[0.0; 3]; 2];
        self.for_each(|texel, weights| {
            let v = x(texel);
            for (step, w) in steps.iter_mut().zip(weights) {
                (0..3).for_each(|c| step[c] += w * v[c]);
            }
        });
        steps
    }
}

impl Island {
    /// What the texels become; `start` is what they are.
    pub(super) fn solve(&self, start: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let x0 = |i: usize| start[i].map(f64::from);
        let n = self.texels.len();
        // The residual at y = 0.
        let mut r = vec![[0.0; 3]; n];
        self.add_product(&mut r, x0, -1.0);
        let diagonal = self.diagonal();
        let precondition = |r: &[Colour]| -> Vec<Colour> {
            r.iter().zip(&diagonal).map(|(r, d)| r.map(|v| v / d)).collect()
        };
        let mut y = vec![[0.0; 3]; n];
        let mut p = precondition(&r);
        let mut rho = dot(&r, &p);
        let end = dot(&r, &r).map(|v| v * (TOLERANCE * TOLERANCE));
        for _ in 0..MOST {
            let length = dot(&r, &r);
            if (0..3).all(|c| length[c] <= end[c]) {
                break;
            }
            let mut q = p.clone();
            self.add_product(&mut q, |i| p[i].map(|v| v * self.free[i]), 1.0);
            let curvature = dot(&p, &q);
            let alpha = each(|c| quotient(rho[c], curvature[c]));
            for i in 0..n {
                for c in 0..3 {
                    y[i][c] += alpha[c] * p[i][c];
                    r[i][c] -= alpha[c] * q[i][c];
                }
            }
            let z = precondition(&r);
            let next = dot(&r, &z);
            let beta = each(|c| quotient(next[c], rho[c]));
            for (p, z) in p.iter_mut().zip(&z) {
                *p = each(|c| z[c] + beta[c] * p[c]);
            }
            rho = next;
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
        let single = |v: Colour| v.map(|v| v as f32);
        (0..n).map(|i| single(each(|c| x0(i)[c] + self.free[i] * y[i][c]))).collect()
    }

    /// Adds `sign S (A - B)^T w (A - B) x` to `to`.
    fn add_product(&self, to: &mut [Colour], x: impl Fn(usize) -> Colour, sign: f64) {
        for row in &self.rows {
            let steps = row.steps(&x).map(|step| step.map(|v| sign * row.weight * v));
            row.for_each(|texel, weights| {
                let s = self.free[texel];
                for (step, w) in steps.iter().zip(weights) {
                    (0..3).for_each(|c| to[texel][c] += s * w * step[c]);
                }
            });
        }
    }

    fn diagonal(&self) -> Vec<f64> {
        let mut d = vec![1.0; self.texels.len()];
        for row in &self.rows {
            row.for_each(|texel, weights| {
                let s = self.free[texel];
                d[texel] += row.weight * (s * s) * weights.iter().map(|w| w * w).sum::<f64>();
            });
        }
        d
    }
}

fn dot(a: &[Colour], b: &[Colour]) -> Colour {
    let mut sum = [0.0; 3];
    for (a, b) in a.iter().zip(b) {
        (0..3).for_each(|c| sum[c] += a[c] * b[c]);
    }
    sum
}

/// `a / b`, and 0 where there is nothing left to do.
fn quotient(a: f64, b: f64) -> f64 {
    if b == 0.0 { 0.0 } else { a / b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    /// Two strips of 8 x 4 texels of which the lower edges of the first and the upper ones of the second meet.
    fn strips(free: impl Fn(usize) -> f64, weight: f64) -> Island {
        let mut island =
            Island { texels: (0..64).collect(), free: (0..64).map(free).collect(), rows: Vec::new() };
        for k in 0..9 {
            let x = 1.75 + 0.5 * k as f32;
            let windows = [Vec2::new(x, 2.0), Vec2::new(x + 0.3, 2.0)]
                .map(|at| Window::around(at, 8, 4).expect("large enough"));
            let first = |side: usize, start: usize| {
                windows[side].rows(8).map(|t| u32::try_from(t + start).expect("64 texels"))
            };
            island.rows.push(Row { texels: [first(0, 0), first(1, 32)], windows, weight });
        }
        island
    }

    fn cost(island: &Island, x0: &[[f32; 3]], x: &[Colour], c: usize) -> f64 {
        let moved: f64 =
            (0..x.len()).map(|i| ((x[i][c] - f64::from(x0[i][c])) / island.free[i]).powi(2)).sum();
        let steps: f64 =
            island.rows.iter().flat_map(|r| r.steps(|i| x[i]).map(|s| r.weight * s[c] * s[c])).sum();
        moved + steps
    }

    #[test]
    fn the_answer_is_the_least_sum_of_squares() {
        let island = strips(|i| 0.5 + 0.1 * (i % 5) as f64, 40.0);
        let x0: Vec<[f32; 3]> =
            (0..64).map(|i| [(i * i % 11) as f32, if i < 32 { 1.0 } else { 2.0 }, 0.0]).collect();
        let x: Vec<Colour> = island.solve(&x0).iter().map(|v| v.map(f64::from)).collect();
        for c in 0..3 {
            let least = cost(&island, &x0, &x, c);
            for i in 0..64 {
                for d in [-0.2, 0.2] {
                    let mut other = x.clone();
                    other[i][c] += d;
                    assert!(least <= cost(&island, &x0, &other, c), "texel {i} channel {c}");
                }
            }
        }
        assert!(x.iter().all(|v| v[2] == 0.0));
        let start: Vec<Colour> = x0.iter().map(|v| v.map(f64::from)).collect();
        assert!(cost(&island, &x0, &x, 1) < 0.05 * cost(&island, &x0, &start, 1));
    }

    #[test]
    fn exact_texels_stay_and_noisy_ones_come_to_them() {
        let island = strips(|i| if i < 32 { 1e-3 } else { 1.0 }, 1e4);
        let x0: Vec<[f32; 3]> = (0..64).map(|i| [if i < 32 { 1.0 } else { 2.0 }; 3]).collect();
        let x: Vec<Colour> = island.solve(&x0).iter().map(|v| v.map(f64::from)).collect();
        assert!(x[..32].iter().all(|v| (v[0] - 1.0).abs() < 2e-3));
        for row in &island.rows {
            for step in row.steps(|i| x[i]) {
                assert!(step[0].abs() < 0.02, "{step:?}");
            }
        }
    }

    #[test]
    fn light_times_a_power_of_two_changes_no_bit() {
        let x0: Vec<[f32; 3]> = (0..64).map(|i| [(i * i % 11) as f32 * 0.37, 0.1 * i as f32, 1.0]).collect();
        let scaled: Vec<[f32; 3]> = x0.iter().map(|v| v.map(|v| v * 256.0)).collect();
        let free = |i: usize| 0.3 + 0.01 * i as f64;
        let one = strips(free, 7.0).solve(&x0);
        let other = strips(|i| 256.0 * free(i), 7.0 / 65536.0).solve(&scaled);
        for (a, b) in one.iter().zip(&other) {
            assert_eq!(a.map(|v| v * 256.0), *b);
        }
    }
}
