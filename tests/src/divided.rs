//! A scene like that of table 1 in \[SLC20\]: virtual lights that one lamp over a divider leaves on the walls.
//!
//! The room is 2 x 2 x 2 m. The lamp hangs over the divider, so below it nearly all light comes from the few virtual lights
//! that the gaps at its sides let see. What is drawn is `E / pi` on all walls that a camera in one of them sees, with one estimate a
//! pixel. The paper gives neither sizes nor how virtual lights are kept from growing without bound next to a wall; here they grow
//! no more from `NEAREST` on.

use crate::gltf::{Glb, Material, Node};
use crate::shape::{ALL, Shape};
use bake::geom::{Ray, ray::offset_distance};
use bake::light::Direct;
use bake::light::tree::comparison::{Intensity, Representatives, Splitting};
use bake::light::tree::published::{Choose, Lightcuts, Rule, Until, cut};
use bake::light::tree::{Cut, Effort, FEW, FallOff, LightTree, MOST, Pick, Receiver, Shine, TreeLight};
use bake::plan::{MediaMode, Tracing};
use bake::sample::{Sequence, sequence};
use bake::scene::config::Config;
use bake::scene::document::Document;
use bake::scene::gltf::{LightUnits, LoadOptions, load};
use glam::Vec3A;
use std::f32::consts::PI;
use std::time::Instant;

/// Virtual lights.
pub const LIGHTS: usize = 10_000;

/// Distance within which a virtual light does not get brighter, metres.
const NEAREST: f32 = 1.0;

/// Light is reflected by so much.
const ALBEDO: f32 = 0.7;

/// Where the lamp is, metres.
const LAMP: Vec3A = Vec3A::new(0.0, 0.5, 0.0);

/// How far the divider reaches to each side, metres.
const DIVIDER: f32 = 0.4;

/// Ways to choose lights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// By intensity alone.
    Intensity,
    /// \[CK18\].
    Splitting,
    /// Lightcuts with one random light standing for a node.
    FixedRandom,
    /// The same with the brighter child's.
    FixedBright,
    /// Lightcuts with 32 lights standing for a node.
    Multidimensional,
    /// Stochastic lightcuts as published.
    Published,
    /// What bakes use.
    Ours,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Intensity,
        Self::Splitting,
        Self::FixedRandom,
        Self::FixedBright,
        Self::Multidimensional,
        Self::Published,
        Self::Ours,
    ];

    /// In a table.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Intensity => "intensity only",
            Self::Splitting => "adaptive tree splitting",
            Self::FixedRandom => "lightcuts, random",
            Self::FixedBright => "lightcuts, brightest",
            Self::Multidimensional => "lightcuts, 32 lights a node",
            Self::Published => "stochastic lightcuts",
            Self::Ours => "ours",
        }
    }
}

/// What a pixel shows.
struct Pixel {
    at: Receiver,
    above: bool,
}

/// The scene with its lights, trees and the truth.
pub struct Divided {
    tracing: Tracing,
    lights: Vec<TreeLight>,
    pixels: Vec<Pixel>,
    truth: Vec<f64>,
    intensity: Intensity,
    splitting: Splitting,
    published: Lightcuts,
    ours: LightTree,
}

/// Root mean square errors, as parts of the mean of the whole picture.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rmse {
    /// Of all pixels.
    pub all: f64,
    /// Of those over the divider.
    pub above: f64,
    /// Of those below.
    pub below: f64,
}

