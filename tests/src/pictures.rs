//! Compares noisy pictures with the mean and the variance of others.
//!
//! Every bake has noise of its own, so that pictures of two bakes are never equal. What is checked in is therefore the mean of pictures of
//! some bakes and the standard deviation of one of them, pixel by pixel; another bake is judged by how many standard deviations it is off.

use std::path::Path;

use exr::prelude as exr;
use half::f16;
use image::{Rgb, RgbImage};

use crate::{baked::Page, stats};

/// Radiance, nits, linear Rec. 709; row 0 is the top.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Red, green and blue, row by row.
    pub pixels: Vec<[f64; 3]>,
}

/// What is known of pictures of several bakes.
#[derive(Clone, Debug)]
pub struct Reference {
    /// How many bakes.
    pub bakes: u32,
    /// Their mean.
    pub mean: Picture,
    /// Standard deviation of one of them, nits.
    pub deviation: Picture,
}

/// How a picture lies to a [`Reference`].
#[derive(Clone, Debug)]
pub struct Verdict {
    /// z of each pixel and channel: how many standard deviations it is off.
    pub z: Picture,
    /// Mean of z.
    pub mean: f64,
    /// Mean of its square.
    pub square: f64,
    /// The part of pixels and channels whose z is beyond [`Reference::bound`].
    pub beyond: f64,
    /// What the reference is to be multiplied by to be the picture, as well as one number can, less 1.
    pub exposure: f64,
}

/// Pixels to each side whose variance is pooled: a lightmap's texel covers a few, whose noise is nearly the same.
const NEAR: usize = 1;

/// A part of the mean that nobody sees and that is no noise: half floats are rounded by up to 1/2048, and adapters filter with as few as eight
/// bits of a coordinate.
const RELATIVE: f64 = 0.005;

/// The same where it is dark, as a part of the mean over the picture.
const DARK: f64 = 0.0005;

/// The level of one pixel's bound.
const LEVEL: f64 = 1e-3;

impl Picture {
    /// Reads an EXR with channels R, G and B.
    ///
    /// # Errors
    /// With the path, where it cannot be read.
    pub fn read(path: &Path) -> Result<Self, String> {
        Ok(Self::of(&Page::read(path)?, ""))
    }

    fn of(page: &Page, prefix: &str) -> Self {
        let at = |i: usize| page.rgb(prefix, i % page.width, i / page.width).as_dvec3().to_array();
        let (width, height) = (page.width, page.height);
        Self { width, height, pixels: (0..width * height).map(at).collect() }
    }

    /// Something of each pixel, whose place is given.
    #[must_use]
    pub fn map(&self, of: impl Fn(usize, usize) -> [f64; 3]) -> Self {
        let pixels = (0..self.pixels.len()).map(|i| of(i % self.width, i / self.width)).collect();
        Self { pixels, ..*self }
    }

    /// A pixel; the nearest one beyond an edge.
    #[must_use]
    pub fn at(&self, x: usize, y: usize) -> [f64; 3] {
        self.pixels[y.min(self.height - 1) * self.width + x.min(self.width - 1)]
    }

    /// As if it had been exposed by a factor.
    #[must_use]
    pub fn exposed(&self, factor: f64) -> Self {
        self.map(|x, y| self.at(x, y).map(|v| factor * v))
    }

    /// Moved to the left by some pixels.
    #[must_use]
    pub fn moved(&self, by: usize) -> Self {
        self.map(|x, y| self.at(x + by, y))
    }

