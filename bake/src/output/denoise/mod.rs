//! Takes noise out of solved texels.
//!
//! A texel becomes a weighted mean of those whose surfaces continue its own in the world, within a chart or beyond it, and whose
//! values differ from its own by no more than their noise explains (\[RKZ12\] Rousselle, Knaus and Zwicker, "Adaptive
//! rendering with non-local means filtering", 2012, weigh differences by variances in this way). What comes straight from
//! suns and lamps and what paths bring are filtered apart: the first has edges and little noise, the second the reverse.
//!
//! 1. The variances of texels are brought to what halves of their samples tell over a neighbourhood, `part`.
//! 2. `final` filters a small neighbourhood first, and compares texels by the result: noise that decides what it is
//!    averaged with does not go away.
//! 3. For each texel the error that each radius would leave is estimated; where none is clearly better than no filter,
//!    the texel stays as it is.
//! 4. Weights are the same both ways, `filter`, so that the sum over all texels stays as it was.
//!
//! Walls part texels of a floor that runs through below them, as seen half a texel above it. Where hundreds of texels lie in the same
//! place, each looks at some of them only.
//!
//! All is relative: to the texels' size, and to their own variances. No sum depends on the number of threads.

mod filter;
mod part;
mod places;
mod walls;

use crate::error::{Error, Result};
use crate::geom::texel::TexelMap;
use crate::output::page::{Page, luminance};
use crate::plan::Plan;
use crate::plan::settings::Denoise;
use crate::scene::model::Rgb;
use crate::solve::Monitor;
use crate::solve::lightmap::{Gathered, Solution, Texel, joint};
use crate::solve::visible::Validity;
use glam::Vec3;
use part::{Clean, DRAFT, FINAL, Method, Part};
use places::Places;
use tables::format::manifest::Denoised;

/// A texel's light after denoising.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Light {
    /// `E / pi` straight from lights, nits.
    pub direct: Rgb,
    /// The rest, nits.
    pub indirect: Rgb,
    /// Estimated root mean squared error of both together, nits.
    pub rmse: Rgb,
}

/// Light straight from suns and lamps stays as it is unless most of its noise goes: at the edge of a shadow even halves of its
/// samples overstate its noise, by half.
const WORTH_SMALL: f32 = 0.3;

/// The same for what paths bring.
const WORTH_PATHS: f32 = 0.7;

/// Denoises a page's solution, which stays as it is; one entry for each of its texels. `None` where nothing is to be done.
///
/// # Errors
/// [`Error::Interrupted`] when the monitor asks to stop.
pub fn denoise(
    plan: &Plan,
    map: &TexelMap,
    solution: &Solution,
    monitor: &Monitor,
) -> Result<Option<Vec<Light>>> {
    let method = match plan.settings().denoise {
        Denoise::Off => return Ok(None),
        Denoise::Draft => DRAFT,
        Denoise::Final => FINAL,
    };
    let places = Places::find(plan, map, solution, method.reach(), monitor);
    let unit = unit(solution);
    let small = gather(&places, solution, unit, WORTH_SMALL, |t| (t.small, t.scattered));
    let small = small.denoise(&places, method);
    let paths = gather(&places, solution, unit, WORTH_PATHS, |t| (t.paths, t.unreflected));
    let paths = paths.denoise(&places, method);
    if monitor.stopped() {
        return Err(Error::Interrupted);
    }
    // What cannot be seen stays as it is until it is filled from the others.
    let mut lights: Vec<Light> = solution.texels.iter().map(|t| as_it_is(solution, t)).collect();
    for ((&i, small), paths) in places.texels.iter().zip(&small).zip(&paths) {
        let texel = &solution.texels[i as usize];
        lights[i as usize] = joined(texel, small, paths, unit);
    }
    Ok(Some(lights))
}

impl Method {
    /// How far texels look, texels.
    fn reach(self) -> f32 {
        self.radii.iter().copied().fold(part::POOL, f32::max)
    }
}

/// The power of two below the brightest texel, nits: what is relative to it has squares that no float overflows by, and is
/// the same to the bit under any light that is a power of two brighter.
fn unit(solution: &Solution) -> f32 {
    let valid = solution.texels.iter().filter(|t| t.validity == Validity::Valid);
    let brightest =
        valid.map(|t| t.small.mean.max_element().max(t.paths.mean.max_element())).fold(0.0, f32::max);
    let power = f32::from_bits(brightest.to_bits() & 0xff80_0000);
    if power.is_normal() { power } else { 1.0 }
}

