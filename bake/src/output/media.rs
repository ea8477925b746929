//! What participating media are, for games that draw fog: everything of it is in the manifest, but densities that vary from place to place.
//!
//! Those of voxels, and which part of a place lies in a closed mesh, are in `medium-N.ktx2`: a three-dimensional texture of one channel of half floats,
//! x fastest, in the axes of the voxels, or in the scene's where there are none. A texel is the mean of the density over its box, so that the mass of a medium is kept where
//! the texture is coarser than its source. Means over voxels are exact. Of what is in a mesh, lines through a texel along its third axis are exact; a texel has about as many of
//! them as it covers voxels, 4 x 4 to 8 x 8. Where densities are very large or very small numbers they are told in a unit of their own, by which sigma in the manifest
//! is multiplied. See [`manifest::DensityTexture`].

use crate::error::{Error, Result};
use crate::media::boundary::Boundary;
use crate::media::march::March;
use crate::output::folder::Staging;
use crate::output::ktx::{self, Half, Packing, Texels};
use crate::output::sky::covered;
use crate::plan::memory::MOST_DENSITIES;
use crate::plan::{MediaMode, Plan};
use crate::scene::model::{Density, Medium, Region, Shell};
use crate::scene::voxels::Voxels;
use glam::{DAffine3, DVec3, UVec3, Vec3, Vec3A};
use half::f16;
use rayon::prelude::*;
use tables::format::manifest;

/// Lines through a texel along each of two axes, at least.
const LEAST_LINES: u32 = 4;

/// And at most.
const MOST_LINES: u32 = 8;

/// Columns of an affine map, then its translation.
type Columns = [[f32; 3]; 4];

/// Texture of medium `n`.
#[must_use]
pub fn file(n: usize) -> String {
    format!("medium-{n}.ktx2")
}

/// Writes the textures of a plan's media; what the manifest says of them. None if the plan leaves media out.
///
/// # Errors
/// [`Error::Io`] if a texture cannot be written.
pub fn write(plan: &Plan, staging: &Staging) -> Result<Vec<manifest::Medium>> {
    if plan.settings().media == MediaMode::Off {
        return Ok(Vec::new());
    }
    let mut list = Vec::new();
    for medium in plan.scene().media.iter().filter(|m| m.dims() || m.emission != Vec3::ZERO) {
        list.extend(describe(medium, list.len(), staging)?);
    }
    Ok(list)
}

/// A medium as the manifest has it; `None` if it has no volume.
fn describe(medium: &Medium, number: usize, staging: &Staging) -> Result<Option<manifest::Medium>> {
    let body = match &medium.region {
        Region::Mesh(shell) => Some(Body::new(shell)),
        _ => None,
    };
    let unit_from_world = match &medium.region {
        Region::Everywhere => None,
        Region::Box { min, max } => Some(unit_from_box(min.as_dvec3(), max.as_dvec3())),
        Region::Turned { unit_from_world } => Some(unit_from_world.as_daffine3()),
        Region::Mesh(_) => body.as_ref().map(|b| unit_from_box(b.min, b.max)),
    };
    let unit_from_world = unit_from_world.map(|m| columns(&m));
    if unit_from_world.is_some_and(|m| !m.as_flattened().iter().all(|v| v.is_finite())) {
        return Ok(None);
    }
    let mut unit = 1.0;
    let texture = match Densities::of(medium, body) {
        Some(densities) => {
            let mut half = Half::default();
            let texels = densities.texels();
            unit = unit_of(&texels, medium);
            let texels: Vec<f16> = texels.into_iter().map(|v| half.of(v / unit)).collect();
            let (name, size) = (file(number), densities.size.to_array());
            let bytes = ktx::volume(size, Texels::R16f(&texels), Packing::Stored, ktx::VOLUME_TEXTS)
                .map_err(Error::io(staging.path(&name), "cannot write"))?;
            staging.write(&name, bytes)?;
            let unit_from_world = columns(&densities.unit_from_world());
            Some(manifest::DensityTexture { file: name, size, unit_from_world, clamped: half.clamped })
        }
        None => None,
    };
    Ok(Some(manifest::Medium {
        path: medium.path.clone(),
        sigma_s: (medium.sigma_s * unit).to_array(),
        sigma_a: (medium.sigma_a * unit).to_array(),
        emission: (medium.emission * unit).to_array(),
        g: medium.g,
        unit_from_world,
        height: match medium.density {
            Density::Height { base, falloff } => Some(manifest::HeightDensity { base, falloff }),
            Density::Constant | Density::Voxels { .. } => None,
        },
        texture,
    }))
}

