//! Light paths of one segment: where the light of suns and lamps first lands.
//!
//! Sunlight through a window lands on a patch that a path from a texel rarely hits by chance, and
//! that patch may be what lights the room. So paths are also started at the lights: a beam leaves a
//! sun or a lamp, lands somewhere, and every vertex of a path connects to that place. The two ways
//! of finding the same light are weighed by their densities, both per area of the place where the
//! light lands (bidirectional path tracing with two light vertices: \[Vea97\] chapter 10).
//!
//! Which beams are worth their rays is learnt beforehand: each light's beams are divided into cells,
//! and a pilot measures what each cell brings to the receivers.

use crate::light::punctual::{Incident, Punctual, Sun};
use crate::sample::discrete::Cdf;
use glam::{Vec2, Vec3A};
use std::f32::consts::PI;

/// Share of the beams that is spread evenly over all cells, whatever the pilot says: a cell that
/// brought nothing to the pilot's receivers may still matter to another one.
const EVEN: f64 = 0.15;

/// Cells of all lights together, about.
const CELLS: usize = 1 << 14;

/// Which light a beam belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Index into [`crate::light::Lights::suns`].
    Sun(usize),
    /// Index into [`crate::light::Lights::punctual`].
    Punctual(usize),
}

/// The beams of all suns and lamps, and how one of them is chosen.
#[derive(Clone, Debug)]
pub struct Beams {
    suns: usize,
    punctual: usize,
    side: usize,
    /// Half the side of the square that a sun's beams start from, metres.
    reach: f32,
    cells: Option<Cdf>,
    /// What they bring to a receiver after one reflection, mean luminance, nits.
    reflected: f64,
}

/// A beam on its way.
#[derive(Clone, Copy, Debug)]
pub struct Beam {
    /// Where from.
    pub source: Source,
    /// Start, metres relative to the world's origin.
    pub origin: Vec3A,
    /// Unit direction the light travels along.
    pub direction: Vec3A,
}

impl Beams {
    /// Beams of the given numbers of lights in a scene whose points lie within `radius` metres of the
    /// world's origin, all cells alike.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small number of cells")]
    pub fn even(suns: usize, punctual: usize, radius: f32) -> Self {
        let lights = suns + punctual;
        let side = ((CELLS as f32 / lights.max(1) as f32).sqrt() as usize).clamp(4, 96);
        let cells = Cdf::new((0..lights * side * side).map(|_| 1.0));
        Self { suns, punctual, side, reach: radius, cells, reflected: 0.0 }
    }

    /// The same with cells chosen by what they bring: `scores` in the order of the cells, light by light, row by row.
    /// `reflected` is the mean luminance that a receiver gets from them after one reflection, nits.
    #[must_use]
    pub fn learnt(&self, scores: &[f64], reflected: f64) -> Self {
        let total: f64 = scores.iter().sum();
        let even = 1.0 / scores.len().max(1) as f64;
        let share = |s: f64| if 0.0 < total { (1.0 - EVEN) * s / total } else { 0.0 };
        let cells = Cdf::new(scores.iter().map(|&s| EVEN * even + share(s)));
        Self { cells, reflected, ..self.clone() }
    }

    /// Mean luminance that a receiver gets after one reflection, nits, as far as it was learnt.
    #[must_use]
    pub fn reflected(&self) -> f64 {
        self.reflected
    }

    /// Number of cells.
    #[must_use]
    pub fn len(&self) -> usize {
        self.cells.as_ref().map_or(0, Cdf::len)
    }

    /// Whether there is no light to start from.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Cells along one side of a light's square of cells.
    #[must_use]
    pub fn side(&self) -> usize {
        self.side
    }

    /// A beam chosen by the cells' probabilities; `u[0]` chooses the cell, the rest place and, for a
    /// sun with a disc, direction.
    #[must_use]
    pub fn sample(&self, suns: &[Sun], punctual: &[Punctual], u: [f32; 3], disc: [f32; 2]) -> Option<Beam> {
        let (cell, _) = self.cells.as_ref()?.sample(u[0]);
        Some(self.beam(suns, punctual, cell, [u[1], u[2]], disc))
    }

    /// A beam of the given cell.
    #[must_use]
    pub fn beam(
        &self,
        suns: &[Sun],
        punctual: &[Punctual],
        cell: usize,
        place: [f32; 2],
        disc: [f32; 2],
    ) -> Beam {
        let light = cell / (self.side * self.side);
        let within = cell % (self.side * self.side);
        let (x, y) = (within % self.side, within / self.side);
        let n = self.side as f32;
        let s = Vec2::new((x as f32 + place[0]) / n, (y as f32 + place[1]) / n);
        if light < suns.len() {
            let sun = &suns[light];
            let wi = sun.sample(disc).wi;
            let frame = sun.frame();
            let at = (s * 2.0 - 1.0) * self.reach;
            // Far enough that no point of the scene lies behind the start.
            let start = frame.x * at.x + frame.y * at.y;
            let origin = start + wi * (2.0 * self.reach / wi.dot(frame.z));
            return Beam { source: Source::Sun(light), origin, direction: -wi };
        }
        let i = light - suns.len();
        // Equal steps of height and azimuth are equal solid angles.
        let h = 1.0 - 2.0 * s.y;
        let r = (1.0 - h * h).max(0.0).sqrt();
        let (sin, cos) = (2.0 * PI * s.x).sin_cos();
        let direction = Vec3A::new(r * cos, h, r * sin);
        Beam { source: Source::Punctual(i), origin: punctual[i].position(), direction }
    }

