//! A lightmap page in memory, and its figures.

use super::stitch::Bits;
use tables::format::manifest::ErrorFigure;

/// One atlas page, row 0 at the top. All layers have `width * height` texels.
///
/// Radiance is `E / pi` in nits: that of a white Lambertian surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Page {
    /// Texels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Direct and indirect light together, nits.
    pub radiance: Vec<[f32; 3]>,
    /// Part of the texel that its chart covers, in [0, 1]; 0 in the gutter.
    pub coverage: Vec<f32>,
    /// Standard error of `radiance`, nits; without meaning where coverage is 0.
    pub std_err: Vec<[f32; 3]>,
    /// Light that comes straight from lamps and sky, nits, where it was asked for.
    pub direct: Option<Vec<[f32; 3]>>,
    /// The rest, nits, where it was asked for.
    pub indirect: Option<Vec<[f32; 3]>>,
    /// The direction that light comes from, where it was asked for: parts along x, y and z, nits, signed; see
    /// [`crate::solve::directional`].
    pub sh1: Option<[Vec<[f32; 3]>; 3]>,
    /// What `radiance` was before denoising, nits, where it was denoised. `std_err` belongs to this.
    pub noisy: Option<Vec<[f32; 3]>>,
    /// Estimated root mean squared error of `radiance` after denoising, nits, where it was denoised.
    pub rmse: Option<Vec<[f32; 3]>>,
    /// Covered texels inside other geometry that were filled from their chart, where there are any.
    pub filled: Option<Bits>,
}

impl Page {
    /// A black, uncovered page without the optional layers.
    #[must_use]
    pub fn new(width: usize, height: usize) -> Self {
        let n = width * height;
        Self {
            width,
            height,
            radiance: vec![[0.0; 3]; n],
            coverage: vec![0.0; n],
            std_err: vec![[0.0; 3]; n],
            direct: None,
            indirect: None,
            sh1: None,
            noisy: None,
            rmse: None,
            filled: None,
        }
    }

    /// Number of texels.
    #[must_use]
    pub fn n_texels(&self) -> usize {
        self.width * self.height
    }

    /// The layers of light with their channel prefix: the empty one, `direct`, `indirect`, `sh1.x`, `sh1.y`, `sh1.z`.
    pub(super) fn light_layers(&self) -> impl Iterator<Item = (&'static str, &Vec<[f32; 3]>)> {
        let parts = [("direct", &self.direct), ("indirect", &self.indirect)];
        let parts = parts.into_iter().filter_map(|(name, layer)| Some((name, layer.as_ref()?)));
        let directions = self.sh1.iter().flat_map(|d| ["sh1.x", "sh1.y", "sh1.z"].into_iter().zip(d));
        [("", &self.radiance)].into_iter().chain(parts).chain(directions)
    }

    /// Shortens directions so that no normal within 60 degrees of a texel's own gives a negative value: s is at most as long as
    /// `E / pi`, channel by channel. Filters over several texels go beyond that.
    pub(super) fn limit_directions(&mut self) {
        let Some([x, y, z]) = &mut self.sh1 else { return };
        for (((light, x), y), z) in self.radiance.iter().zip(x).zip(y).zip(z) {
            for c in 0..3 {
                let length = [x[c], y[c], z[c]].map(f64::from).iter().map(|v| v * v).sum::<f64>().sqrt();
                if f64::from(light[c]) < length {
                    for v in [&mut x[c], &mut y[c], &mut z[c]] {
                        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
                        let shorter = (f64::from(*v) * (f64::from(light[c]) / length)) as f32;
                        *v = shorter;
                    }
                }
            }
        }
    }

    /// The same layers in the same order to change, each with whether it may be negative.
    pub(super) fn light_layers_mut(&mut self) -> impl Iterator<Item = (bool, &mut Vec<[f32; 3]>)> {
        let parts = self.direct.iter_mut().chain(&mut self.indirect);
        let unsigned = std::iter::once(&mut self.radiance).chain(parts).map(|layer| (false, layer));
        unsigned.chain(self.sh1.iter_mut().flatten().map(|layer| (true, layer)))
    }

    /// All layers of three channels with their prefix: those of light, `noisy`, `rmse` and `stderr`.
    pub(super) fn layers(&self) -> impl Iterator<Item = (&'static str, &Vec<[f32; 3]>)> {
        let others = [("noisy", self.noisy.as_ref()), ("rmse", self.rmse.as_ref())];
        let others = others.into_iter().filter_map(|(name, layer)| Some((name, layer?)));
        self.light_layers().chain(others).chain([("stderr", &self.std_err)])
    }

    /// Gives back the memory of all layers but radiance and coverage.
    pub fn keep_radiance(&mut self) {
        *self = Self {
            width: self.width,
            height: self.height,
            radiance: std::mem::take(&mut self.radiance),
            coverage: std::mem::take(&mut self.coverage),
            ..Self::default()
        };
    }

    /// First layer whose length is not `width * height`.
    pub(super) fn misshapen_layer(&self) -> Option<&'static str> {
        let n = self.n_texels();
        if self.coverage.len() != n {
            return Some("coverage");
        }
        if self.std_err.len() != n {
            return Some("std_err");
        }
        let wrong = self.layers().find(|(_, layer)| layer.len() != n);
        wrong.map(|(name, _)| if name.is_empty() { "radiance" } else { name })
    }
}