/// In what densities are told: a power of two near the greatest where half floats would be too coarse or too small for them, as far as sigma
/// stays finite; 1 for most.
fn unit_of(texels: &[f32], medium: &Medium) -> f32 {
    let most = texels.iter().fold(0.0f32, |m, v| m.max(*v));
    if most == 0.0 || (LEAST_PLAIN..MOST_PLAIN).contains(&most) {
        return 1.0;
    }
    let sigma = medium.sigma_s.max(medium.sigma_a).max(medium.emission).max_element();
    let room = (0.5 * f32::MAX / sigma).log2().floor();
    most.log2().floor().min(room).exp2()
}

/// Densities whose greatest is between these are told as they are, with at least four digits down to a thousandth of it.
const LEAST_PLAIN: f32 = 1.0 / 16.0;
const MOST_PLAIN: f32 = 1024.0;

/// The map from the world into the unit cube of a box; not finite if that has no volume.
fn unit_from_box(min: DVec3, max: DVec3) -> DAffine3 {
    let scale = (max - min).recip();
    DAffine3::from_scale(scale) * DAffine3::from_translation(-min)
}

#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
fn columns(m: &DAffine3) -> Columns {
    m.to_cols_array_2d().map(|column| column.map(|v| v as f32))
}

/// A closed mesh around a medium, in f32 relative to its middle, so that it is as exact far from the scene's origin as near it.
struct Body {
    middle: DVec3,
    boundary: Boundary,
    /// Bounds in the world.
    min: DVec3,
    max: DVec3,
}

impl Body {
    fn new(shell: &Shell) -> Self {
        let (min, max) = shell
            .positions
            .iter()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), p| (a.min(*p), b.max(*p)));
        let middle = 0.5 * min + 0.5 * max;
        let positions = shell.positions.iter().map(|p| p - middle).collect();
        let boundary = Boundary::new(positions, shell.triangles.clone());
        let (min, max) = boundary.bounds();
        let middle = middle.as_dvec3();
        Self { middle, min: min.as_dvec3() + middle, max: max.as_dvec3() + middle, boundary }
    }
}

/// A density that becomes a texture. It has a space in which its source has a step along each axis: that of voxels, or of texels where there are none.
struct Densities<'a> {
    voxels: Option<&'a Voxels>,
    body: Option<Body>,
    steps_from_world: DAffine3,
    /// The first step and the number of steps that the texture covers.
    first: UVec3,
    count: UVec3,
    /// Texels.
    size: UVec3,
}

impl<'a> Densities<'a> {
    /// `None` if the manifest says everything without a texture.
    fn of(medium: &'a Medium, body: Option<Body>) -> Option<Self> {
        let Density::Voxels { values, voxels_from_world } = &medium.density else {
            let body = body?;
            let size = texels_of((body.max - body.min).to_array());
            let steps_from_world = DAffine3::from_scale(size.as_dvec3()) * unit_from_box(body.min, body.max);
            return Some(Self {
                voxels: None,
                body: Some(body),
                steps_from_world,
                first: UVec3::ZERO,
                count: size,
                size,
            });
        };
        let steps_from_world = voxels_from_world.as_daffine3();
        let (min, max) = match &medium.region {
            Region::Everywhere => (DVec3::ZERO, values.size().as_dvec3()),
            Region::Box { min, max } => corners((min.as_dvec3(), max.as_dvec3()), &steps_from_world),
            Region::Turned { unit_from_world } => corners(
                (DVec3::ZERO, DVec3::ONE),
                &(steps_from_world * unit_from_world.as_daffine3().inverse()),
            ),
            Region::Mesh(shell) => {
                around(shell.positions.iter().map(|p| steps_from_world.transform_point3(p.as_dvec3())))
            }
        };
        // Whole voxels, so that texels are voxels where there are not too many.
        let (first, last) = (min.floor().as_uvec3(), max.ceil().as_uvec3().min(values.size()));
        let voxels = Some(&**values);
        if !first.cmplt(last).all() {
            // The region and the grid have nothing in common: one texel of zero.
            let (first, count) = (UVec3::ZERO, values.size());
            return Some(Self { voxels: None, body: None, steps_from_world, first, count, size: UVec3::ONE });
        }
        let count = last - first;
        let step = count.max_element().div_ceil(MOST_DENSITIES);
        let size = count.map(|n| n.div_ceil(step));
        Some(Self { voxels, body, steps_from_world, first, count, size })
    }

