//! Where the sky is seen from: directions through windows, learnt per region of the scene.
//!
//! Inside a building the sky is a few windows, which directions chosen by cosine rarely find. A pilot
//! notes for each cell of a coarse grid over the scene through which directions light comes in;
//! next-event estimation chooses directions by that, weighed against those found by chance. A cell
//! that knows nothing, or a direction that the pilot missed, keeps a share of the probability, so
//! nothing is lost.

use crate::sample::discrete::Cdf;
use crate::sample::sequence::key;
use glam::{UVec3, Vec3, Vec3A};
use std::f32::consts::PI;

/// Directions are divided into this many steps of azimuth and of height: equal solid angles.
const AZIMUTH: usize = 48;

/// See [`AZIMUTH`].
const HEIGHT: usize = 24;

/// Solid angle of one direction cell, steradians.
const CELL: f32 = 4.0 * PI / (AZIMUTH * HEIGHT) as f32;

/// Directions in all.
pub const DIRECTIONS: usize = AZIMUTH * HEIGHT;

/// Share of probability that is spread evenly over all directions.
const EVEN: f64 = 0.05;

/// Regions along the longest side of the scene.
const LONGEST: f32 = 16.0;

/// Regions of the scene's bounding box.
#[derive(Clone, Copy, Debug)]
pub struct Regions {
    lo: Vec3A,
    size: f32,
    count: UVec3,
}

impl Regions {
    /// Divides the box from `lo` to `hi` into cubes; `None` for a box without extent.
    #[must_use]
    pub fn new(lo: Vec3, hi: Vec3) -> Option<Self> {
        let extent = hi - lo;
        let size = extent.max_element() / LONGEST;
        if !(0.0 < size && size.is_finite()) {
            return None;
        }
        let count = (extent / size).ceil().max(Vec3::ONE).as_uvec3();
        Some(Self { lo: lo.into(), size, count })
    }

    /// Number of regions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.count.element_product() as usize
    }

    /// Whether there is none; there always is one.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The region that holds `p`, or the nearest one.
    #[must_use]
    pub fn of(&self, p: Vec3A) -> usize {
        let at = ((p - self.lo) / self.size).max(Vec3A::ZERO);
        let at = Vec3::from(at).as_uvec3().min(self.count - UVec3::ONE);
        ((at.z * self.count.y + at.y) * self.count.x + at.x) as usize
    }
}

/// What the pilot learnt.
#[derive(Clone, Debug)]
pub struct SkyGuide {
    regions: Regions,
    /// Directions of each region; `None` where nothing is known or no light comes in.
    directions: Vec<Option<Cdf>>,
}

impl SkyGuide {
    /// From scores of all directions of each region, or of none where nobody looked; `None` if no region has a positive score.
    #[must_use]
    pub fn new(regions: Regions, scores: Vec<Vec<f64>>) -> Option<Self> {
        let directions: Vec<Option<Cdf>> = scores.into_iter().map(|s| distribution(&s)).collect();
        directions.iter().any(Option::is_some).then_some(Self { regions, directions })
    }

    /// A direction of the cell, `u` within it.
    #[must_use]
    pub fn direction(cell: usize, u: [f32; 2]) -> Vec3A {
        let (x, y) = (cell % AZIMUTH, cell / AZIMUTH);
        let h = 1.0 - 2.0 * (y as f32 + u[1]) / HEIGHT as f32;
        let r = (1.0 - h * h).max(0.0).sqrt();
        let (sin, cos) = (2.0 * PI * (x as f32 + u[0]) / AZIMUTH as f32).sin_cos();
        Vec3A::new(r * cos, h, r * sin)
    }

    /// A direction towards the sky from `p` and its density per steradian; `None` where the region
    /// knows nothing.
    #[must_use]
    pub fn sample(&self, p: Vec3A, u: [f32; 2]) -> Option<(Vec3A, f32)> {
        let cdf = self.directions[self.regions.of(p)].as_ref()?;
        let (cell, rest) = cdf.sample(u[0]);
        Some((Self::direction(cell, [rest, u[1]]), cdf.pdf(cell) / CELL))
    }

