//! Light that media emit along rays, and directions in which it comes from.
//!
//! Along a ray everything is constant between the faces of voxels, so what arrives is a sum of closed forms. Directions are chosen by
//! choosing a place in proportion to what is emitted there and looking towards it; what then counts is all that the whole line
//! brings, so that the density of a direction is an integral along the line as well, and nothing near is singular.

use super::{Body, Media, Segment, Shape, Small, density, march, metres};
use crate::geom::world::luminance;
use crate::scene::model::{Density, Rgb};
use crate::scene::voxels::{BRICK, Brick, SIDE, Voxels};
use glam::{Affine3A, UVec3, Vec3, Vec3A, uvec3};
use std::cell::RefCell;
use std::sync::Arc;

/// Where light is emitted.
#[derive(Clone, Debug)]
pub(super) struct Emission {
    parts: Vec<Part>,
    /// Sum of [`Part::power`].
    total: f64,
}

/// One medium that emits.
#[derive(Clone, Debug)]
struct Part {
    /// Luminance where the density is 1, nits per metre.
    luminance: f32,
    /// That times the volume where densities are taken for those below, nits m^2.
    power: f64,
    places: Places,
}

/// Where places of a part are chosen.
#[derive(Clone, Debug)]
enum Places {
    /// Evenly in the unit cube, which is led to the world.
    Cube { world_from_unit: Affine3A, unit_from_world: Affine3A },
    /// By density.
    Voxels {
        values: Arc<Voxels>,
        world_from_voxels: Affine3A,
        voxels_from_world: Affine3A,
        /// Sums of densities up to each brick and with it.
        sums: Vec<f64>,
    },
}

impl Emission {
    /// `None` where nothing is emitted.
    pub(super) fn new(bodies: &[Body]) -> Option<Self> {
        if bodies.iter().all(|b| b.emission == Vec3::ZERO) {
            return None;
        }
        let parts: Vec<Part> = bodies.iter().filter_map(Part::new).collect();
        let total = parts.iter().map(|p| p.power).sum();
        Some(Self { parts, total })
    }
}

impl Part {
    /// `None` where nothing is emitted, or without end: rays find it alone.
    fn new(body: &Body) -> Option<Self> {
        let luminance = luminance(body.emission);
        if luminance <= 0.0 {
            return None;
        }
        let (places, volume) = match &body.density {
            Density::Voxels { values, voxels_from_world } => {
                let sums: Vec<f64> = sums(values);
                let world_from_voxels = voxels_from_world.inverse();
                let volume = f64::from(world_from_voxels.matrix3.determinant().abs()) * sums.last()?;
                let (values, voxels_from_world) = (Arc::clone(values), *voxels_from_world);
                (Places::Voxels { values, world_from_voxels, voxels_from_world, sums }, volume)
            }
            Density::Constant | Density::Height { .. } => {
                let world_from_unit = match &body.shape {
                    Shape::Everywhere => return None,
                    Shape::Turned(unit_from_world) => unit_from_world.inverse(),
                    Shape::Box { .. } | Shape::Mesh(_) => {
                        let (min, max) = body.bounds()?;
                        Affine3A::from_translation(min) * Affine3A::from_scale(max - min)
                    }
                };
                let volume = f64::from(world_from_unit.matrix3.determinant().abs());
                (Places::Cube { world_from_unit, unit_from_world: world_from_unit.inverse() }, volume)
            }
        };
        let power = f64::from(luminance) * volume;
        (0.0 < power && power.is_finite()).then_some(Self { luminance, power, places })
    }

    /// Integral of density times the square of the distance along a ray, m^3.
    fn third_moment(&self, origin: Vec3A, direction: Vec3A) -> f64 {
        let moment = match &self.places {
            Places::Cube { unit_from_world, .. } => {
                let (from, to) = super::turned(unit_from_world, origin, direction, f32::INFINITY);
                if from < to { f64::from(to).powi(3) - f64::from(from).powi(3) } else { 0.0 }
            }
            Places::Voxels { values, voxels_from_world, .. } => {
                let mut sum = 0.0;
                march(values, voxels_from_world, origin, direction).pieces(
                    0.0,
                    f32::INFINITY,
                    |a, b, density| {
                        sum += density * (b - a) * (a * a + a * b + b * b);
                        true
                    },
                );
                sum
            }
        };
        moment / 3.0
    }