    fn unit_from_world(&self) -> DAffine3 {
        let first = self.first.as_dvec3();
        unit_from_box(first, first + self.count.as_dvec3()) * self.steps_from_world
    }

    /// Mean densities of the texels, x fastest, then y, then z.
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
    fn texels(&self) -> Vec<f32> {
        let [x, y, z] = self.size.to_array().map(|n| n as usize);
        let columns: Vec<Vec<f32>> = (0..x * y)
            .into_par_iter()
            .map_init(Vec::new, |parts, i| {
                let mut column = Column::new(self.count.z, self.size.z);
                match &self.body {
                    Some(body) => self.lines(body, [i % x, i / x], parts, &mut column),
                    None => self.voxels(self.voxels, [i % x, i / x], &mut column),
                }
                column.means.into_iter().map(|v| v as f32).collect()
            })
            .collect();
        (0..x * y * z).map(|i| columns[i % (x * y)][i / (x * y)]).collect()
    }

    /// Adds the voxels in a column of texels.
    fn voxels(&self, voxels: Option<&Voxels>, [x, y]: [usize; 2], column: &mut Column) {
        let Some(voxels) = voxels else { return };
        let along = |i: usize, axis: usize| {
            covered(i, self.size[axis] as usize, self.count[axis] as usize)
                .into_iter()
                .map(move |(k, share)| (self.first[axis] as f32 + k as f32 + 0.5, share))
        };
        for (v, part) in along(y, 1) {
            for (u, across) in along(x, 0) {
                self.add(voxels, [u, v], (0.0, self.count.z as f32), part * across, column);
            }
        }
    }

    /// Adds what lies within a mesh, by lines through a column of texels.
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    fn lines(&self, body: &Body, [x, y]: [usize; 2], parts: &mut Vec<(f32, f32)>, column: &mut Column) {
        let world_from_steps = self.steps_from_world.inverse();
        let direction = world_from_steps.transform_vector3(DVec3::Z).as_vec3a();
        let end = self.count.z as f32;
        let n = [0, 1].map(|axis| lines(self.count[axis], self.size[axis]));
        let share = 1.0 / f64::from(n[0] * n[1]);
        let place = |i: usize, k: u32, axis: usize| {
            let texel = f64::from(self.count[axis]) / f64::from(self.size[axis]);
            f64::from(self.first[axis]) + (i as f64 + (f64::from(k) + 0.5) / f64::from(n[axis])) * texel
        };
        for (j, i) in (0..n[1]).flat_map(|j| (0..n[0]).map(move |i| (j, i))) {
            let (u, v) = (place(x, i, 0), place(y, j, 1));
            let from = world_from_steps.transform_point3(DVec3::new(u, v, f64::from(self.first.z)));
            parts.clear();
            body.boundary.inside((from - body.middle).as_vec3a(), direction, end, parts);
            for &(from, to) in parts.iter() {
                match self.voxels {
                    Some(voxels) => self.add(voxels, [u as f32, v as f32], (from, to), share, column),
                    None => column.add(f64::from(from), f64::from(to), share),
                }
            }
        }
    }

    /// Adds voxels along a line between two distances from the first one.
    fn add(
        &self,
        voxels: &Voxels,
        [x, y]: [f32; 2],
        (from, to): (f32, f32),
        share: f64,
        column: &mut Column,
    ) {
        let first = self.first.z as f32;
        let march = March::new(voxels, Vec3A::new(x, y, first), Vec3A::Z);
        march.pieces(from, to, |from, to, density| {
            column.add(from, to, share * density);
            true
        });
    }
}

/// Texels along the axes of a box.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 128")]
fn texels_of(extent: [f64; 3]) -> UVec3 {
    let longest = extent.into_iter().fold(0.0, f64::max);
    let most = f64::from(MOST_DENSITIES);
    // A little less, so that rounding makes no texel of its own.
    UVec3::from(extent.map(|e| (e / longest * most - 1e-6).ceil().clamp(1.0, most) as u32))
}

/// Lines through a texel along an axis where it covers some steps: about one a step.
fn lines(count: u32, size: u32) -> u32 {
    count.div_ceil(size).clamp(LEAST_LINES, MOST_LINES)
}

/// Bounds of places.
fn around(places: impl Iterator<Item = DVec3>) -> (DVec3, DVec3) {
    let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (min, max) = places.fold(none, |(a, b), p| (a.min(p), b.max(p)));
    (min.max(DVec3::ZERO), max)
}