    /// The mean of all pixels and channels.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.pixels.iter().flatten().sum::<f64>() / (3 * self.pixels.len()) as f64
    }

    /// To be looked at: the mean becomes middle grey, and what is bright is compressed.
    #[must_use]
    pub fn image(&self) -> RgbImage {
        let exposure = 0.18 / self.mean().max(f64::MIN_POSITIVE);
        self.encoded(|v| {
            (exposure * v / (1.0 + exposure * v).max(f64::MIN_POSITIVE)).max(0.0).powf(1.0 / 2.2)
        })
    }

    /// To be looked at, of numbers of either sign: 0 is grey, -8 black and 8 white.
    #[must_use]
    pub fn signed_image(&self) -> RgbImage {
        self.encoded(|v| 0.5 + v / 16.0)
    }

    fn encoded(&self, code: impl Fn(f64) -> f64) -> RgbImage {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0 to 255")]
        let byte = |v: f64| (255.0 * code(v)).round().clamp(0.0, 255.0) as u8;
        let side = |n: usize| u32::try_from(n).unwrap_or(0);
        RgbImage::from_fn(side(self.width), side(self.height), |x, y| {
            Rgb(self.at(x as usize, y as usize).map(byte))
        })
    }
}

impl Reference {
    /// Of pictures of several bakes.
    ///
    /// # Panics
    /// If they are fewer than two.
    #[must_use]
    pub fn of(pictures: &[Picture]) -> Self {
        assert!(1 < pictures.len(), "a variance needs two pictures");
        let n = pictures.len() as f64;
        let sum = |f: &dyn Fn(&Picture) -> f64| pictures.iter().map(f).sum::<f64>();
        let first = &pictures[0];
        let mean = first.map(|x, y| std::array::from_fn(|c| sum(&|p: &Picture| p.at(x, y)[c]) / n));
        let deviation = first.map(|x, y| {
            let off = |c: usize| sum(&|p: &Picture| (p.at(x, y)[c] - mean.at(x, y)[c]).powi(2));
            std::array::from_fn(|c| (off(c) / (n - 1.0)).sqrt())
        });
        Self { bakes: u32::try_from(pictures.len()).unwrap_or(u32::MAX), mean, deviation }
    }

    /// Reads what [`Reference::write`] wrote of so many bakes.
    ///
    /// # Errors
    /// With the path, where it cannot be read.
    pub fn read(path: &Path, bakes: u32) -> Result<Self, String> {
        let page = Page::read(path)?;
        Ok(Self { bakes, mean: Picture::of(&page, ""), deviation: Picture::of(&page, "stddev.") })
    }

    /// Writes half floats: R, G, B, and stddev.R and so on.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), String> {
        let mut list = Vec::new();
        for (prefix, picture) in [("", &self.mean), ("stddev.", &self.deviation)] {
            for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
                let values = picture.pixels.iter().map(|p| f16::from_f64(p[c])).collect();
                let name = format!("{prefix}{name}");
                list.push(exr::AnyChannel::new(name.as_str(), exr::FlatSamples::F16(values)));
            }
        }
        let encoding = exr::Encoding { compression: exr::Compression::ZIP16, ..exr::Encoding::default() };
        let channels = exr::AnyChannels::sort(list.into_iter().collect());
        let size = (self.mean.width, self.mean.height);
        let layer = exr::Layer::new(size, exr::LayerAttributes::default(), encoding, channels);
        exr::WritableImage::write(&exr::Image::from_layer(layer))
            .to_file(path)
            .map_err(|e| format!("{}: {e}", path.display()))
    }

    /// How far off a z may be: once in a thousand pixels z is beyond. z has Student's distribution, as its standard deviation is that of a few
    /// pictures. The freedom is that of one pixel: its neighbours, whose variance is pooled with its own, may lie on the same texels and have
    /// the same noise; where they do not, the bound is a little wide.
    #[must_use]
    pub fn bound(&self) -> f64 {
        stats::two_sided_t(LEVEL, self.bakes - 1)
    }

    /// The standard deviation that the difference of another picture and the mean has at a pixel, by channel, nits; `dark` is the least that
    /// differences that are no noise may be.
    fn spread(&self, x: usize, y: usize, dark: f64) -> [f64; 3] {
        let mut sum = [0.0; 3];
        let mut n = 0.0;
        for v in y.saturating_sub(NEAR)..=(y + NEAR).min(self.mean.height - 1) {
            for u in x.saturating_sub(NEAR)..=(x + NEAR).min(self.mean.width - 1) {
                let d = self.deviation.at(u, v);
                (0..3).for_each(|c| sum[c] += d[c] * d[c]);
                n += 1.0;
            }
        }
        let noise = 1.0 + 1.0 / f64::from(self.bakes);
        let mean = self.mean.at(x, y);
        std::array::from_fn(|c| {
            let still = RELATIVE * mean[c] + dark;
            (sum[c] / n * noise + still * still).sqrt()
        })
    }

    /// Compares a picture.
    ///
    /// # Errors
    /// If it has another size, or pixels that are no numbers.
    pub fn judge(&self, picture: &Picture) -> Result<Verdict, String> {
        let sizes = [&self.mean, picture].map(|p| (p.width, p.height));
        if sizes[0] != sizes[1] {
            return Err(format!("{:?} pixels instead of {:?}", sizes[1], sizes[0]));
        }
        if picture.pixels.iter().flatten().any(|v| !v.is_finite()) {
            return Err("a pixel is not finite".to_owned());
        }
        let dark = DARK * self.mean.mean();
        let spread = self.mean.map(|x, y| self.spread(x, y, dark));
        let z = self.mean.map(|x, y| {
            let (got, want, by) = (picture.at(x, y), self.mean.at(x, y), spread.at(x, y));
            std::array::from_fn(|c| (got[c] - want[c]) / by[c])
        });
        let all: Vec<f64> = z.pixels.iter().flatten().copied().collect();
        let mean = |of: &dyn Fn(f64) -> f64| all.iter().map(|v| of(*v)).sum::<f64>() / all.len() as f64;
        let bound = self.bound();
        // The factor that leaves the smallest sum of squares of z.
        let want = self.mean.pixels.iter().flatten().zip(spread.pixels.iter().flatten());
        let want: Vec<f64> = want.map(|(m, s)| m / s).collect();
        let off: f64 = want.iter().zip(&all).map(|(w, z)| w * z).sum();
        let exposure = off / want.iter().map(|w| w * w).sum::<f64>();
        Ok(Verdict {
            mean: mean(&|v| v),
            square: mean(&|v| v * v),
            beyond: mean(&|v| f64::from(u8::from(bound < v.abs()))),
            exposure,
            z,
        })
    }
}