    /// Density per steradian with which [`SkyGuide::sample`] chooses `wi` from `p`.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the grid")]
    pub fn pdf(&self, p: Vec3A, wi: Vec3A) -> f32 {
        let Some(cdf) = &self.directions[self.regions.of(p)] else { return 0.0 };
        let turn = wi.z.atan2(wi.x) / (2.0 * PI);
        let x = (((turn - turn.floor()) * AZIMUTH as f32) as usize).min(AZIMUTH - 1);
        let y = (((0.5 - 0.5 * wi.y).max(0.0) * HEIGHT as f32) as usize).min(HEIGHT - 1);
        cdf.pdf(y * AZIMUTH + x) / CELL
    }
}

/// Scores, spread to their neighbours (a window's edge falls between the pilot's rays) and mixed with
/// an even share.
fn distribution(scores: &[f64]) -> Option<Cdf> {
    if scores.len() != DIRECTIONS {
        return None;
    }
    let mut spread = vec![0.0; DIRECTIONS];
    for (i, out) in spread.iter_mut().enumerate() {
        let (x, y) = (i % AZIMUTH, i / AZIMUTH);
        for v in y.saturating_sub(1)..(y + 2).min(HEIGHT) {
            for u in [x + AZIMUTH - 1, x, x + 1] {
                let own = if (u % AZIMUTH, v) == (x, y) { 4.0 } else { 1.0 };
                *out += own * scores[v * AZIMUTH + u % AZIMUTH];
            }
        }
    }
    let total: f64 = spread.iter().sum();
    if !(0.0 < total && total.is_finite()) {
        return None;
    }
    Cdf::new(spread.iter().map(|s| EVEN / DIRECTIONS as f64 + (1.0 - EVEN) * s / total))
}

/// Key of the pilot's random numbers for a region.
#[must_use]
pub const fn region_key(seed: u64, region: u64) -> u64 {
    key(seed, 0x5347, region)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Samples have the density that is stated for them, and the density integrates to 1.
    #[test]
    fn samples_and_density_agree() {
        let regions = Regions::new(Vec3::NEG_ONE, Vec3::new(1.0, 0.5, 3.0)).expect("a box");
        let mut scores = vec![vec![0.0; DIRECTIONS]; regions.len()];
        for s in &mut scores {
            s[100] = 3.0;
            s[101] = 1.0;
            s[900] = 2.0;
        }
        scores[3] = vec![0.0; DIRECTIONS];
        let guide = SkyGuide::new(regions, scores).expect("scores");
        let p = Vec3A::new(0.3, 0.2, 2.0);
        // The first number chooses among 1152 cells, most of them with a probability of 4e-5.
        let (n, m) = (1u32 << 20, 1u32);
        let (mut area, mut near, mut astray) = (0.0f64, 0, 0);
        for i in 0..n {
            for j in 0..m {
                let u = [(i as f32 + 0.5) / n as f32, (j as f32 + 0.5) / m as f32];
                let (wi, pdf) = guide.sample(p, u).expect("known");
                // Rounding may put a direction on a border into the next cell.
                astray += u32::from(1e-4 < (guide.pdf(p, wi) / pdf - 1.0).abs());
                area += 1.0 / f64::from(pdf);
                near += u32::from(wi.dot(SkyGuide::direction(100, [0.5; 2])) > 0.9);
            }
        }
        assert!(astray < 100, "{astray}");
        let n2 = f64::from(n) * f64::from(m);
        assert!((area / n2 / (4.0 * std::f64::consts::PI) - 1.0).abs() < 0.05, "{}", area / n2);
        assert!(f64::from(near) / n2 > 0.4);
        let nowhere = (0..regions.len()).filter(|&i| guide.directions[i].is_none()).count();
        assert_eq!(nowhere, 1);
    }
}