    /// The place in a voxel that `which` chooses, or in the cube; numbers in [0, 1).
    fn place(&self, which: f64, within: Vec3A) -> Option<Vec3A> {
        match &self.places {
            Places::Cube { world_from_unit, .. } => Some(world_from_unit.transform_point3a(within)),
            Places::Voxels { values, world_from_voxels, sums, .. } => {
                let wanted = which * sums.last()?;
                let cell = sums.partition_point(|s| *s <= wanted).min(sums.len() - 1);
                let mut rest = wanted - if cell == 0 { 0.0 } else { sums[cell - 1] };
                let mut chosen = None;
                of_brick(values, cell, |voxel, density| {
                    if 0.0 < density {
                        chosen = Some(voxel);
                        rest -= density;
                    }
                    0.0 <= rest
                });
                let corner = chosen?.as_vec3a();
                Some(world_from_voxels.transform_point3a(corner + within))
            }
        }
    }
}

/// Sums of densities up to each brick and with it, of voxels in the box.
fn sums(values: &Voxels) -> Vec<f64> {
    let mut sum = 0.0;
    let bricks = values.along().as_usizevec3().element_product();
    (0..bricks)
        .map(|cell| {
            of_brick(values, cell, |_, density| {
                sum += density;
                true
            });
            sum
        })
        .collect()
}

/// Calls `visit` with place and density of each voxel of a brick that is in the box, until it says no.
fn of_brick(values: &Voxels, cell: usize, mut visit: impl FnMut(UVec3, f64) -> bool) {
    let brick = values.brick(cell);
    if brick == Brick::Constant(0.0) {
        return;
    }
    let along = values.along().as_usizevec3();
    let at = [cell % along.x, cell / along.x % along.y, cell / (along.x * along.y)];
    #[expect(clippy::cast_possible_truncation, reason = "numbers of bricks along an axis")]
    let first = uvec3(at[0] as u32, at[1] as u32, at[2] as u32) * SIDE;
    for (i, k) in (0..BRICK).zip(0u32..) {
        let voxel = first + uvec3(k % SIDE, k / SIDE % SIDE, k / (SIDE * SIDE));
        // What wraps around is before the box.
        let voxel = voxel.wrapping_sub(values.margin());
        if !voxel.cmplt(values.size()).all() {
            continue;
        }
        let density = match brick {
            Brick::Constant(density) => density,
            Brick::Varying(list) => list[i],
        };
        if !visit(voxel, f64::from(density)) {
            return;
        }
    }
}

/// Points along the longest side of a medium, at least.
const FINE: u32 = 32;

/// Room for what a ray crosses.
#[derive(Default)]
struct Room {
    segments: Vec<Segment>,
    /// Where something changes.
    cuts: Vec<f64>,
    /// Begin, end and density of what each grid has on the way, one grid after the other.
    steps: Vec<(f64, f64, f64)>,
}

thread_local! {
    static ROOM: RefCell<Room> = RefCell::default();
}

/// A medium in a segment.
struct Profile<'a> {
    body: &'a Body,
    /// Where the steps of its grid begin and end; `None` without a grid.
    steps: Option<(usize, usize)>,
}

/// (1 - e^-x) / x, the mean of what is left of light that is emitted evenly along an optical depth.
fn mean_left(x: f64) -> f64 {
    if x == 0.0 { 1.0 } else { -(-x).exp_m1() / x }
}

impl Media {
    /// Whether any of them emits.
    #[must_use]
    #[inline]
    pub fn emits(&self) -> bool {
        self.emission.is_some()
    }

    /// Whether all that scatters is smoke in grids, and scatters alike in all directions.
    #[must_use]
    pub fn scatters_in_even_smoke_alone(&self) -> bool {
        let mut scatter = self.bodies.iter().filter(|b| b.sigma_s != Vec3::ZERO).peekable();
        scatter.peek().is_some() && scatter.all(|b| b.is_smoke() && b.g == 0.0)
    }

    /// The same where what is scattered counts as absorbed: light is weakened as before.
    #[must_use]
    pub fn without_scattering(&self) -> Self {
        let absorbs = |b: &Body| Body { sigma_s: Vec3::ZERO, sigma_a: b.sigma_s + b.sigma_a, ..b.clone() };
        let small = Small { lossless: false, ..self.small };
        Self { bodies: self.bodies.iter().map(absorbs).collect(), small, ..self.clone() }
    }

    /// Lets nobody choose places for what is emitted: directions find it alone.
    pub fn hide_fire(&mut self) {
        self.fire_hidden = true;
    }

    /// The same without anything that weakens light; `None` where nothing emits.
    #[must_use]
    pub fn undimmed(&self) -> Option<&Self> {
        self.undimmed.as_deref()
    }

    /// See [`Self::undimmed`].
    pub(super) fn without_loss(&self) -> Option<Self> {
        self.emission.as_ref()?;
        let glow = self.bodies.iter().filter(|b| b.emission != Vec3::ZERO);
        let clear = |b: &Body| match b.shape {
            // Without end, it would have no limit.
            Shape::Everywhere => b.clone(),
            _ => Body { sigma_s: Vec3::ZERO, sigma_a: Vec3::ZERO, ..b.clone() },
        };
        let bodies = glow.map(clear).collect();
        Some(Self { bodies, ..self.clone() })
    }

