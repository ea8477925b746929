//! The sky as a light.

use crate::geom::world::luminance;
use crate::sample::discrete::{Cdf, ONE_MINUS_EPSILON};
use crate::scene::model::{Rgb, Sky};
use glam::{Quat, Vec3, Vec3A};
use std::f32::consts::PI;

/// A sky with what is needed to sample it.
#[derive(Clone, Debug)]
pub struct SkyLight {
    sky: Sky,
    image: Option<ImageSampler>,
}

/// Chooses pixels by luminance and solid angle.
#[derive(Clone, Debug)]
struct ImageSampler {
    rows: Cdf,
    columns: Vec<Option<Cdf>>,
    from_sky: Quat,
}

/// A direction towards the sky.
#[derive(Clone, Copy, Debug)]
pub struct SkySample {
    /// Unit direction.
    pub wi: Vec3A,
    /// Radiance from there, nits.
    pub radiance: Rgb,
    /// Density per steradian.
    pub pdf_solid_angle: f32,
}

impl SkyLight {
    /// Prepares a sky for sampling. Only images are sampled by themselves: what a uniform or a
    /// gradient sky sends is found as well by the directions that a diffuse surface samples.
    #[must_use]
    pub fn new(sky: &Sky) -> Self {
        let image = match sky {
            Sky::Image { width, height, pixels, rotation, .. } => {
                let weight = |x: usize, y: usize| {
                    f64::from(luminance(pixels[y * width + x])) * row_solid_angle(y, *height)
                };
                let row_sum = |y| (0..*width).map(|x| weight(x, y).max(0.0)).sum::<f64>();
                Cdf::new((0..*height).map(row_sum)).map(|rows| ImageSampler {
                    rows,
                    columns: (0..*height).map(|y| Cdf::new((0..*width).map(|x| weight(x, y)))).collect(),
                    from_sky: *rotation,
                })
            }
            _ => None,
        };
        Self { sky: sky.clone(), image }
    }

    /// Whether no light comes from the sky.
    #[must_use]
    pub fn is_black(&self) -> bool {
        match &self.sky {
            Sky::Black => true,
            Sky::Uniform(l) => *l == Vec3::ZERO,
            Sky::Gradient { zenith, horizon, ground } => *zenith + *horizon + *ground == Vec3::ZERO,
            Sky::Image { .. } => self.image.is_none(),
        }
    }

    /// Whether [`SkyLight::sample`] gives anything.
    #[must_use]
    pub fn is_sampled(&self) -> bool {
        self.image.is_some()
    }

    /// Radiance from direction `wi` (towards the sky), nits.
    #[must_use]
    pub fn radiance(&self, wi: Vec3A) -> Rgb {
        match &self.sky {
            Sky::Black => Vec3::ZERO,
            Sky::Uniform(l) => *l,
            Sky::Gradient { zenith, horizon, ground } => {
                let end = if 0.0 <= wi.y { zenith } else { ground };
                *horizon + (*end - *horizon) * wi.y.abs().min(1.0)
            }
            Sky::Image { width, pixels, scale, .. } => {
                let (x, y) = self.pixel(wi);
                pixels[y * width + x] * *scale
            }
        }
    }

    /// A direction chosen by the image's luminance; `None` without an image.
    #[must_use]
    pub fn sample(&self, u: [f32; 2]) -> Option<SkySample> {
        let (Some(s), Sky::Image { width, height, pixels, scale, .. }) = (&self.image, &self.sky) else {
            return None;
        };
        let (y, v) = s.rows.sample(u[1]);
        let columns = s.columns[y].as_ref()?;
        let (x, w) = columns.sample(u[0]);
        // Uniform by solid angle within the pixel: heights are uniform on a sphere.
        let (top, bottom) = row_heights(y, *height);
        let height_y = top + (bottom - top) * v;
        let r = (1.0 - height_y * height_y).max(0.0).sqrt();
        let phi = ((x as f32 + w) / *width as f32 - 0.5) * 2.0 * PI;
        let (sin, cos) = phi.sin_cos();
        let wi = s.from_sky * Vec3::new(r * sin, height_y, -r * cos);
        let pdf_solid_angle = s.rows.pdf(y) * columns.pdf(x) / pixel_solid_angle(y, *width, *height);
        Some(SkySample { wi: wi.into(), radiance: pixels[y * width + x] * *scale, pdf_solid_angle })
    }

