//! Point lights in a lighting grid hierarchy: `--direct grid`.
//!
//! \[LGH17\] section 6.4. Receivers ask it for the light of all lamps at once, which is smooth where chosen lights are noise: only whether something is in the way is asked of
//! a few. What it does not hold stays with the other ways: spots and lamps with a range, whose light depends on where one stands, and lamps whose direct light is left to the game.

use crate::light::hierarchy::{Arriving, Blend, Build, Clamp, GridLights, Hierarchy, Options, PointLight};
use crate::light::punctual::Punctual;
use glam::Vec3A;

/// Radius of influence over spacing, if nothing else is said. 2, which is enough for volumes, leaves floors under lamps some per cent too dark, because lamps are points and the
/// levels' spacing comes from how far they are apart.
pub const ALPHA: f32 = 4.0;

/// Point lights by levels.
#[derive(Clone, Debug)]
pub struct LampGrid {
    hierarchy: Hierarchy,
}

impl LampGrid {
    /// Of those among `lamps` that suit; `None` where none does. The spacing of its first level comes from the lamps ([`Hierarchy::spacing_for`]).
    #[must_use]
    pub fn new(lamps: &[Punctual], alpha: f32) -> Option<Self> {
        Self::blended(lamps, alpha, Blend::Conserving)
    }

    fn blended(lamps: &[Punctual], alpha: f32, blend: Blend) -> Option<Self> {
        let suit = lamps.iter().filter(|l| l.suits_grid());
        let lights: Vec<PointLight> =
            suit.map(|l| PointLight { position: l.position(), intensity: l.intensity() }).collect();
        if lights.is_empty() {
            return None;
        }
        let anchor = Vec3A::ZERO;
        let options = Options {
            spacing: Hierarchy::spacing_for(&lights, anchor),
            alpha,
            levels: None,
            anchor,
            build: Build::FromLights,
            blend,
            // Lamps are points, and surfaces next to them as bright as they are.
            clamp: Clamp::Above,
            keep: 1.0,
        };
        Some(Self { hierarchy: Hierarchy::new(&lights, &options) })
    }

    /// Bytes that it takes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.hierarchy.bytes()
    }
}

impl GridLights for LampGrid {
    fn hierarchy(&self) -> &Hierarchy {
        &self.hierarchy
    }

    /// What arrives where nothing is in between.
    #[inline]
    fn visit(&self, place: Vec3A, mut visit: impl FnMut(&Arriving<'_>)) {
        self.hierarchy.visit(place, |level, number, light, distance, weight| {
            let wi = (light.position - place).normalize_or(Vec3A::Y);
            let illuminance = light.intensity * (weight * self.hierarchy.falloff(level, distance));
            // At a lamp itself its illuminance has no value.
            if 0.0 < distance {
                visit(&Arriving { level, number, light, wi, illuminance });
            }
        });
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::print_stdout, reason = "figures that are reported")]

    use super::*;
    use crate::geom::world::luminance;
    use crate::sample::{Sequence, sequence};
    use crate::scene::model::{LightKind, LightMode, Rgb};
    use glam::Vec3;

    /// Lamps under a ceiling and some low ones, on a floor: the sum of all, and how far that of the hierarchy is off, by alpha.
    #[test]
    fn floors_under_lamps_are_as_bright() {
        let lamp = |k: u32| {
            let [a, b, c, d] = Sequence::new(sequence::key(4, 4, u64::from(k)), 0).next4();
            let height = if k.is_multiple_of(3) { 0.5 + 2.0 * c } else { 6.0 + 0.5 * c };
            let position = Vec3::new(60.0 * a - 30.0, height, 30.0 * b - 15.0);
            let kind = LightKind::Point { position, intensity: Vec3::splat(0.5 + d), range: None };
            Punctual::new(kind, LightMode::Baked, Vec3::ZERO).expect("a lamp")
        };
        let lamps: Vec<Punctual> = (0..600).map(lamp).collect();
        let facing = |wi: Vec3A, light: Rgb| f64::from(luminance(light) * wi.y);
        let error = |(alpha, blend): (f32, Blend)| {
            let grid = LampGrid::blended(&lamps, alpha, blend).expect("lamps");
            let (mut mean, mut off, mut asked) = (0.0, 0.0, 0);
            for k in 0..200u32 {
                let [a, b, ..] = Sequence::new(41, k).next4();
                let place = Vec3A::new(60.0 * a - 30.0, 0.0, 30.0 * b - 15.0);
                let each = lamps.iter().filter_map(|l| l.incident(place));
                let want: f64 = each.map(|i| facing(i.wi, i.illuminance)).sum();
                let mut got = 0.0;
                grid.visit(place, |a| {
                    got += facing(a.wi, a.illuminance);
                    asked += 1;
                });
                mean += (got / want - 1.0) / 200.0;
                off += (got / want - 1.0).abs() / 200.0;
            }
            println!(
                "{blend:?}, alpha {alpha}: mean {:+.2} %, {:.2} % off, {} lights",
                100.0 * mean,
                100.0 * off,
                asked / 200
            );
            off
        };
        for blend in [Blend::Published, Blend::Conserving] {
            let curve = [1.0, 2.0, 4.0, 8.0].map(|alpha| error((alpha, blend)));
            assert!(curve.windows(2).all(|w| w[1] < 0.7 * w[0]) && curve[2] < 0.005, "{curve:?}");
        }
    }
}