/// One part of the light in the order of places: what was gathered, and the share that is split off from it.
fn gather(
    places: &Places<'_>,
    solution: &Solution,
    unit: f32,
    worth: f32,
    of: impl Fn(&Texel) -> (Gathered, Rgb),
) -> Part {
    let n = places.len();
    let mut part = Part {
        layers: Vec::with_capacity(n),
        variance: Vec::with_capacity(n),
        halves: Vec::with_capacity(n),
        worth,
    };
    for &i in &places.texels {
        let (gathered, split) = of(&solution.texels[i as usize]);
        let error = gathered.std_err / unit;
        part.layers.push([gathered.mean / unit, split / unit]);
        part.variance.push(error * error);
        part.halves.push(gathered.halves / unit);
    }
    part
}

fn as_it_is(solution: &Solution, texel: &Texel) -> Light {
    #[expect(clippy::cast_possible_truncation, reason = "a factor near 1")]
    let factor = solution.factor(texel) as f32;
    Light { direct: texel.direct(), indirect: texel.indirect(), rmse: texel.std_err() * factor }
}

fn joined(texel: &Texel, small: &Clean, paths: &Clean, unit: f32) -> Light {
    let with = |old: Gathered, new: &Clean| Gathered { mean: new.layers[0] * unit, ..old };
    let mut clean = *texel;
    (clean.small, clean.scattered) = (with(texel.small, small), small.layers[1] * unit);
    (clean.paths, clean.unreflected) = (with(texel.paths, paths), paths.layers[1] * unit);
    let error = |part: &Clean, old: Rgb| {
        let e = part.error.sqrt() * unit;
        let whole = crate::geom::world::luminance(old);
        // Channels share it as they shared the noise.
        if 0.0 < whole { old * (e / whole) } else { Vec3::splat(e) }
    };
    let (a, b) = (error(small, texel.small.std_err), error(paths, texel.paths.std_err));
    Light { direct: clean.direct(), indirect: clean.indirect(), rmse: joint(a, b) }
}

/// Standard errors by which a texel has to change to be counted as changed.
const CHANGED: f64 = 3.0;

/// Sums over covered texels of what denoising did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DenoiseStats {
    covered: u64,
    changed: u64,
    sum_luminance: f64,
    sum_squared_error: f64,
    max_error: f64,
}

impl DenoiseStats {
    /// `None` for a page that was not denoised. Sums in texel order.
    #[must_use]
    pub fn of(page: &Page) -> Option<Self> {
        let (noisy, rmse) = (page.noisy.as_ref()?, page.rmse.as_ref()?);
        let mut stats = Self::default();
        for i in (0..page.n_texels()).filter(|&i| 0.0 < page.coverage[i]) {
            let (before, after, error) =
                (luminance(noisy[i]), luminance(page.radiance[i]), luminance(rmse[i]));
            stats.covered += 1;
            stats.changed += u64::from(CHANGED * luminance(page.std_err[i]) < (after - before).abs());
            stats.sum_luminance += after;
            stats.sum_squared_error += error * error;
            stats.max_error = stats.max_error.max(error);
        }
        Some(stats)
    }

    /// The sums of both; merge pages in page order.
    #[must_use]
    pub fn merge(self, o: Self) -> Self {
        Self {
            covered: self.covered + o.covered,
            changed: self.changed + o.changed,
            sum_luminance: self.sum_luminance + o.sum_luminance,
            sum_squared_error: self.sum_squared_error + o.sum_squared_error,
            max_error: self.max_error.max(o.max_error),
        }
    }

    /// The figures as the manifest states them.
    #[must_use]
    pub fn figures(&self) -> Denoised {
        let n = self.covered.max(1) as f64;
        let rms_error = (self.sum_squared_error / n).sqrt();
        let mean = self.sum_luminance / n;
        Denoised {
            rms_error,
            relative: (0.0 < mean).then(|| rms_error / mean),
            max_error: self.max_error,
            changed: self.changed as f64 / n,
        }
    }
}

#[cfg(test)]
mod tests;