/// Rec. 709 luminance of a linear colour, in the colour's own unit.
#[must_use]
pub fn luminance(c: [f32; 3]) -> f64 {
    0.2126 * f64::from(c[0]) + 0.7152 * f64::from(c[1]) + 0.0722 * f64::from(c[2])
}

/// Sums over covered texels, from which a page's or a whole bake's figures follow.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PageStats {
    /// Texels with coverage above 0.
    pub covered: u64,
    /// Sum of luminance, nits.
    pub sum_luminance: f64,
    /// Sum of the squared standard error of luminance, nits squared.
    pub sum_squared_std_err: f64,
    /// Largest standard error of luminance, nits.
    pub max_std_err: f64,
}

impl PageStats {
    /// Of the light as it was gathered: before denoising. Sums in texel order, so that the figures do not depend on threads.
    ///
    /// The channels of a texel come from the same paths, so their errors are taken as fully
    /// correlated: the standard error of luminance is the luminance of the standard errors, an
    /// upper bound that is reached under grey light.
    #[must_use]
    pub fn of(page: &Page) -> Self {
        let mut stats = Self::default();
        let gathered = page.noisy.as_ref().unwrap_or(&page.radiance);
        for ((&radiance, &std_err), &coverage) in gathered.iter().zip(&page.std_err).zip(&page.coverage) {
            if coverage <= 0.0 {
                continue;
            }
            let error = luminance(std_err);
            stats.covered += 1;
            stats.sum_luminance += luminance(radiance);
            stats.sum_squared_std_err += error * error;
            stats.max_std_err = stats.max_std_err.max(error);
        }
        stats
    }

    /// The same where the squares of errors have been found to be so much larger than stated.
    #[must_use]
    pub fn with_squares(self, factor: f64) -> Self {
        Self { sum_squared_std_err: self.sum_squared_std_err * factor, ..self }
    }

    /// The sums of both; merge pages in page order.
    #[must_use]
    pub fn merge(self, o: Self) -> Self {
        Self {
            covered: self.covered + o.covered,
            sum_luminance: self.sum_luminance + o.sum_luminance,
            sum_squared_std_err: self.sum_squared_std_err + o.sum_squared_std_err,
            max_std_err: self.max_std_err.max(o.max_std_err),
        }
    }

    /// Mean luminance over covered texels, nits; 0 where nothing is covered.
    #[must_use]
    pub fn mean_luminance(&self) -> f64 {
        self.per_texel(self.sum_luminance)
    }

    /// The figures as the manifest states them.
    #[must_use]
    pub fn error(&self) -> ErrorFigure {
        let rms_std_err = self.per_texel(self.sum_squared_std_err).sqrt();
        let mean = self.mean_luminance();
        ErrorFigure {
            rms_std_err,
            relative: (0.0 < mean).then(|| rms_std_err / mean),
            max_std_err: self.max_std_err,
        }
    }

    #[expect(clippy::cast_precision_loss, reason = "a page has far fewer than 2^53 texels")]
    fn per_texel(&self, sum: f64) -> f64 {
        if self.covered == 0 { 0.0 } else { sum / self.covered as f64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_count_covered_texels_only() {
        let mut page = Page::new(2, 2);
        page.radiance = vec![[1.0; 3], [3.0; 3], [100.0; 3], [100.0; 3]];
        page.std_err = vec![[0.3; 3], [0.4; 3], [9.0; 3], [9.0; 3]];
        page.coverage = vec![1.0, 0.25, 0.0, 0.0];
        let stats = PageStats::of(&page);
        assert_eq!(stats.covered, 2);
        assert!((stats.mean_luminance() - 2.0).abs() < 1e-12);
        let figure = stats.error();
        let expected = ((0.09 + 0.16) / 2.0_f64).sqrt();
        assert!((figure.rms_std_err - expected).abs() < 1e-7, "{figure:?}");
        assert!(figure.relative.is_some_and(|r| (r - expected / 2.0).abs() < 1e-7), "{figure:?}");
        assert!((figure.max_std_err - 0.4).abs() < 1e-7);
    }

    #[test]
    fn merged_pages_equal_one_large_page() {
        let mut page = Page::new(2, 1);
        page.radiance = vec![[1.0, 2.0, 3.0], [0.5, 0.25, 4.0]];
        page.std_err = vec![[0.5; 3], [0.25; 3]];
        page.coverage = vec![1.0; 2];
        let half = |i: usize| Page {
            width: 1,
            height: 1,
            radiance: vec![page.radiance[i]],
            coverage: vec![1.0],
            std_err: vec![page.std_err[i]],
            ..Page::default()
        };
        let merged = PageStats::of(&half(0)).merge(PageStats::of(&half(1)));
        assert_eq!(merged, PageStats::of(&page));
    }

    #[test]
    fn an_empty_page_has_no_relative_error() {
        let figure = PageStats::of(&Page::new(4, 4)).error();
        assert_eq!(figure, ErrorFigure { rms_std_err: 0.0, relative: None, max_std_err: 0.0 });
    }
}
