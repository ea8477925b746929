//! Error figures of one image against another.

use std::fmt;

use serde::Serialize;

use super::input::Layers;

/// Figures of `a` against the reference `b` over texels that both cover.
///
/// Colours are compared channel by channel in nits (of `E / pi` for lightmaps); means are of
/// Rec. 709 luminance.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Figures {
    /// Texels compared.
    pub texels: u64,
    /// Mean luminance of the first side, nits.
    pub mean_a: f64,
    /// Mean luminance of the reference, nits.
    pub mean_b: f64,
    /// Mean squared difference over texels and channels, nits squared.
    pub mse: f64,
    /// Its root, nits.
    pub rmse: f64,
    /// `rmse / mean_b`; absent where the reference is black.
    pub relative_rmse: Option<f64>,
    /// `mean_a - mean_b`, nits.
    pub bias: f64,
    /// `bias / mean_b`; absent where the reference is black.
    pub relative_bias: Option<f64>,
    /// Mean of `(a - b)^2 / (b^2 + (mean_b / 10)^2)`, with the mean of the texel's page; 0 on black pages.
    pub rel_mse: f64,
    /// `10 log10(peak^2 / mse)` with the reference's largest value, dB; absent where `mse` or the peak is 0.
    pub psnr: Option<f64>,
    /// Largest difference of one channel, nits, without sign.
    pub max_difference: f64,
    /// Where that is; absent where nothing differs.
    pub max_at: Option<Place>,
    /// Texels that both cover and one of which is NaN or infinite; they are left out of the rest.
    pub non_finite: u64,
    /// Texels that one side covers and the other does not; they are left out too.
    pub coverage_mismatches: u64,
}

/// A value of a texel on both sides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Place {
    /// Page index.
    pub page: usize,
    /// Column.
    pub x: usize,
    /// Row from the top.
    pub y: usize,
    /// 0, 1, 2 for red, green, blue.
    pub channel: usize,
    /// The first side's value, nits.
    pub a: f64,
    /// The reference's value, nits.
    pub b: f64,
}

impl Place {
    pub(super) fn new(page: usize, i: usize, channel: usize, a: &Layers, b: &Layers) -> Self {
        let (x, y) = (i % a.width, i / a.width);
        Self { page, x, y, channel, a: a.color(i)[channel], b: b.color(i)[channel] }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { page, x, y, channel, a, b } = self;
        let channel = ["red", "green", "blue"][*channel % 3];
        write!(f, "page {page}, texel ({x}, {y}), {channel}: {a:.6e} and {b:.6e}")
    }
}

/// Sums from which [`Figures`] follow; pages are merged in order.
#[derive(Clone, Debug, Default)]
pub(super) struct Sums {
    texels: u64,
    luminance_a: f64,
    luminance_b: f64,
    squares: f64,
    relative_squares: f64,
    peak: f64,
    max_difference: f64,
    max_at: Option<Place>,
    non_finite: u64,
    coverage_mismatches: u64,
}

impl Sums {
    /// Sums over a page. Both sides have the same size.
    pub(super) fn of(a: &Layers, b: &Layers, page: usize) -> Self {
        let mut sums = Self::default();
        for i in 0..a.width * a.height {
            match (a.covers(i), b.covers(i)) {
                (true, true) if is_finite(a, b, i) => sums.add(a, b, i, page),
                (true, true) => sums.non_finite += 1,
                (false, false) => {}
                _ => sums.coverage_mismatches += 1,
            }
        }
        let floor = 0.1 * sums.luminance_b / count(sums.texels);
        if 0.0 < floor {
            for i in (0..a.width * a.height).filter(|&i| compared(a, b, i)) {
                for (x, y) in a.color(i).into_iter().zip(b.color(i)) {
                    sums.relative_squares += (x - y) * (x - y) / (y * y + floor * floor);
                }
            }
        }
        sums
    }

    fn add(&mut self, a: &Layers, b: &Layers, i: usize, page: usize) {
        let (color_a, color_b) = (a.color(i), b.color(i));
        self.texels += 1;
        self.luminance_a += luminance(color_a);
        self.luminance_b += luminance(color_b);
        for channel in 0..3 {
            let difference = color_a[channel] - color_b[channel];
            self.squares += difference * difference;
            self.peak = self.peak.max(color_b[channel]);
            if self.max_difference < difference.abs() {
                self.max_difference = difference.abs();
                self.max_at = Some(Place::new(page, i, channel, a, b));
            }
        }
    }

    pub(super) fn merge(self, o: Self) -> Self {
        let later = self.max_difference < o.max_difference;
        Self {
            texels: self.texels + o.texels,
            luminance_a: self.luminance_a + o.luminance_a,
            luminance_b: self.luminance_b + o.luminance_b,
            squares: self.squares + o.squares,
            relative_squares: self.relative_squares + o.relative_squares,
            peak: self.peak.max(o.peak),
            max_difference: self.max_difference.max(o.max_difference),
            max_at: if later { o.max_at } else { self.max_at },
            non_finite: self.non_finite + o.non_finite,
            coverage_mismatches: self.coverage_mismatches + o.coverage_mismatches,
        }
    }

    pub(super) fn figures(&self) -> Figures {
        let n = count(self.texels);
        let (mean_a, mean_b) = (self.luminance_a / n, self.luminance_b / n);
        let mse = self.squares / (3.0 * n);
        let bias = mean_a - mean_b;
        let relative = |x: f64| (0.0 < mean_b).then(|| x / mean_b);
        Figures {
            texels: self.texels,
            mean_a,
            mean_b,
            mse,
            rmse: mse.sqrt(),
            relative_rmse: relative(mse.sqrt()),
            bias,
            relative_bias: relative(bias),
            rel_mse: self.relative_squares / (3.0 * n),
            psnr: (0.0 < mse && 0.0 < self.peak).then(|| 10.0 * (self.peak * self.peak / mse).log10()),
            max_difference: self.max_difference,
            max_at: self.max_at,
            non_finite: self.non_finite,
            coverage_mismatches: self.coverage_mismatches,
        }
    }

    /// Root mean square difference, nits.
    pub(super) fn rmse(&self) -> f64 {
        (self.squares / (3.0 * count(self.texels))).sqrt()
    }
}

/// Whether texel `i` counts: covered and finite on both sides.
pub(super) fn compared(a: &Layers, b: &Layers, i: usize) -> bool {
    a.covers(i) && b.covers(i) && is_finite(a, b, i)
}

fn is_finite(a: &Layers, b: &Layers, i: usize) -> bool {
    a.color(i).into_iter().chain(b.color(i)).all(f64::is_finite)
}

fn luminance(c: [f64; 3]) -> f64 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}

/// A divisor: the count, or 1 where the sums are 0 anyway.
#[expect(clippy::cast_precision_loss, reason = "images have far fewer than 2^53 texels")]
fn count(n: u64) -> f64 {
    n.max(1) as f64
}