    /// Density per steradian with which [`SkyLight::sample`] chooses `wi`.
    #[must_use]
    pub fn pdf(&self, wi: Vec3A) -> f32 {
        let (Some(s), Sky::Image { width, height, .. }) = (&self.image, &self.sky) else { return 0.0 };
        let (x, y) = self.pixel(wi);
        let columns = s.columns[y].as_ref().map_or(0.0, |c| c.pdf(x));
        s.rows.pdf(y) * columns / pixel_solid_angle(y, *width, *height)
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the image")]
    fn pixel(&self, wi: Vec3A) -> (usize, usize) {
        let Sky::Image { width, height, rotation, .. } = &self.sky else { return (0, 0) };
        let d = rotation.inverse() * Vec3::from(wi);
        let u = (0.5 + d.x.atan2(-d.z) / (2.0 * PI)).clamp(0.0, ONE_MINUS_EPSILON);
        let v = (d.y.clamp(-1.0, 1.0).acos() / PI).clamp(0.0, ONE_MINUS_EPSILON);
        ((u * *width as f32) as usize, (v * *height as f32) as usize)
    }
}

/// Sine of elevation at the upper and the lower edge of a row.
fn row_heights(y: usize, height: usize) -> (f32, f32) {
    let at = |y: usize| (PI * y as f32 / height as f32).cos();
    (at(y), at(y + 1))
}

fn row_solid_angle(y: usize, height: usize) -> f64 {
    let (top, bottom) = row_heights(y, height);
    f64::from(top - bottom)
}

fn pixel_solid_angle(y: usize, width: usize, height: usize) -> f32 {
    let (top, bottom) = row_heights(y, height);
    (top - bottom) * 2.0 * PI / width as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image() -> SkyLight {
        let (width, height) = (16, 8);
        let mut pixels = vec![Vec3::splat(0.2); width * height];
        pixels[2 * width + 5] = Vec3::splat(500.0);
        pixels[6 * width] = Vec3::ZERO;
        let rotation = Quat::from_rotation_y(1.0);
        SkyLight::new(&Sky::Image { width, height, pixels, rotation, scale: 2.0 })
    }

    #[test]
    fn pixel_directions_follow_the_convention() {
        let (width, height) = (4, 2);
        let mut pixels = vec![Vec3::ZERO; 8];
        pixels[2] = Vec3::ONE; // upper half, from the middle to a quarter right: between -Z and +X
        let s = SkyLight::new(&Sky::Image { width, height, pixels, rotation: Quat::IDENTITY, scale: 1.0 });
        assert_eq!(s.radiance(Vec3A::new(0.5, 0.5, -0.5).normalize()), Vec3::ONE);
        assert_eq!(s.radiance(Vec3A::new(-0.5, 0.5, -0.5).normalize()), Vec3::ZERO);
        assert_eq!(s.radiance(Vec3A::new(0.5, -0.5, -0.5).normalize()), Vec3::ZERO);
    }

    /// The density is the one that samples have, and 1/pdf integrates to the sphere's 4 pi; radiance
    /// over density integrates to the image's total.
    #[test]
    fn density_and_samples_agree() {
        let s = image();
        let n = 128u16;
        let (mut sphere, mut total) = (0.0f64, 0.0f64);
        for i in 0..n {
            for j in 0..n {
                let u = [(f32::from(i) + 0.5) / f32::from(n), (f32::from(j) + 0.5) / f32::from(n)];
                let x = s.sample(u).expect("an image");
                assert!((s.pdf(x.wi) / x.pdf_solid_angle - 1.0).abs() < 1e-3, "{x:?}");
                assert_eq!(s.radiance(x.wi), x.radiance);
                sphere += 1.0 / f64::from(x.pdf_solid_angle);
                total += f64::from(x.radiance.x / x.pdf_solid_angle);
            }
        }
        let n2 = f64::from(n) * f64::from(n);
        let mut want = 0.0;
        for y in 0..8 {
            for x in 0..16 {
                let l = if (x, y) == (5, 2) {
                    1000.0
                } else if (x, y) == (0, 6) {
                    0.0
                } else {
                    0.4
                };
                want += l * f64::from(pixel_solid_angle(y, 16, 8));
            }
        }
        assert!((total / n2 / want - 1.0).abs() < 1e-3, "{} {want}", total / n2);
        let black = f64::from(pixel_solid_angle(6, 16, 8));
        let all = 4.0 * f64::from(PI) - black;
        assert!((sphere / n2 / all - 1.0).abs() < 0.1, "{} {all}", sphere / n2);
    }

    #[test]
    fn gradient_meets_its_ends() {
        let s = SkyLight::new(&Sky::Gradient { zenith: Vec3::X, horizon: Vec3::Y, ground: Vec3::Z });
        assert_eq!(s.radiance(Vec3A::Y), Vec3::X);
        assert_eq!(s.radiance(Vec3A::X), Vec3::Y);
        assert_eq!(s.radiance(-Vec3A::Y), Vec3::Z);
    }
}
