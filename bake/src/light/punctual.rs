//! Point, spot and directional lights: `KHR_lights_punctual`.

use crate::sample::warp::{Frame, square_to_cone};
use crate::scene::model::{LightKind, LightMode, Rgb};
use glam::{Vec3, Vec3A};

/// A point or spot light.
#[derive(Clone, Copy, Debug)]
pub struct Punctual {
    position: Vec3A,
    /// Candela on the axis.
    intensity: Rgb,
    range: Option<f32>,
    /// Axis, and the scale and offset of the extension's angular attenuation.
    cone: Option<(Vec3A, f32, f32)>,
    /// Direct light is left to the game.
    pub indirect_only: bool,
}

/// Light arriving at a point from one direction.
#[derive(Clone, Copy, Debug)]
pub struct Incident {
    /// Unit direction towards the light.
    pub wi: Vec3A,
    /// How far the light is, metres.
    pub distance: f32,
    /// Illuminance on a surface that faces the light, lux.
    pub illuminance: Rgb,
}

impl Punctual {
    /// From a point or spot light; `None` for a directional one.
    #[must_use]
    pub fn new(kind: LightKind, mode: LightMode, origin: Vec3) -> Option<Self> {
        let indirect_only = mode == LightMode::Mixed;
        let at = |p: Vec3| Vec3A::from(p - origin);
        match kind {
            LightKind::Point { position, intensity, range } => {
                Some(Self { position: at(position), intensity, range, cone: None, indirect_only })
            }
            LightKind::Spot { position, direction, intensity, range, inner_cone, outer_cone } => {
                let scale = 1.0 / (inner_cone.cos() - outer_cone.cos()).max(0.001);
                let offset = -outer_cone.cos() * scale;
                let cone = Some((Vec3A::from(direction), scale, offset));
                Some(Self { position: at(position), intensity, range, cone, indirect_only })
            }
            LightKind::Directional { .. } => None,
        }
    }

    /// Whether it shines evenly everywhere, and its direct light is baked: what a lighting grid hierarchy may hold.
    #[must_use]
    pub fn suits_grid(&self) -> bool {
        self.cone.is_none() && self.range.is_none() && !self.indirect_only
    }

    /// Where it is, metres relative to the world's origin.
    #[must_use]
    pub fn position(&self) -> Vec3A {
        self.position
    }

    /// Greatest intensity, candela.
    #[must_use]
    pub fn intensity(&self) -> Rgb {
        self.intensity
    }

    /// Axis of the cone and 1 - cos of its outer half angle; `None` where it shines everywhere.
    #[must_use]
    pub fn cone(&self) -> Option<(Vec3A, f32)> {
        self.cone.map(|(axis, s, o)| (axis, 1.0 + o / s))
    }

    /// Whether a place lies within the cone.
    #[must_use]
    pub fn shines_on(&self, p: Vec3A) -> bool {
        self.cone.is_none_or(|_| 0.0 < self.attenuation((self.position - p).normalize_or_zero()))
    }

    /// Mean over all directions, candela.
    #[must_use]
    pub fn mean_intensity(&self) -> Rgb {
        // The attenuation is 1 up to the inner cosine and falls from there with the square of the distance to the outer one, `1 / s` further.
        let part = self.cone.map_or(1.0, |(_, s, o)| 0.5 * (1.0 - (1.0 - o) / s + 1.0 / (3.0 * s)));
        self.intensity * part
    }

    /// Intensity towards a place, candela.
    #[must_use]
    pub fn intensity_towards(&self, p: Vec3A) -> Rgb {
        self.intensity * self.attenuation((self.position - p).normalize_or_zero())
    }

    /// What the cone leaves of the intensity towards a place from which the light lies in the direction `wi`.
    fn attenuation(&self, wi: Vec3A) -> f32 {
        self.cone.map_or(1.0, |(axis, s, o)| {
            let a = (-wi.dot(axis) * s + o).clamp(0.0, 1.0);
            a * a
        })
    }

