//! Questions to tables.

use super::file::{Axis, Block, Emitter, Form, Part, Tables};
use crate::harmonics::Zh64;
use crate::response::moments::similar_decay;
use crate::response::patch::{self, HALF, Response};

/// Which orders of scattering are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orders {
    /// From the first to the second, both included, one by one.
    Span(u32, u32),
    /// Infinitely many from 2 on.
    Rest,
    /// Infinitely many from 1 on.
    All,
}

/// A question, for sigma_t = 1 and an emitter of strength 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// Where light comes from.
    pub emitter: Emitter,
    /// Distance or depth, mean free paths.
    pub depth: f64,
    /// Angle between a patch's normal and the way to the receiver, radians.
    pub theta: f64,
    /// Mean cosine of scattering.
    pub g: f64,
    /// Albedo of single scattering.
    pub albedo: f64,
    /// Which orders.
    pub orders: Orders,
}

/// An answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// Coefficients about the axis, powers of the albedo included.
    pub zh: Zh64,
    /// Axis in the frame of [`crate::response::patch`]; +z, the way to the light, for point and directional emitters.
    pub axis: [f64; 3],
    /// Coefficients with m >= 0 in that frame, before the lobe is fitted.
    pub light: Response,
    /// What was outside the tables and taken at their end.
    pub clamped: Vec<&'static str>,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum QueryError {
    /// The file lacks the table.
    #[error("the file has no table of {1} of {0} light; build one that has with `tables build`")]
    Missing(Emitter, Part),
    /// A number that means nothing.
    #[error("{0}")]
    Nonsense(&'static str),
}

/// Greatest albedo for which the sum over all orders under a sun is tabulated: at 1 it counts light from beneath the ground.
pub const MOST_UNDER_A_SUN: f64 = 0.99;

impl Tables {
    /// Answers a question.
    ///
    /// # Errors
    ///
    /// If the file lacks a table, or a number means nothing.
    pub fn query(&self, q: &Query) -> Result<Answer, QueryError> {
        self.query_log(q, 0.0)
    }

    /// The answer times exp(`log_factor`), which keeps it within range however deep the question goes.
    ///
    /// # Errors
    ///
    /// Those of [`Tables::query`].
    pub fn query_log(&self, q: &Query, log_factor: f64) -> Result<Answer, QueryError> {
        let sum = self.sum(q, log_factor)?;
        if sum.full {
            let fit = patch::Fit::new(&sum.light);
            return Ok(Answer { zh: fit.zh, axis: fit.axis(), light: sum.light, clamped: sum.clamped });
        }
        // A sum of lobes is one about the mean of their axes, weighed by their fluence.
        let length = sum.axis.iter().map(|v| v * v).sum::<f64>().sqrt();
        let axis = if 0.0 < length { sum.axis.map(|v| v / length) } else { [0.0, 0.0, 1.0] };
        Ok(Answer { zh: patch::about(&sum.light, axis), axis, light: sum.light, clamped: sum.clamped })
    }

    /// [`Answer::light`] of [`Tables::query_log`], without looking for the lobe that fits it best, which takes most of the time.
    pub(super) fn light_log(&self, q: &Query, log_factor: f64) -> Result<Response, QueryError> {
        self.sum(q, log_factor).map(|sum| sum.light)
    }

    fn sum(&self, q: &Query, log_factor: f64) -> Result<Sum, QueryError> {
        if !(0.0..f64::INFINITY).contains(&q.depth) || (q.depth == 0.0 && q.emitter != Emitter::Directional) {
            return Err(QueryError::Nonsense("a distance is a positive number of mean free paths"));
        }
        if !(0.0..=1.0).contains(&q.albedo) {
            return Err(QueryError::Nonsense("an albedo lies between 0 and 1"));
        }
        if !(-1.0 < q.g && q.g < 1.0) {
            return Err(QueryError::Nonsense("g lies between -1 and 1"));
        }
        if !(0.0..=std::f64::consts::PI + 1e-9).contains(&q.theta) {
            return Err(QueryError::Nonsense("an angle lies between 0 and 180 degrees"));
        }
        let mut sum = Sum { light: [0.0; HALF], axis: [0.0; 3], full: false, clamped: Vec::new() };
        match q.orders {
            Orders::Span(from, to) if from == 0 || to < from => {
                return Err(QueryError::Nonsense("orders of scattering begin at 1 and ascend"));
            }
            Orders::Span(from, to) => {
                for n in from..=to {
                    self.add(q, Part::Order(n), log_factor, &mut sum)?;
                }
            }
            Orders::Rest => self.add(q, Part::Rest, log_factor, &mut sum)?,
            Orders::All => {
                self.add(q, Part::Order(1), log_factor, &mut sum)?;
                self.add(q, Part::Rest, log_factor, &mut sum)?;
            }
        }
        Ok(sum)
    }