/// Bounds of a box that is mapped.
fn corners((min, max): (DVec3, DVec3), map: &DAffine3) -> (DVec3, DVec3) {
    around((0..8u8).map(|i| {
        let bit = |k: u8| f64::from(i >> k & 1);
        map.transform_point3(min + (max - min) * DVec3::new(bit(0), bit(1), bit(2)))
    }))
}

/// Means over the texels of a column.
struct Column {
    /// Texels in a step.
    per_step: f64,
    means: Vec<f64>,
}

impl Column {
    fn new(count: u32, size: u32) -> Self {
        Self { per_step: f64::from(size) / f64::from(count), means: vec![0.0; size as usize] }
    }

    /// Adds a density from one step to another.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "cut to the texels")]
    fn add(&mut self, from: f64, to: f64, density: f64) {
        let end = self.means.len() as f64;
        let (from, to) = ((from * self.per_step).clamp(0.0, end), (to * self.per_step).clamp(0.0, end));
        let texels = from as usize..(to.ceil() as usize).min(self.means.len());
        for (k, mean) in self.means.iter_mut().enumerate().take(texels.end).skip(texels.start) {
            let part = to.min(k as f64 + 1.0) - from.max(k as f64);
            *mean += density * part.max(0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn densities_have_a_unit_that_half_floats_hold() {
        let medium = Medium {
            path: String::new(),
            sigma_s: Vec3::splat(1e7),
            sigma_a: Vec3::ZERO,
            emission: Vec3::ZERO,
            density: Density::Constant,
            g: 0.0,
            region: Region::Everywhere,
        };
        assert_eq!(unit_of(&[0.0, 0.3, 1.0], &medium), 1.0);
        assert_eq!(unit_of(&[0.0], &medium), 1.0);
        for most in [2e-8, 1e-3, 5e4, 1e20] {
            let unit = unit_of(&[0.0, most, 0.5 * most], &medium);
            assert!((1.0..2.0).contains(&(most / unit)) && (unit * 1e7).is_finite(), "{most}: {unit}");
        }
        let bright = Medium { sigma_s: Vec3::splat(1e30), ..medium };
        assert!((unit_of(&[1e20], &bright) * bright.sigma_s).is_finite());
    }
    use glam::{Affine3A, Quat, uvec3};
    use std::sync::Arc;

    fn medium(region: Region, density: Density) -> Medium {
        Medium {
            path: "fog".into(),
            sigma_s: Vec3::ONE,
            sigma_a: Vec3::splat(0.5),
            emission: Vec3::ZERO,
            density,
            g: 0.25,
            region,
        }
    }

    /// A grid of densities, of which many are 0.
    fn grid(size: UVec3) -> Arc<Voxels> {
        let value = |v: UVec3| {
            let i = v.x * 7 + v.y * 13 + v.z * 29;
            if (v.x / 9 + v.y / 5).is_multiple_of(2) { 0.0 } else { (i % 17) as f32 / 4.0 }
        };
        Arc::new(Voxels::from_fn(size, 1 << 30, value).expect("a grid"))
    }

    fn densities(medium: &Medium) -> Densities<'_> {
        let body = match &medium.region {
            Region::Mesh(shell) => Some(Body::new(shell)),
            _ => None,
        };
        Densities::of(medium, body).expect("a texture")
    }

    /// Volume times density of all texels.
    fn mass(d: &Densities<'_>) -> f64 {
        let texel = d.unit_from_world().matrix3.determinant().recip() / d.size.as_dvec3().element_product();
        d.texels().iter().map(|v| f64::from(*v)).sum::<f64>() * texel.abs()
    }

    fn shell(shape: &[[Vec3; 3]]) -> Region {
        let positions: Vec<Vec3> = shape.iter().flatten().copied().collect();
        let triangles = (0..u32::try_from(shape.len()).expect("few")).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]);
        Region::Mesh(Arc::new(Shell { positions, triangles: triangles.collect() }))
    }

    /// An octahedron: 4/3 of the product of its half axes is its volume.
    fn octahedron(middle: Vec3, half: Vec3) -> Region {
        let mut faces = Vec::new();
        for i in 0..8u8 {
            let sign = |k: u8| if i >> k & 1 == 0 { 1.0 } else { -1.0 };
            let [x, y, z] =
                [Vec3::X * sign(0), Vec3::Y * sign(1), Vec3::Z * sign(2)].map(|v| middle + v * half);
            faces.push(if sign(0) * sign(1) * sign(2) < 0.0 { [y, x, z] } else { [x, y, z] });
        }
        shell(&faces)
    }

