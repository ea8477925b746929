//! Procedural densities: fractal OpenSimplex 2 noise, of which the upper part remains.
//!
//! A density depends on the place in world space alone, so media that touch continue each other. The noise is arithmetic of
//! `f32` and `f64` without library functions, the same on every machine.

use super::{Unusable, Voxels};
use fastnoise_lite::{FastNoiseLite, FractalType, NoiseType};
use glam::{Affine3A, DAffine3, DVec3, UVec3};
use rayon::prelude::*;

/// Places at which the distribution of a noise is measured.
const PLACES: u32 = 1 << 16;
/// Side of the cube they fill, features.
const REACH: f64 = 4096.0;

/// Most that the finest features are finer than the largest.
const FINEST: f64 = 65_536.0;
/// Furthest from the origin, in the finest features: further ones are not told apart.
const FURTHEST: f64 = 1e9;

/// What a noise is like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Size of the largest features, metres, above 0.
    pub scale: f32,
    /// How many sizes of features there are, 1 to 16.
    pub octaves: u32,
    /// Strength of each size against the one before it, 0 to 1.
    pub gain: f32,
    /// Size of the features before against each, 1 to 8; with all octaves at most 65536.
    pub lacunarity: f32,
    /// Chooses among noises that are alike.
    pub seed: u32,
    /// The part of space that holds any density, above 0 and up to 1.
    pub coverage: f32,
    /// Voxels along the longest side of a box, 1 to 4096.
    pub resolution: u32,
}

/// A noise that has been measured.
pub struct Field {
    generator: FastNoiseLite,
    scale: f64,
    /// What becomes 0, and what becomes 1.
    range: [f32; 2],
    mean: f32,
}

impl Noise {
    /// Clouds of 1 m with a quarter of detail, over half of space.
    #[must_use]
    pub const fn cloud() -> Self {
        Self { scale: 1.0, octaves: 4, gain: 0.5, lacunarity: 2.0, seed: 0, coverage: 0.5, resolution: 128 }
    }

    /// Measures the noise, so that it covers what it has to and its greatest density is 1.
    ///
    /// # Errors
    /// Where a number is out of its range.
    pub fn field(&self) -> Result<Field, Unusable> {
        let check = |name: &str, value: f32, good: bool, range: &str| {
            let wrong = || Unusable::new(format!("`{name}` is {value}"), format!("write {range}"));
            if good { Ok(()) } else { Err(wrong()) }
        };
        let within = |v: f32, low: f32, high: f32| low <= v && v <= high;
        check("scale", self.scale, 0.0 < self.scale && self.scale.is_finite(), "metres above 0")?;
        check("octaves", self.octaves as f32, (1..=16).contains(&self.octaves), "a number from 1 to 16")?;
        check("gain", self.gain, within(self.gain, 0.0, 1.0), "a number from 0 to 1")?;
        check("lacunarity", self.lacunarity, within(self.lacunarity, 1.0, 8.0), "a number from 1 to 8")?;
        let covers = 0.0 < self.coverage && self.coverage <= 1.0;
        check("coverage", self.coverage, covers, "a number above 0 and up to 1")?;
        let resolution = (1..=4096).contains(&self.resolution);
        check("resolution", self.resolution as f32, resolution, "a number from 1 to 4096")?;
        if FINEST < self.fineness() {
            return Err(Unusable::new(
                format!(
                    "the finest features are {} times finer than the largest; at most {FINEST}",
                    self.fineness()
                ),
                "lower `octaves` or `lacunarity`",
            ));
        }
        Ok(Field::new(self))
    }

    /// How much finer the finest features are than the largest.
    fn fineness(&self) -> f64 {
        (1..self.octaves).fold(1.0, |f, _| f * f64::from(self.lacunarity))
    }

