//! What a GPU reads at a point of a page: bilinear, and bicubic with the B-spline that engines use.
//!
//! Both are products of weights along x and y over a window of 4 x 4 texels. Texels beyond the page's edge are those
//! at its edge, as textures clamp.

use glam::Vec2;

/// Texels along a side of a window.
pub(super) const SIDE: usize = 4;

/// Where a filter reads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Window {
    /// First column and row.
    pub(super) corner: [u32; 2],
    /// Where the point is from the first texel's centre, texels.
    pub(super) at: [f32; 2],
}

impl Window {
    /// Around a point of a page, texels; `None` on pages that hold no window.
    pub(super) fn around(point: Vec2, width: usize, height: usize) -> Option<Self> {
        let (x, cx) = axis(point.x, width)?;
        let (y, cy) = axis(point.y, height)?;
        Some(Self { corner: [x, y], at: [cx, cy] })
    }

    /// The first texel of each row of the window, `y * width + x`.
    pub(super) fn rows(&self, width: usize) -> [usize; SIDE] {
        let [x, y] = self.corner.map(|c| c as usize);
        std::array::from_fn(|j| (y + j) * width + x)
    }

    /// Calls `f(texel, weight)` for every texel of the window, given weights along x and y.
    pub(super) fn read(&self, [wx, wy]: [[f64; SIDE]; 2], width: usize, mut f: impl FnMut(usize, f64)) {
        for (row, wy) in self.rows(width).into_iter().zip(wy) {
            for (i, wx) in wx.into_iter().enumerate() {
                f(row + i, wy * wx);
            }
        }
    }

    /// Weights of the bilinear filter along x and y.
    pub(super) fn bilinear(&self) -> [[f64; SIDE]; 2] {
        self.at.map(|at| along(at, |f| [0.0, 1.0 - f, f, 0.0]))
    }

    /// Weights of the bicubic filter along x and y.
    pub(super) fn bicubic(&self) -> [[f64; SIDE]; 2] {
        self.at.map(|at| {
            along(at, |f| {
                let (g, f2) = (1.0 - f, f * f);
                let f3 = f2 * f;
                [
                    g * g * g / 6.0,
                    (3.0 * f3 - 6.0 * f2 + 4.0) / 6.0,
                    (-3.0 * f3 + 3.0 * f2 + 3.0 * f + 1.0) / 6.0,
                    f3 / 6.0,
                ]
            })
        })
    }
}

/// First texel of a window along one axis, and the point from its centre.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the page, which has fewer than 2^16 texels a side"
)]
fn axis(point: f32, n: usize) -> Option<(u32, f32)> {
    let last = n.checked_sub(SIDE)?;
    let centre = (f64::from(point) - 0.5).clamp(0.0, n as f64 - 1.0);
    let first = (centre.floor() - 1.0).clamp(0.0, last as f64);
    Some((first as u32, (centre - first) as f32))
}

/// Weights of the four taps around a point, those beyond the window added to its edge.
fn along(at: f32, taps: impl Fn(f64) -> [f64; SIDE]) -> [f64; SIDE] {
    let base = at.floor();
    let weights = taps(f64::from(at - base));
    let mut out = [0.0; SIDE];
    for (tap, w) in weights.iter().enumerate() {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "base is 0 to 3")]
        let to = (base as usize + tap).saturating_sub(1).min(SIDE - 1);
        out[to] += w;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fetch(
        window: &Window,
        weights: [[f64; SIDE]; 2],
        width: usize,
        f: impl Fn(usize, usize) -> f64,
    ) -> f64 {
        let mut sum = 0.0;
        window.read(weights, width, |texel, w| sum += w * f(texel % width, texel / width));
        sum
    }

    #[test]
    fn linear_functions_are_kept_inside_and_constants_everywhere() {
        for (x, y) in [(2.5, 3.5), (5.25, 4.9), (3.0, 2.0), (0.0, 0.1), (0.7, 7.9), (8.0, 9.0), (6.8, 1.4)] {
            let w = Window::around(Vec2::new(x, y), 8, 9).expect("a page that is large enough");
            for (inside, weights) in [(0.5, w.bilinear()), (1.5, w.bicubic())] {
                assert!((fetch(&w, weights, 8, |_, _| 1.0) - 1.0).abs() < 1e-12);
                let linear = |i: usize, j: usize| 2.0 * (i as f64 + 0.5) - 3.0 * (j as f64 + 0.5);
                let got = fetch(&w, weights, 8, linear);
                let within = |p: f32, n: f32| inside <= p && p <= n - inside;
                if within(x, 8.0) && within(y, 9.0) {
                    assert!((got - f64::from(2.0 * x - 3.0 * y)).abs() < 1e-5, "{x} {y}: {got}");
                }
            }
        }
        assert_eq!(Window::around(Vec2::ZERO, 3, 9), None);
    }

    #[test]
    fn the_edge_of_a_page_is_clamped() {
        let w = Window::around(Vec2::new(0.2, 7.8), 8, 8).expect("a page that is large enough");
        let value = |i: usize, j: usize| (10 * j + i) as f64;
        assert_eq!(fetch(&w, w.bilinear(), 8, value), 70.0);
    }
}