    /// Where a ray is inside the light's cone, between `from` and `to`; a little more rather than less. `None` where it never is.
    #[must_use]
    pub fn lit_part(&self, origin: Vec3A, direction: Vec3A, from: f32, to: f32) -> Option<(f32, f32)> {
        let Some((axis, s, o)) = self.cone else { return Some((from, to)) };
        let cos = (-o / s).clamp(0.0, 1.0);
        let w = origin - self.position;
        // (v.axis)^2 = cos^2 v.v for v = w + t direction.
        let (da, wa, c2) = (direction.dot(axis), w.dot(axis), cos * cos);
        let (a, b, c) = (da * da - c2, da * wa - c2 * direction.dot(w), wa * wa - c2 * w.dot(w));
        let discriminant = b * b - a * c;
        if discriminant < 0.0 && a < 0.0 {
            // Passes beside both halves of the cone.
            return None;
        }
        let root = discriminant.max(0.0).sqrt();
        let q = if b < 0.0 { root - b } else { -root - b };
        let (t0, t1) = (q / a, c / q);
        let mut ends = [from, t0.min(t1), t0.max(t1), to];
        for t in &mut ends[1..3] {
            *t = if t.is_finite() { t.clamp(from, to) } else { from };
        }
        let inside = |t: f32| {
            let v = w + direction * t;
            0.0 <= v.dot(axis) && c2 * v.length_squared() <= v.dot(axis) * v.dot(axis)
        };
        let mut part: Option<(f32, f32)> = None;
        for e in ends.windows(2).filter(|e| e[0] < e[1]) {
            let middle =
                if e[1].is_finite() { 0.5 * (e[0] + e[1]) } else { 2.0 * e[0].abs() + 1e3 * w.length() };
            if inside(middle) {
                part = Some((part.map_or(e[0], |p| p.0), e[1]));
            }
        }
        part
    }

    /// What arrives at `p` where nothing is in between; `None` outside the cone and the range, and at
    /// the light itself, where the illuminance has no value. So near to it that no number holds the illuminance it is
    /// infinite, for the gate to count.
    #[must_use]
    pub fn incident(&self, p: Vec3A) -> Option<Incident> {
        let d = self.position - p;
        let distance = d.length();
        let wi = d / distance;
        if !wi.is_finite() {
            return None;
        }
        let mut scale = 1.0 / (distance * distance);
        if let Some(range) = self.range {
            // The window that the extension recommends.
            let q = distance / range;
            scale *= (1.0 - q * q * q * q).clamp(0.0, 1.0);
        }
        scale *= self.attenuation(wi);
        let illuminance = self.intensity * scale;
        if illuminance == Vec3::ZERO || illuminance.is_nan() {
            return None;
        }
        Some(Incident { wi, distance, illuminance })
    }
}

/// A directional light, which may have the size of a disc on the sky.
#[derive(Clone, Copy, Debug)]
pub struct Sun {
    frame: Frame,
    /// Lux on a surface that faces it.
    illuminance: Rgb,
    /// `1 - cos` of the disc's half angle.
    one_minus_cos: f32,
    /// Direct light is left to the game.
    pub indirect_only: bool,
}

impl Sun {
    /// `direction` is what the light travels along, `angular_diameter` in radians.
    #[must_use]
    pub fn new(direction: Vec3, illuminance: Rgb, angular_diameter: f32, mode: LightMode) -> Self {
        let s = (0.25 * angular_diameter).sin();
        Self {
            frame: Frame::new(-Vec3A::from(direction)),
            illuminance,
            one_minus_cos: 2.0 * s * s,
            indirect_only: mode == LightMode::Mixed,
        }
    }