    /// The noise in a box that `world_from_unit` makes of the cube from 0 to 1, evaluated at the centres of voxels that are
    /// nearly cubes.
    ///
    /// # Errors
    /// As [`Self::field`] and [`Voxels::from_fn`].
    pub fn voxels(&self, world_from_unit: Affine3A, most_bytes: usize) -> Result<Voxels, Unusable> {
        let field = self.field()?;
        let world_from_unit = world_from_unit.as_daffine3();
        let m = world_from_unit.matrix3;
        let sides = DVec3::new(m.x_axis.length(), m.y_axis.length(), m.z_axis.length());
        let longest = sides.max_element();
        if !(world_from_unit.is_finite() && 0.0 < longest) {
            return Err(Unusable::new("the box of the noise has no size", "give the box a volume"));
        }
        let furthest = world_from_unit.translation.length() + sides.element_sum();
        let places = furthest / f64::from(self.scale) * self.fineness();
        if FURTHEST < places {
            return Err(Unusable::new(
                format!(
                    "the box reaches {furthest} m from the origin, {places:e} of the noise's finest features"
                ),
                "move the box to the origin, or raise `scale`",
            ));
        }
        let size = (sides / longest * f64::from(self.resolution)).ceil().as_uvec3().max(UVec3::ONE);
        let world_from_voxel = world_from_unit * DAffine3::from_scale(size.as_dvec3().recip());
        Voxels::from_fn(size, most_bytes, |v| field.at(world_from_voxel.transform_point3(v.as_dvec3() + 0.5)))
    }
}

impl Field {
    fn new(noise: &Noise) -> Self {
        let mut generator = FastNoiseLite::with_seed(noise.seed.cast_signed());
        generator.set_noise_type(Some(NoiseType::OpenSimplex2));
        generator.set_frequency(Some(1.0));
        generator.set_fractal_type(Some(FractalType::FBm));
        generator.set_fractal_octaves(Some(noise.octaves.cast_signed()));
        generator.set_fractal_gain(Some(noise.gain));
        generator.set_fractal_lacunarity(Some(noise.lacunarity));
        let mut field = Self { generator, scale: f64::from(noise.scale), range: [0.0, 1.0], mean: 0.0 };
        let mut found: Vec<f32> = (0..PLACES).into_par_iter().map(|i| field.noise(place(i))).collect();
        found.sort_by(f32::total_cmp);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most the number of places"
        )]
        let clear = (f64::from(PLACES) * (1.0 - f64::from(noise.coverage))) as usize;
        let last = found.len() - 1;
        field.range = [found[clear.min(last - 1)], found[last]];
        let sum: f64 = found.iter().map(|n| f64::from(field.density(*n))).sum();
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
        let mean = (sum / f64::from(PLACES)) as f32;
        field.mean = mean;
        field
    }

    /// Density at a place in world space, metres: 0 to 1.
    #[must_use]
    pub fn at(&self, place: DVec3) -> f32 {
        self.density(self.noise(place / self.scale))
    }

    /// Mean density over all space, to about 1 %.
    #[must_use]
    pub const fn mean(&self) -> f32 {
        self.mean
    }

    fn noise(&self, place: DVec3) -> f32 {
        self.generator.get_noise_3d(place.x, place.y, place.z)
    }

    fn density(&self, noise: f32) -> f32 {
        let [low, high] = self.range;
        if low < high {
            ((noise - low) / (high - low)).clamp(0.0, 1.0)
        } else {
            f32::from(u8::from(low < noise))
        }
    }
}