    /// Radiance of media along a ray's first `t_max` metres that arrives at its origin, nits.
    #[must_use]
    pub fn emitted(&self, origin: Vec3A, direction: Vec3A, t_max: f32) -> Rgb {
        if self.emission.is_none() {
            return Vec3::ZERO;
        }
        ROOM.with_borrow_mut(|room| self.emitted_in(room, origin, direction, t_max))
    }

    fn emitted_in(&self, room: &mut Room, origin: Vec3A, direction: Vec3A, t_max: f32) -> Rgb {
        self.segments(origin, direction, t_max, &mut room.segments);
        let glows = |s: &Segment| self.inside(*s).any(|b| b.emission != Vec3::ZERO);
        let Some(last) = room.segments.iter().rposition(glows) else { return Vec3::ZERO };
        let (mut sum, mut depth) = (Vec3::ZERO, Vec3::ZERO);
        for k in 0..=last {
            let s = room.segments[k];
            if glows(&s) {
                sum += self.emitted_within(room, s, (origin, direction), &mut depth);
            } else {
                depth += self.depth_within(s, origin, direction, s.to);
            }
        }
        sum
    }

    /// What of a segment's emission arrives at the ray's origin; `depth` is the optical depth before it, and then with it.
    fn emitted_within(
        &self,
        Room { cuts, steps, .. }: &mut Room,
        segment: Segment,
        (origin, direction): (Vec3A, Vec3A),
        depth: &mut Rgb,
    ) -> Rgb {
        cuts.clear();
        steps.clear();
        cuts.extend([f64::from(segment.from), f64::from(segment.to)]);
        let mut profiles: Vec<Profile<'_>> = self
            .inside(segment)
            .map(|body| {
                let Density::Voxels { values, voxels_from_world } = &body.density else {
                    return Profile { body, steps: None };
                };
                let first = steps.len();
                let march = march(values, voxels_from_world, origin, direction);
                march.pieces(segment.from, segment.to, |a, b, density| {
                    if a < b {
                        cuts.extend([a, b]);
                        steps.push((a, b, density));
                    }
                    true
                });
                Profile { body, steps: Some((first, steps.len())) }
            })
            .collect();
        cuts.sort_unstable_by(f64::total_cmp);
        cuts.dedup();
        let mut sum = Vec3::ZERO;
        for pair in cuts.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            let (mut lost, mut glow) = (Vec3::ZERO, Vec3::ZERO);
            for p in &mut profiles {
                let metres = match &mut p.steps {
                    None => {
                        #[expect(clippy::cast_possible_truncation, reason = "distances of rays")]
                        let (a, b) = (a as f32, b as f32);
                        metres(&p.body.density, origin, direction, a, b)
                    }
                    Some((at, end)) => {
                        while *at < *end && steps[*at].1 <= a {
                            *at += 1;
                        }
                        match steps[..*end].get(*at) {
                            #[expect(clippy::cast_possible_truncation, reason = "rounding is the result")]
                            Some((from, _, density)) if *from <= a => (density * (b - a)) as f32,
                            _ => 0.0,
                        }
                    }
                };
                lost += super::along(p.body.sigma_s + p.body.sigma_a, metres);
                glow += super::along(p.body.emission, metres);
            }
            if glow != Vec3::ZERO {
                sum += if glow.is_finite() && lost.is_finite() {
                    (glow.as_dvec3() * lost.as_dvec3().map(mean_left)).as_vec3() * super::attenuated(*depth)
                } else {
                    // Without end, what arrives is what is emitted where as much is lost.
                    #[expect(clippy::cast_possible_truncation, reason = "a distance of a ray")]
                    let p = origin + direction * a as f32;
                    self.source(segment, p) * super::attenuated(*depth)
                };
            }
            *depth += lost;
        }
        sum
    }

    /// What is emitted at a place over what is lost there, nits.
    fn source(&self, segment: Segment, p: Vec3A) -> Rgb {
        let (mut glow, mut lost) = (Vec3::ZERO, Vec3::ZERO);
        for b in self.inside(segment) {
            let density = density(&b.density, p);
            glow += b.emission * density;
            lost += (b.sigma_s + b.sigma_a) * density;
        }
        Vec3::select(lost.cmpgt(Vec3::ZERO), glow / lost, Vec3::ZERO)
    }

    /// A place where light is emitted, in proportion to how much, in the world's space; `None` where it has no end. Numbers in [0, 1).
    #[must_use]
    pub fn emitting_place(&self, [a, b, c, d]: [f32; 4]) -> Option<Vec3A> {
        let emission = self.emission.as_deref().filter(|_| !self.fire_hidden)?;
        let mut wanted = f64::from(a) * emission.total;
        let last = emission.parts.len().checked_sub(1)?;
        for (i, part) in emission.parts.iter().enumerate() {
            if wanted < part.power || i == last {
                let rest = (wanted / part.power).clamp(0.0, 1.0);
                return part.place(rest, Vec3A::new(b, c, d));
            }
            wanted -= part.power;
        }
        None
    }

    /// What is emitted as points, metres and candela, and the side of the cubes that they stand for, metres; `None` where nothing is emitted, or something is
    /// without end. Points of media whose voxels coincide are one.
    #[must_use]
    pub fn emitting_points(&self) -> Option<(Vec<(Vec3A, Rgb)>, f32)> {
        self.points(None)
    }

    /// The same with what grids of smoke scatter, alike in all directions, of the mean radiance at a place, nits.
    #[must_use]
    pub fn shining_points(&self, around: &dyn Fn(Vec3A) -> Rgb) -> Option<(Vec<(Vec3A, Rgb)>, f32)> {
        self.points(Some(around))
    }

    fn points(&self, around: Option<&dyn Fn(Vec3A) -> Rgb>) -> Option<(Vec<(Vec3A, Rgb)>, f32)> {
        self.emission.as_ref()?;
        let scatters = |b: &Body| around.is_some() && b.is_smoke() && b.sigma_s != Vec3::ZERO;
        let mut side = f32::INFINITY;
        let mut points: Vec<(Vec3A, Rgb)> = Vec::new();
        for b in self.bodies.iter().filter(|b| b.emission != Vec3::ZERO || scatters(b)) {
            let (min, max) = b.bounds()?;
            let extent = (max - min).max_element();
            let (size, world_from_cell, values) = match &b.density {
                Density::Voxels { values, voxels_from_world } => {
                    let parts = FINE.div_ceil(values.size().max_element());
                    let to = voxels_from_world.inverse()
                        * Affine3A::from_scale(Vec3::splat((parts as f32).recip()));
                    (values.size() * parts, to, Some((values, parts)))
                }
                Density::Constant | Density::Height { .. } => {
                    let cell = extent / FINE as f32;
                    let size = ((max - min) / cell).ceil().max(Vec3::ONE).as_uvec3();
                    (
                        size,
                        Affine3A::from_translation(min) * Affine3A::from_scale((max - min) / size.as_vec3()),
                        None,
                    )
                }
            };
            let volume = world_from_cell.matrix3.determinant().abs();
            side = side.min(volume.cbrt());
            let mut one = |cell: UVec3, value: f32| {
                let p = world_from_cell.transform_point3a(cell.as_vec3a() + 0.5);
                if 0.0 < value && b.holds(p) {
                    let scattered =
                        around.filter(|_| scatters(b)).map_or(Vec3::ZERO, |light| b.sigma_s * light(p));
                    points.push((p, (b.emission + scattered) * (value * volume)));
                }
            };
            if let Some((values, parts)) = values {
                for cell in 0..values.along().as_usizevec3().element_product() {
                    of_brick(values, cell, |voxel, value| {
                        #[expect(clippy::cast_possible_truncation, reason = "it was f32")]
                        let value = value as f32;
                        for k in 0..parts.pow(3) {
                            one(
                                voxel * parts + uvec3(k % parts, k / parts % parts, k / (parts * parts)),
                                value,
                            );
                        }
                        true
                    });
                }
                continue;
            }
            for z in 0..size.z {
                for y in 0..size.y {
                    for x in 0..size.x {
                        let cell = uvec3(x, y, z);
                        one(
                            cell,
                            density(&b.density, world_from_cell.transform_point3a(cell.as_vec3a() + 0.5)),
                        );
                    }
                }
            }
        }
        let key = |p: &(Vec3A, Rgb)| p.0.to_array().map(f32::to_bits);
        points.sort_by_key(key);
        points.dedup_by(|b, a| {
            let same = key(a) == key(b);
            if same {
                a.1 += b.1;
            }
            same
        });
        Some((points, side))
    }

    /// Density per steradian with which [`Self::emitting_place`] lies in a direction.
    #[must_use]
    pub fn emitting_pdf(&self, origin: Vec3A, direction: Vec3A) -> f32 {
        let Some(emission) = self.emission.as_deref().filter(|e| 0.0 < e.total && !self.fire_hidden) else {
            return 0.0;
        };
        let each = |p: &Part| f64::from(p.luminance) * p.third_moment(origin, direction);
        #[expect(clippy::cast_possible_truncation, reason = "rounding is the result")]
        let pdf = (emission.parts.iter().map(each).sum::<f64>() / emission.total) as f32;
        pdf
    }
}