/// The part of pixels that may be beyond the bound. Eight reference bakes have 0.05 % to 0.25 %, more than the bound's level, as noise has longer
/// tails than a normal number; edges differ between adapters, which cover pixels there a little more or less.
const MOST_BEYOND: f64 = 0.015;

/// How far off exposure may be. Noise of the light in fog is that of few nodes, which all pixels share, so that exposures are 0.45 % apart
/// (standard deviation of eight reference bakes; 0.1 % without fog); Student's bound for eight is 3.5 times as much at a level of 1 %.
const MOST_EXPOSURE: f64 = 0.015;

/// How far off the mean of z may be, which shares that noise: 0.2 is its standard deviation with fog.
const MOST_MEAN: f64 = 0.7;

/// Between what the mean square of z may be. That of Student's t is n / (n - 2) for n degrees of freedom: 1.4 for the seven of one pixel of eight
/// bakes, less where neighbours have noise of their own, or where what is allowed beside noise is more than noise. Reference bakes have 1.1 to
/// 1.8.
const SQUARE: [f64; 2] = [0.6, 2.4];

impl Verdict {
    /// Whether this is one more picture of the same.
    ///
    /// # Errors
    /// All that is too far off.
    pub fn accepted(&self) -> Result<(), String> {
        let Self { mean, square, beyond, exposure, .. } = self;
        let [low, high] = SQUARE;
        let faults = [
            (MOST_EXPOSURE < exposure.abs(), format!("exposure is off by {:+.2} %", 100.0 * exposure)),
            (MOST_MEAN < mean.abs(), format!("the mean of z is {mean:+.2}")),
            (*square < low || high < *square, format!("the mean square of z is {square:.2}")),
            (MOST_BEYOND < *beyond, format!("{:.2} % of pixels are far off", 100.0 * beyond)),
        ];
        let faults: Vec<String> = faults.into_iter().filter(|(bad, _)| *bad).map(|(_, what)| what).collect();
        if faults.is_empty() { Ok(()) } else { Err(faults.join(", ")) }
    }
}