    /// A turned grid in its own bounds keeps its mass to rounding, whether texels are voxels or cover parts of several.
    #[test]
    fn grids_keep_their_mass() {
        let world_from_voxels = Affine3A::from_translation(Vec3::new(100.0, -3.0, 7.0))
            * Affine3A::from_quat(Quat::from_rotation_y(0.4))
            * Affine3A::from_scale(Vec3::new(0.1, 0.2, 0.05));
        for (size, texels) in [
            (uvec3(20, 9, 11), uvec3(20, 9, 11)),
            (uvec3(128, 1, 30), uvec3(128, 1, 30)),
            (uvec3(200, 7, 33), uvec3(100, 4, 17)),
            (uvec3(300, 20, 2), uvec3(100, 7, 1)),
        ] {
            let values = grid(size);
            let each = (0..size.element_product())
                .map(|i| {
                    Vec3A::new(
                        (i % size.x) as f32,
                        (i / size.x % size.y) as f32,
                        (i / (size.x * size.y)) as f32,
                    )
                })
                .map(|v| f64::from(values.at(v + 0.5)));
            let want = each.sum::<f64>() * f64::from(0.1f32 * 0.2 * 0.05);
            let voxels_from_world = world_from_voxels.inverse();
            let unit_from_world = Affine3A::from_scale(size.as_vec3().recip()) * voxels_from_world;
            let density = Density::Voxels { values: Arc::clone(&values), voxels_from_world };
            for region in [Region::Everywhere, Region::Turned { unit_from_world }] {
                let fog = medium(region, density.clone());
                let d = densities(&fog);
                assert_eq!(d.size, texels);
                assert!((mass(&d) / want - 1.0).abs() < 1e-5, "{size}: {} {want}", mass(&d));
                if size == texels {
                    let all = d.texels();
                    let at = |v: UVec3| all[(v.x + size.x * (v.y + size.y * v.z)) as usize];
                    let v = uvec3(11, 0, 3);
                    assert_eq!(at(v), values.at(v.as_vec3a() + 0.5));
                    let p = world_from_voxels.transform_point3(v.as_vec3() + 0.5).as_dvec3();
                    let u = d.unit_from_world().transform_point3(p) * size.as_dvec3();
                    assert!((u - v.as_dvec3() - 0.5).abs().max_element() < 1e-3, "{u}");
                }
            }
        }
    }

    /// A box in the middle of a grid leaves the voxels that it may touch.
    #[test]
    fn grids_are_cut_to_their_region() {
        let density =
            Density::Voxels { values: grid(uvec3(40, 40, 40)), voxels_from_world: Affine3A::IDENTITY };
        let region = Region::Box { min: Vec3::new(10.5, -4.0, 3.0), max: Vec3::new(20.0, 50.0, 7.25) };
        let fog = medium(region, density.clone());
        let d = densities(&fog);
        assert_eq!((d.first, d.size), (uvec3(10, 0, 3), uvec3(10, 40, 5)));
        let apart = medium(Region::Box { min: Vec3::splat(50.0), max: Vec3::splat(60.0) }, density);
        let d = densities(&apart);
        assert_eq!((d.size, d.texels()), (UVec3::ONE, vec![0.0]));
    }

    #[test]
    fn meshes_keep_their_mass() {
        let (middle, half) = (Vec3::new(1000.0, 2.0, -50.0), Vec3::new(3.0, 1.0, 0.5));
        let fog = medium(octahedron(middle, half), Density::Constant);
        let d = densities(&fog);
        assert_eq!(d.size, uvec3(128, 43, 22));
        let want = 4.0 / 3.0 * 1.5;
        assert!((mass(&d) / want - 1.0).abs() < 1e-3, "{} {want}", mass(&d));
        let texels = d.texels();
        assert!(texels.iter().all(|v| (0.0..=1.0 + 1e-5).contains(v)));
        assert!(texels[0] == 0.0 && 0.999 < texels[64 + 128 * (21 + 43 * 11)]);
        assert!(columns(&d.unit_from_world()).as_flattened().iter().all(|v| v.is_finite()));
    }