    /// About how fast the light of a question falls with depth D: like exp(-decay D), but for a factor that changes slowly.
    #[must_use]
    pub fn decay(&self, q: &Query) -> f64 {
        let part = match q.orders {
            Orders::Span(..) => return 1.0,
            Orders::Rest | Orders::All => Part::Rest,
        };
        self.block(q.emitter, part).map_or(1.0, |block| {
            let scaled = Scaled::new(block, q);
            (similar_decay(scaled.albedo, scaled.g) * scaled.stretch).min(1.0)
        })
    }

    fn add(&self, q: &Query, part: Part, more: f64, sum: &mut Sum) -> Result<(), QueryError> {
        let block = self.block(q.emitter, part).ok_or(QueryError::Missing(q.emitter, part))?;
        let scaled = Scaled::new(block, q);
        let mut clamp = |what: &'static str, outside: bool| {
            if outside && !sum.clamped.contains(&what) {
                sum.clamped.push(what);
            }
        };
        clamp("g", scaled.g_outside);
        clamp("albedo", scaled.albedo_outside);
        let depth = q.depth * scaled.stretch;
        let root = (1.0 - scaled.albedo).sqrt();
        let at: Vec<f64> = block
            .axes
            .iter()
            .map(|axis| match axis {
                Axis::Distance { first, last, .. } => {
                    // Below the first node nothing changes any more.
                    clamp("depth", *last < depth || depth < 1e-3 * first);
                    depth
                }
                Axis::G { .. } | Axis::Columns { .. } => scaled.g,
                Axis::RootOfAbsorption { .. } => root,
                Axis::Angle { .. } | Axis::Bins { .. } => q.theta,
            })
            .collect();
        let (power, decay) = match part {
            Part::Order(n) => (f64::from(n), 1.0),
            Part::Rest => (2.0, similar_decay(scaled.albedo, scaled.g)),
        };
        let mut log_factor = more + power * scaled.albedo.ln() - decay * depth;
        if q.emitter != Emitter::Directional {
            log_factor += 2.0 * scaled.stretch.ln() - depth.ln();
        }
        let (light, shift) = self.interpolate(block, &at, log_factor);
        for (sum, v) in sum.light.iter_mut().zip(light) {
            *sum += v;
        }
        sum.full |= block.form == Form::Full;
        for (sum, v) in sum.axis.iter_mut().zip(patch::axis(shift)) {
            *sum += light[0] * v;
        }
        Ok(())
    }
}

/// What an answer is summed up from.
struct Sum {
    light: Response,
    /// Axes of lobes, weighed by their fluence.
    axis: [f64; 3],
    /// Whether more than lobes are in it.
    full: bool,
    clamped: Vec<&'static str>,
}

/// The medium for which a block is asked.
struct Scaled {
    albedo: f64,
    g: f64,
    /// Factor of distances.
    stretch: f64,
    g_outside: bool,
    albedo_outside: bool,
}

impl Scaled {
    fn new(block: &Block, q: &Query) -> Self {
        let range = block.axes.iter().find_map(|axis| match axis {
            Axis::G { to, .. } | Axis::Columns { to, .. } => Some(*to),
            _ => None,
        });
        let mut out =
            Self { albedo: q.albedo, g: q.g, stretch: 1.0, g_outside: false, albedo_outside: false };
        if let Some(to) = range {
            out.g = q.g.clamp(-to, to);
            out.g_outside = out.g != q.g;
        } else {
            // By similarity (\[ZRB14\] Zhao, Ramamoorthi and Bala, "High-Order Similarity Relations in Radiative Transfer"): scattering
            // by g counts as (1 - g) of isotropic scattering.
            out.stretch = 1.0 - q.albedo * q.g;
            (out.albedo, out.g) = (q.albedo * (1.0 - q.g) / out.stretch, 0.0);
        }
        if block.part == Part::Rest && q.emitter == Emitter::Directional && MOST_UNDER_A_SUN < out.albedo {
            out.albedo = MOST_UNDER_A_SUN;
            out.albedo_outside = true;
        }
        out
    }
}
