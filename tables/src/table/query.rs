//! Questions to tables.

use super::file::{Axis, Emitter, Part, Tables};
use crate::harmonics::{BANDS, Zh64};
use crate::response::moments::decay;

/// Which orders of scattering are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Orders {
    /// This one.
    One(u32),
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
    /// What was outside the tables and taken at their end.
    pub clamped: Vec<&'static str>,
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum QueryError {
    /// The file lacks the table.
    #[error("the file has no table of {0:?} light of {1:?}; build one that has with `tables build`")]
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
        let mut answer = Answer { zh: [0.0; BANDS], axis: [0.0, 0.0, 1.0], clamped: Vec::new() };
        match q.orders {
            Orders::One(0) => return Err(QueryError::Nonsense("orders of scattering begin at 1")),
            Orders::One(n) => self.add(q, Part::Order(n), &mut answer)?,
            Orders::Rest => self.add(q, Part::Rest, &mut answer)?,
            Orders::All => {
                self.add(q, Part::Rest, &mut answer)?;
                self.add(q, Part::Order(1), &mut answer)?;
            }
        }
        Ok(answer)
    }

    fn add(&self, q: &Query, part: Part, answer: &mut Answer) -> Result<(), QueryError> {
        let block = self.block(q.emitter, part).ok_or(QueryError::Missing(q.emitter, part))?;
        let single = part == Part::Order(1);
        // By similarity where the table has no axis of g: scattering by g counts as (1 - g) of isotropic scattering.
        let similar = !single && q.emitter != Emitter::Point;
        let range = block.axes.iter().find_map(|axis| match axis {
            Axis::G { from, to, .. } => Some((*from, *to)),
            _ => None,
        });
        let g = range.map_or(q.g, |(from, to)| q.g.clamp(from, to));
        if g != q.g {
            answer.clamped.push("g");
        }
        let (mut albedo, mut stretch, mut g) = (q.albedo, 1.0, g);
        if similar {
            stretch = 1.0 - q.albedo * q.g;
            (albedo, g) = (q.albedo * (1.0 - q.g) / stretch, 0.0);
        }
        if part == Part::Rest && q.emitter == Emitter::Directional && MOST_UNDER_A_SUN < albedo {
            albedo = MOST_UNDER_A_SUN;
            answer.clamped.push("albedo");
        }
        let depth = q.depth * stretch;
        let root = (1.0 - albedo).sqrt();
        let at: Vec<f64> = block
            .axes
            .iter()
            .map(|axis| match axis {
                Axis::Distance { .. } => depth,
                Axis::G { .. } => g,
                Axis::RootOfAbsorption { .. } => root,
                Axis::Angle { .. } => q.theta,
            })
            .collect();
        let (zh, shift) = self.interpolate(block, &at);
        let (power, nu) = match part {
            Part::Order(n) => (albedo.powi(n.try_into().unwrap_or(i32::MAX)), 1.0),
            Part::Rest => (albedo * albedo, decay(albedo, g)),
        };
        let mut factor = power * (-nu * depth).exp();
        if q.emitter != Emitter::Directional {
            factor *= stretch * stretch / depth;
        }
        // A sum of lobes about two axes is one about their mean, weighed by their fluence.
        let old = answer.zh[0];
        for (sum, v) in answer.zh.iter_mut().zip(zh) {
            *sum += factor * v;
        }
        let axis = [shift, 0.0, (1.0 - shift * shift).sqrt()];
        let part = if old == 0.0 { 1.0 } else { factor * zh[0] / answer.zh[0] };
        let mixed: [f64; 3] = std::array::from_fn(|i| answer.axis[i] * (1.0 - part) + axis[i] * part);
        let length = mixed.iter().map(|v| v * v).sum::<f64>().sqrt();
        answer.axis = mixed.map(|v| v / length);
        Ok(())
    }
}