impl Divided {
    /// Makes the scene, with `size` x `size` pixels.
    ///
    /// # Panics
    /// If the scene cannot be loaded.
    #[must_use]
    pub fn new(size: u16) -> Self {
        let mut glb = Glb::new();
        let wall = glb.material(&Material::matte("wall", [ALBEDO; 3]));
        let mut room = Shape::default();
        room.cuboid([-1.0; 3], [1.0; 3], ALL);
        let room = room.inside_out();
        let mut divider = Shape::default();
        divider.cuboid([-DIVIDER, -0.01, -1.0], [DIVIDER, 0.01, 1.0], ALL);
        for (name, shape) in [("room", &room), ("divider", &divider)] {
            let mesh = glb.mesh(name, &[(shape, wall)]);
            glb.node(Node::new(name).mesh(mesh));
        }
        let document = Document::from_bytes("divided.glb", &glb.finish(), None).expect("a scene");
        let options = LoadOptions { light_units: LightUnits::Gltf, ..LoadOptions::default() };
        let (scene, _) = load(&document, &Config::default(), &options);
        let tracing = Tracing::new(&scene, MediaMode::Off, Direct::Auto).expect("a tree");
        let mut lights = vec![TreeLight { min: LAMP, max: LAMP, intensity: 1.0, shine: Shine::Everywhere }];
        let mut i = 0;
        while lights.len() < LIGHTS {
            let [a, b, ..] = Sequence::new(sequence::key(1, 2, 3), i).next4();
            i += 1;
            let (z, phi) = (1.0 - 2.0 * a, 2.0 * PI * b);
            let r = (1.0 - z * z).max(0.0).sqrt();
            let direction = Vec3A::new(r * phi.cos(), r * phi.sin(), z);
            let Some(hit) = closest(&tracing, LAMP, direction) else { continue };
            let at = hit.0;
            // Of the 4 pi lumens an equal part each, of which the albedo is reflected over pi.
            let intensity = 4.0 * ALBEDO / (LIGHTS as f32 - 1.0);
            lights.push(TreeLight { min: at, max: at, intensity, shine: Shine::Cosine { normal: hit.1 } });
        }
        let mut pixels = Vec::new();
        for y in 0..size {
            for x in 0..size {
                let at = |k: u16| (f32::from(k) + 0.5) / f32::from(size) * 2.0 - 1.0;
                let direction = Vec3A::new(at(x), -at(y), -1.0).normalize();
                let (position, normal) =
                    closest(&tracing, Vec3A::new(0.0, 0.0, 0.99), direction).unwrap_or((LAMP, Vec3A::Y));
                let at = Receiver { position, normal, below: 0.0 };
                pixels.push(Pixel { at, above: 0.0 < position.y });
            }
        }
        let n = lights.len();
        let mut all = Self {
            truth: Vec::new(),
            intensity: Intensity::new(&lights),
            splitting: Splitting::new(&lights),
            published: Lightcuts::new(&lights),
            ours: LightTree::new(&lights, &[n]),
            tracing,
            lights,
            pixels,
        };
        all.truth = all.brute_force();
        all
    }

    /// Mean of the picture above and below the divider.
    #[must_use]
    pub fn means(&self) -> [f64; 2] {
        [true, false].map(|above| {
            let part = || self.pixels.iter().zip(&self.truth).filter(|(p, _)| p.above == above);
            part().map(|(_, t)| t).sum::<f64>() / part().count() as f64
        })
    }

    /// The picture, from the top, row by row.
    #[must_use]
    pub fn truth(&self) -> &[f64] {
        &self.truth
    }

    fn brute_force(&self) -> Vec<f64> {
        let n = u32::try_from(self.lights.len()).expect("few lights");
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let part = self.pixels.len().div_ceil(threads);
        let one = |p: &Pixel| (0..n).map(|k| f64::from(self.brings(&p.at, k))).sum();
        std::thread::scope(|scope| {
            let tasks: Vec<_> = self
                .pixels
                .chunks(part)
                .map(|pixels| scope.spawn(move || pixels.iter().map(one).collect::<Vec<f64>>()))
                .collect();
            tasks.into_iter().flat_map(|t| t.join().expect("no panic")).collect()
        })
    }

    /// `E / pi` of one light.
    fn brings(&self, at: &Receiver, light: u32) -> f32 {
        let l = &self.lights[light as usize];
        let d = l.min - at.position;
        let d2 = d.length_squared();
        let wi = d / d2.sqrt();
        let cos = wi.dot(at.normal);
        let shine = match l.shine {
            Shine::Cosine { normal } => -wi.dot(normal),
            _ => 1.0,
        };
        if !(0.0 < cos && 0.0 < shine) {
            return 0.0;
        }
        let offset = offset_distance(1.0);
        let origin = at.position + at.normal * offset;
        let ray = Ray { origin, direction: wi, t_max: d2.sqrt() - 4.0 * offset };
        if self.tracing.bvh.occluded(&ray, |_| true) {
            return 0.0;
        }
        l.intensity * cos * shine / (PI * d2.max(NEAREST * NEAREST))
    }