/// A place for measuring: an additive recurrence with powers of the root of x^4 = x + 1, which fills a cube evenly.
fn place(i: u32) -> DVec3 {
    const ROOT: f64 = 1.220_744_084_605_759_5;
    let step = DVec3::new(1.0 / ROOT, 1.0 / (ROOT * ROOT), 1.0 / (ROOT * ROOT * ROOT));
    ((step * f64::from(i)).fract() - 0.5) * REACH
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Vec3, vec3};

    const ENOUGH: usize = 1 << 30;

    fn share(grid: &Voxels, held: impl Fn(f32) -> f64) -> f64 {
        let size = grid.size();
        let n = size.element_product();
        let at =
            |i: u32| grid.at(UVec3::new(i % size.x, i / size.x % size.y, i / size.x / size.y).as_vec3a());
        (0..n).map(|i| held(at(i))).sum::<f64>() / f64::from(n)
    }

    #[test]
    fn noise_covers_what_it_is_asked_to() {
        for coverage in [0.05, 0.5, 0.9, 1.0] {
            for octaves in [1, 5] {
                let noise = Noise { coverage, octaves, scale: 0.7, resolution: 64, ..Noise::cloud() };
                let box_of = Affine3A::from_scale_rotation_translation(
                    Vec3::splat(60.0),
                    glam::Quat::from_rotation_x(0.3),
                    vec3(3.0, -20.0, 1e4),
                );
                let grid = noise.voxels(box_of, ENOUGH).expect("a grid");
                let covered = share(&grid, |d| f64::from(u8::from(0.0 < d)));
                assert!((covered - f64::from(coverage)).abs() < 0.01, "{coverage}: {covered}");
                let mean = share(&grid, f64::from);
                let said = f64::from(noise.field().expect("a field").mean());
                assert!((mean / said - 1.0).abs() < 0.03, "{coverage} {octaves}: {mean} {said}");
                assert!(0.7 < grid.most() && grid.most() <= 1.0, "{}", grid.most());
            }
        }
    }

    /// A density is of a place, not of a box; lengths by 2^k change nothing.
    #[test]
    fn boxes_that_touch_continue_each_other() {
        let noise = Noise { resolution: 16, ..Noise::cloud() };
        let at = |x: f32, side: f32| {
            Affine3A::from_translation(vec3(x, 1.0, 2.0)) * Affine3A::from_scale(vec3(side, 4.0, 4.0))
        };
        let (left, right) = (noise.voxels(at(0.0, 4.0), ENOUGH), noise.voxels(at(4.0, 4.0), ENOUGH));
        let (left, right) = (left.expect("a grid"), right.expect("a grid"));
        let wide = Noise { resolution: 32, ..noise }.voxels(at(0.0, 8.0), ENOUGH).expect("a grid");
        assert_eq!(wide.size(), UVec3::new(32, 16, 16));
        for i in 0..32 * 16 * 16 {
            let v = UVec3::new(i % 32, i / 32 % 16, i / 32 / 16);
            let (half, x) = if v.x < 16 { (&left, v.x) } else { (&right, v.x - 16) };
            assert_eq!(wide.at(v.as_vec3a()), half.at(v.with_x(x).as_vec3a()));
        }
        let k = 1024.0;
        let scaled = Noise { scale: noise.scale * k, ..noise };
        assert_eq!(
            scaled.voxels(Affine3A::from_scale(Vec3::splat(k)) * at(4.0, 4.0), ENOUGH),
            Ok(right.clone())
        );
        assert_ne!(Noise { seed: 1, ..noise }.voxels(at(4.0, 4.0), ENOUGH), Ok(right));
    }

    /// The same on every machine and with every version, or it is said.
    #[test]
    fn densities_are_stable() {
        let field = Noise { coverage: 1.0, ..Noise::cloud() }.field().expect("a field");
        let got = [0.0, 1.3, -77.7, 1e6].map(|x| field.at(DVec3::new(x, 0.5 * x, 0.25)).to_bits());
        assert_eq!(got, [1058843720, 1062093444, 1055478706, 1056612520]);
    }

    #[test]
    fn numbers_out_of_range_are_named() {
        let good = Noise::cloud();
        let cases = [
            ("scale", Noise { scale: 0.0, ..good }),
            ("scale", Noise { scale: f32::INFINITY, ..good }),
            ("octaves", Noise { octaves: 0, ..good }),
            ("gain", Noise { gain: f32::NAN, ..good }),
            ("lacunarity", Noise { lacunarity: 0.5, ..good }),
            ("coverage", Noise { coverage: 0.0, ..good }),
            ("resolution", Noise { resolution: 5000, ..good }),
        ];
        for (name, noise) in cases {
            let error = noise.voxels(Affine3A::IDENTITY, ENOUGH).expect_err("refused").what;
            assert!(error.starts_with(&format!("`{name}` is ")), "{error}");
        }
        assert!(good.voxels(Affine3A::from_scale(Vec3::ZERO), ENOUGH).is_err());
        let fine = Noise { octaves: 7, lacunarity: 8.0, ..good };
        assert!(fine.field().err().expect("refused").what.contains("262144 times finer"));
        let fine = Noise { octaves: 16, scale: 1e-3, ..good };
        let far = fine.voxels(Affine3A::from_translation(vec3(0.0, 1e3, 0.0)), ENOUGH);
        assert!(far.expect_err("refused").what.contains("m from the origin"));
        let near =
            Noise { resolution: 20, ..fine }.voxels(Affine3A::from_scale(vec3(10.0, 1.0, 0.0)), ENOUGH);
        assert_eq!(near.expect("a grid").size(), UVec3::new(20, 2, 1));
    }
}