    /// Density per area at a place `p` whose normal has cosine `cos` with the light, of beams from
    /// `source` that arrive from `light`. It ignores what stands in between, which shows when the
    /// beam is traced.
    #[must_use]
    pub fn area_density(&self, suns: &[Sun], source: Source, light: &Incident, p: Vec3A, cos: f32) -> f32 {
        let Some(cells) = &self.cells else { return 0.0 };
        let n = self.side as f32;
        match source {
            Source::Sun(i) => {
                let frame = suns[i].frame();
                let along = light.wi.dot(frame.z);
                let o = p - light.wi * (p.dot(frame.z) / along);
                let at = Vec2::new(o.dot(frame.x), o.dot(frame.y)) / (2.0 * self.reach) + 0.5;
                if at.min_element() < 0.0 || 1.0 < at.max_element() {
                    return 0.0;
                }
                let cell = self.cell(i, at);
                let size = 2.0 * self.reach / n;
                cells.pdf(cell) / (size * size) * cos / along
            }
            Source::Punctual(i) => {
                let d = -light.wi;
                let turn = d.z.atan2(d.x) / (2.0 * PI);
                let at = Vec2::new(turn - turn.floor(), 0.5 - 0.5 * d.y);
                let cell = self.cell(self.suns + i, at);
                cells.pdf(cell) * (n * n / (4.0 * PI)) * cos / (light.distance * light.distance)
            }
        }
    }

    /// Index of the cell of light number `light` (suns first) that holds `at` in [0, 1]^2.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the grid")]
    fn cell(&self, light: usize, at: Vec2) -> usize {
        let k = |x: f32| ((x * self.side as f32).max(0.0) as usize).min(self.side - 1);
        debug_assert!(light < self.suns + self.punctual, "light {light}");
        (light * self.side + k(at.y)) * self.side + k(at.x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::model::{LightKind, LightMode};
    use glam::Vec3;

    /// The density stated at a place is the one that beams have there: integrated over a plane that
    /// all of them reach, it is 1, and beams fall into cells of the plane in proportion to it.
    #[test]
    fn density_is_that_of_the_beams() {
        let sun = Sun::new(Vec3::new(0.3, -1.0, 0.2).normalize(), Vec3::ONE, 0.0, LightMode::Baked);
        let kind =
            LightKind::Point { position: Vec3::new(0.1, 0.7, -0.2), intensity: Vec3::ONE, range: None };
        let lamp = Punctual::new(kind, LightMode::Baked, Vec3::ZERO).expect("a lamp");
        let (suns, lamps) = ([sun], [lamp]);
        let even = Beams::even(1, 1, 1.0);
        let scores: Vec<f64> = (0..even.len()).map(|i| ((i * 7919) % 13) as f64).collect();
        let beams = even.learnt(&scores, 0.0);
        let index = |x: f32| {
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small index")]
            let i = x as usize;
            i
        };
        // Patches of the plane y = 0, counted and integrated.
        let n = 6;
        let extent = 1.0;
        let mut counts = vec![0.0f64; n * n];
        let samples = 300_000u32;
        let patch = |x: f32, z: f32| {
            let k = |v: f32| ((v + extent) / (2.0 * extent) * n as f32).floor();
            let (i, j) = (k(x), k(z));
            (0.0 <= i && i < n as f32 && 0.0 <= j && j < n as f32).then(|| index(j) * n + index(i))
        };
        for i in 0..samples {
            let mut s = crate::sample::Sequence::new(crate::sample::sequence::key(1, 2, u64::from(i)), 0);
            let [a, b, c, _] = s.next4();
            let beam = beams.sample(&suns, &lamps, [a, b, c], [0.5; 2]).expect("a beam");
            if beam.direction.y < 0.0 {
                let t = -beam.origin.y / beam.direction.y;
                let p = beam.origin + beam.direction * t;
                if let Some(k) = patch(p.x, p.z) {
                    counts[k] += 1.0;
                }
            }
        }
        let fine = 40;
        for j in 0..n {
            for i in 0..n {
                let mut integral = 0.0f64;
                let step = 2.0 * extent / n as f32 / fine as f32;
                for v in 0..fine {
                    for u in 0..fine {
                        let x =
                            -extent + (i as f32 + (u as f32 + 0.5) / fine as f32) * 2.0 * extent / n as f32;
                        let z =
                            -extent + (j as f32 + (v as f32 + 0.5) / fine as f32) * 2.0 * extent / n as f32;
                        let p = Vec3A::new(x, 0.0, z);
                        for (source, light) in [
                            (Source::Sun(0), suns[0].sample([0.5; 2])),
                            (Source::Punctual(0), lamps[0].incident(p).expect("lit")),
                        ] {
                            let d = beams.area_density(&suns, source, &light, p, light.wi.y.max(0.0));
                            integral += f64::from(d * step * step);
                        }
                    }
                }
                let want = integral * f64::from(samples);
                // Five standard deviations of a count, and the error of the quadrature at cell edges.
                let slack = 5.0 * want.sqrt() + 0.03 * want;
                assert!((counts[j * n + i] - want).abs() < slack, "{i} {j}: {} {want}", counts[j * n + i]);
            }
        }
    }
}