    /// Frame whose third axis points to the middle of the disc.
    #[must_use]
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Light from one point of the disc, chosen uniformly by solid angle.
    #[must_use]
    pub fn sample(&self, u: [f32; 2]) -> Incident {
        let wi = if self.one_minus_cos == 0.0 {
            self.frame.z
        } else {
            self.frame.to_world(square_to_cone(u, self.one_minus_cos))
        };
        Incident { wi, distance: f32::INFINITY, illuminance: self.illuminance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_square_window_and_cone() {
        let point = |range| {
            Punctual::new(
                LightKind::Point { position: Vec3::Y * 2.0, intensity: Vec3::splat(8.0), range },
                LightMode::Baked,
                Vec3::ZERO,
            )
            .expect("a point light")
        };
        let e = point(None).incident(Vec3A::ZERO).expect("lit");
        assert_eq!((e.illuminance.x, e.distance, e.wi), (2.0, 2.0, Vec3A::Y));
        let windowed = point(Some(4.0)).incident(Vec3A::ZERO).expect("lit");
        assert_eq!(windowed.illuminance.x, 2.0 * (1.0 - 1.0 / 16.0));
        assert!(point(Some(2.0)).incident(Vec3A::ZERO).is_none());
        assert!(point(None).incident(Vec3A::Y * 2.0).is_none(), "on the light itself");

        let spot = |inner: f32, outer: f32| {
            let kind = LightKind::Spot {
                position: Vec3::Y,
                direction: Vec3::NEG_Y,
                intensity: Vec3::ONE,
                range: None,
                inner_cone: inner,
                outer_cone: outer,
            };
            Punctual::new(kind, LightMode::Baked, Vec3::ZERO).expect("a spot light")
        };
        assert_eq!(spot(0.2, 0.6).incident(Vec3A::ZERO).expect("lit").illuminance.x, 1.0);
        assert!(spot(0.2, 0.6).incident(Vec3A::X).is_none());
        let s = spot(0.0, std::f32::consts::FRAC_PI_4).incident(Vec3A::new(0.4, 0.0, 0.0)).expect("lit");
        let cos = 1.0 / (1.0f32 + 0.16).sqrt();
        let a = (cos - 0.5f32.sqrt()) / (1.0 - 0.5f32.sqrt());
        assert!((s.illuminance.x - a * a / 1.16).abs() < 1e-5);
        assert!(spot(0.5, 0.5).incident(Vec3A::ZERO).is_some_and(|e| e.illuminance.is_finite()));
    }

    /// Mean over the sphere by midpoints over the cosine, and who is in the cone.
    #[test]
    fn cones_have_their_mean() {
        for (inner, outer) in [(0.0f32, 0.4f32), (0.3, 0.9), (1.0, 1.5)] {
            let kind = LightKind::Spot {
                position: Vec3::ZERO,
                direction: Vec3::Z,
                intensity: Vec3::splat(3.0),
                range: None,
                inner_cone: inner,
                outer_cone: outer,
            };
            let spot = Punctual::new(kind, LightMode::Baked, Vec3::ZERO).expect("a spot light");
            let n = 20_000;
            let towards = |i: i32| {
                let z = 2.0 * (i as f32 + 0.5) / n as f32 - 1.0;
                spot.intensity_towards(Vec3A::new((1.0 - z * z).sqrt(), 0.0, z)).x
            };
            let mean = (0..n).map(|i| f64::from(towards(i))).sum::<f64>() / f64::from(n);
            assert!(
                (f64::from(spot.mean_intensity().x) / mean - 1.0).abs() < 1e-3,
                "{inner} {outer}: {mean}"
            );
            let (axis, one_minus_cos) = spot.cone().expect("a cone");
            assert!(axis == Vec3A::Z && (1.0 - one_minus_cos - outer.cos()).abs() < 1e-5);
            let at = |angle: f32| Vec3A::new(angle.sin(), 0.0, angle.cos());
            assert!(spot.shines_on(at(0.99 * outer)) && !spot.shines_on(at(1.01 * outer)));
        }
    }

    /// Whatever is lit lies within the part, and the part is no longer than what is lit.
    #[test]
    fn rays_are_cut_to_the_cone() {
        for outer in [0.05f32, 0.4, 1.2, 1.55] {
            let kind = LightKind::Spot {
                position: Vec3::new(0.3, 1.0, -0.2),
                direction: Vec3::new(0.36, -0.48, 0.8),
                intensity: Vec3::ONE,
                range: None,
                inner_cone: 0.5 * outer,
                outer_cone: outer,
            };
            let spot = Punctual::new(kind, LightMode::Baked, Vec3::ZERO).expect("a spot light");
            let mut met = 0;
            for i in 0..2000u32 {
                let u = |d| sobol_burley::sample(i, d, 9) - 0.5;
                let origin = Vec3A::new(6.0 * u(0), 6.0 * u(1), 6.0 * u(2));
                let direction = Vec3A::new(u(3), u(4), u(5)).normalize();
                let part = spot.lit_part(origin, direction, 0.5, 7.0);
                met += u32::from(part.is_some());
                for k in 0..50u16 {
                    let t = 0.5 + 6.5 * (f32::from(k) + 0.5) / 50.0;
                    let lit = spot.incident(origin + direction * t).is_some();
                    let inside = part.is_some_and(|p| p.0 <= t && t <= p.1);
                    let near = part.is_some_and(|p| (p.0 - t).abs().min((p.1 - t).abs()) < 2e-2);
                    assert!(lit == inside || near, "{outer}: {t} {part:?} of {origin} {direction}");
                }
                if let Some((from, _)) = spot.lit_part(origin, direction, 0.5, f32::INFINITY) {
                    assert!(part.is_none_or(|p| p.0 == from), "{from} {part:?}");
                }
            }
            assert!(5 < met, "{outer}: {met}");
        }
    }

    #[test]
    fn a_sun_stays_on_its_disc() {
        let diameter = 0.00925f32;
        let sun = Sun::new(Vec3::new(0.0, -1.0, 0.0), Vec3::ONE, diameter, LightMode::Baked);
        let mut widest = 0.0f32;
        for i in 0..1000u16 {
            let u = [f32::from(i % 40) / 40.0, f32::from(i / 40) / 25.0];
            let wi = sun.sample(u).wi;
            widest = widest.max(wi.cross(Vec3A::Y).length());
        }
        assert!(widest <= diameter / 2.0 * 1.001 && diameter / 2.0 * 0.95 < widest, "{widest}");
    }
}