    /// Draws the picture once with so many samples a pixel. Returns it and the seconds that took on one thread.
    ///
    /// # Panics
    /// Never.
    #[must_use]
    pub fn draw(&self, method: Method, samples: usize, seed: u64) -> (Vec<f64>, f64) {
        match method {
            Method::Intensity => self.each_pixel(seed, |_, numbers, add| {
                for _ in 0..samples {
                    #[expect(clippy::cast_possible_truncation, reason = "24 bits are enough")]
                    if let Some(p) = self.intensity.one((numbers() as f32).min(1.0 - f32::EPSILON)) {
                        add(p);
                    }
                }
                1.0 / samples as f32
            }),
            Method::Splitting => self.by_cut(&self.splitting, samples, seed),
            Method::Published => self.by_cut(&self.published, samples, seed),
            Method::FixedRandom => {
                self.by_cut(&Representatives::new(&self.lights, 1, Some(seed)), samples, seed)
            }
            Method::FixedBright => self.by_cut(&Representatives::new(&self.lights, 1, None), samples, seed),
            Method::Multidimensional => {
                self.by_cut(&Representatives::new(&self.lights, 32, Some(seed)), samples, seed)
            }
            Method::Ours => self.each_pixel(seed, |at, numbers, add| {
                if samples == 1 {
                    let cut: Cut<'_, FEW> = self.ours.cut(*at, 1, FallOff::Square, Effort::ONE);
                    cut.one(numbers()).into_iter().for_each(add);
                } else {
                    let cut: Cut<'_, MOST> = self.ours.cut(*at, 1, FallOff::Square, Effort::many(samples));
                    cut.many(samples, numbers(), add);
                }
                1.0
            }),
        }
    }

    fn by_cut(&self, lights: &impl Choose, samples: usize, seed: u64) -> (Vec<f64>, f64) {
        self.each_pixel(seed, |at, numbers, add| {
            let until = Until { samples, part: 0.0 };
            cut(lights, at, until, Rule::Right, numbers, &mut |_| 0.0, add);
            1.0
        })
    }

    /// Estimates every pixel; `estimate` says by what the sum of its lights is multiplied.
    fn each_pixel(
        &self,
        seed: u64,
        estimate: impl Fn(&Receiver, &mut dyn FnMut() -> f64, &mut dyn FnMut(Pick)) -> f32,
    ) -> (Vec<f64>, f64) {
        let start = Instant::now();
        let picture = self
            .pixels
            .iter()
            .enumerate()
            .map(|(i, p)| {
                let mut state = sequence::key(seed, 77, i as u64);
                let mut numbers = || {
                    state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
                    (sequence::mix64(state) >> 11) as f64 / (1u64 << 53) as f64
                };
                let mut sum = 0.0;
                let scale =
                    estimate(&p.at, &mut numbers, &mut |p2| sum += self.brings(&p.at, p2.light) / p2.chance);
                f64::from(sum * scale)
            })
            .collect();
        (picture, start.elapsed().as_secs_f64())
    }

    /// Error of a picture.
    #[must_use]
    pub fn rmse(&self, picture: &[f64]) -> Rmse {
        let mean = self.truth.iter().sum::<f64>() / self.truth.len() as f64;
        let of = |take: &dyn Fn(&Pixel) -> bool| {
            let squares: Vec<f64> = self
                .pixels
                .iter()
                .zip(picture.iter().zip(&self.truth))
                .filter(|(p, _)| take(p))
                .map(|(_, (a, b))| (a - b).powi(2))
                .collect();
            (squares.iter().sum::<f64>() / squares.len() as f64).sqrt() / mean
        };
        Rmse { all: of(&|_| true), above: of(&|p| p.above), below: of(&|p| !p.above) }
    }

    /// Mean and standard deviation of the errors of so many pictures, and the median of their seconds.
    #[must_use]
    pub fn runs(&self, method: Method, samples: usize, runs: u64) -> ([Rmse; 2], f64) {
        let mut seconds = Vec::new();
        let all: Vec<Rmse> = (0..runs)
            .map(|seed| {
                let (picture, s) = self.draw(method, samples, seed);
                seconds.push(s);
                self.rmse(&picture)
            })
            .collect();
        seconds.sort_by(f64::total_cmp);
        let n = all.len() as f64;
        let of = |f: fn(&Rmse) -> f64| {
            let mean = all.iter().map(f).sum::<f64>() / n;
            let variance = all.iter().map(|r| (f(r) - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
            (mean, variance.sqrt())
        };
        let (a, b, c) = (of(|r| r.all), of(|r| r.above), of(|r| r.below));
        let both = [Rmse { all: a.0, above: b.0, below: c.0 }, Rmse { all: a.1, above: b.1, below: c.1 }];
        (both, seconds[seconds.len() / 2])
    }
}

/// Where a ray ends, and the normal on its side.
fn closest(tracing: &Tracing, origin: Vec3A, direction: Vec3A) -> Option<(Vec3A, Vec3A)> {
    let hit = tracing.bvh.closest(&Ray { origin, direction, t_max: f32::INFINITY }, |_| true)?;
    let at = tracing.world.point(hit.triangle, hit.bary);
    Some((at.position, at.geometric_normal))
}