    /// An even grid in a mesh has the mesh's mass, times its density; voxels of a half space have half of it.
    #[test]
    fn grids_within_meshes_keep_their_mass() {
        for size in [uvec3(16, 16, 16), uvec3(300, 64, 64)] {
            let half = size.x / 2;
            for (uneven, want) in [(false, 2.0), (true, 1.0)] {
                let values = Voxels::from_fn(size, 1 << 30, |v| if uneven && v.x < half { 0.0 } else { 2.0 });
                let values = Arc::new(values.expect("a grid"));
                // The grid is 4 m wide and turned by a quarter, the mesh is 2 m wide in its middle.
                let world_from_voxels =
                    Affine3A::from_quat(Quat::from_rotation_y(std::f32::consts::FRAC_PI_2))
                        * Affine3A::from_scale(4.0 / size.as_vec3())
                        * Affine3A::from_translation(-0.5 * size.as_vec3());
                let density = Density::Voxels { values, voxels_from_world: world_from_voxels.inverse() };
                let fog = medium(octahedron(Vec3::ZERO, Vec3::ONE), density);
                let d = densities(&fog);
                let want = want * 4.0 / 3.0;
                assert!((mass(&d) / want - 1.0).abs() < 4e-3, "{size} {uneven}: {} {want}", mass(&d));
            }
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_file() -> anyhow::Result<()> {
        let density =
            Density::Voxels { values: grid(uvec3(150, 20, 31)), voxels_from_world: Affine3A::IDENTITY };
        let region = octahedron(Vec3::new(60.0, 10.0, 15.0), Vec3::new(50.0, 9.0, 14.0));
        let fog = medium(region, density);
        let mut files = Vec::new();
        for threads in [1, 2, 3] {
            let dir = tempfile::tempdir()?;
            let staging = Staging::begin(&dir.path().join("out"))?;
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
            let said = pool.install(|| describe(&fog, 0, &staging))?.expect("a medium");
            files.push((std::fs::read(staging.path("medium-0.ktx2"))?, said));
        }
        assert!(files.iter().all(|f| *f == files[0]));
        Ok(())
    }

    #[test]
    fn media_are_told_as_they_are() -> anyhow::Result<()> {
        let dir = tempfile::tempdir()?;
        let staging = Staging::begin(&dir.path().join("out"))?;
        let height = Density::Height { base: 1.0, falloff: 3.0 };
        let low = describe(&medium(Region::Everywhere, height), 3, &staging)?.expect("a medium");
        assert_eq!(low.height, Some(manifest::HeightDensity { base: 1.0, falloff: 3.0 }));
        assert!(low.unit_from_world.is_none() && low.texture.is_none());
        let boxed = Region::Box { min: Vec3::new(1.0, 2.0, 3.0), max: Vec3::new(2.0, 4.0, 7.0) };
        let boxed = describe(&medium(boxed, Density::Constant), 0, &staging)?.expect("a medium");
        let want = [[1.0, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.25], [-1.0, -1.0, -0.75]];
        assert_eq!(boxed.unit_from_world, Some(want));
        assert!(boxed.texture.is_none() && !staging.path("medium-0.ktx2").exists());
        let flat = Region::Box { min: Vec3::ZERO, max: Vec3::new(1.0, 0.0, 1.0) };
        assert_eq!(describe(&medium(flat, Density::Constant), 0, &staging)?, None);
        let nothing = medium(shell(&[]), Density::Constant);
        assert_eq!(describe(&nothing, 0, &staging)?, None);
        // Densities beyond half floats have a unit of their own.
        let values = Voxels::from_fn(uvec3(2, 1, 1), 1 << 20, |v| if v.x == 0 { 1e6 } else { 2.0 });
        let values = Arc::new(values.expect("a grid"));
        let density = Density::Voxels { values, voxels_from_world: Affine3A::IDENTITY };
        let dense = describe(&medium(Region::Everywhere, density), 1, &staging)?.expect("a medium");
        let texture = dense.texture.expect("a texture");
        assert_eq!((texture.file.as_str(), texture.size, texture.clamped), ("medium-1.ktx2", [2, 1, 1], 0));
        let unit = 524_288.0;
        let sigma = medium(Region::Everywhere, Density::Constant).sigma_s * unit;
        assert_eq!(dense.sigma_s, sigma.to_array());
        let bytes = std::fs::read(staging.path("medium-1.ktx2"))?;
        let reader = ktx2::Reader::new(&bytes[..]).expect("a KTX2 file");
        assert_eq!(reader.header().format, Some(ktx2::Format::R16_SFLOAT));
        let want = [1e6, 2.0].map(|d| f16::from_f32(d / unit).to_le_bytes()).concat();
        assert_eq!(reader.levels().next().expect("a level").data, want);
        Ok(())
    }
}
