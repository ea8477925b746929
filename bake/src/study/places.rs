//! Points at which bakes of different layouts can be compared: on surfaces by bilinear fetches, in the air by light probes.

use crate::error::{Error, Result};
use crate::geom::Ray;
use crate::output::{exr, folder};
use crate::plan::Plan;
use crate::sample::warp::{square_to_cone, square_to_triangle};
use crate::sample::{Sequence, sequence};
use crate::solve::probes::is_in_wall;
use crate::study::shots::{Studio, Values, luminance};
use crate::transport::Kernel;
use glam::{Vec2, Vec3, Vec3A};
use serde_json::{Value, json};
use std::f32::consts::PI;
use std::path::Path;
use tables::format::manifest::Manifest;
use tables::probes::{FILE_NAME, ProbeVolume};

/// Random numbers of places belong to this domain; see [`sequence::key`].
const DOMAIN: u64 = 0x5354_5544;

/// One less the cosine of a cone that is all directions.
const WHOLE: f32 = 2.0;

/// Points of each kind.
pub const POINTS: usize = 1500;

/// Part of the free way over a surface at which a place in the air lies, least and most.
const ALONG: [f32; 2] = [0.2, 0.5];

/// Free ways longer than this part of the scene's radius count as this long.
const FAR: f32 = 0.25;

/// A point on a surface that has texels.
#[derive(Clone, Copy, Debug)]
struct OnSurface {
    surface: usize,
    /// Number within the mesh.
    local: usize,
    bary: [f32; 3],
}

/// Where errors are asked for.
#[derive(Debug)]
pub struct Places {
    on: Vec<OnSurface>,
    /// Of the surface points: place in the file's axes, metres, and normal.
    surface: Vec<[Vec3; 2]>,
    /// Of places in the air: the same, with a normal of any direction.
    air: Vec<[Vec3; 2]>,
}

impl Places {
    /// Chooses places, evenly by area of what is not inside of something.
    #[must_use]
    pub fn new(plan: &Plan, kernel: &Kernel<'_>) -> Self {
        let world = &plan.tracing().world;
        let lit = |t: u32| plan.atlas().placements[world.surface(t)].is_some();
        #[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^31 triangles")]
        let areas: Vec<f64> =
            (0..world.len() as u32).map(|t| if lit(t) { f64::from(world.area(t)) } else { 0.0 }).collect();
        let sums: Vec<f64> = areas
            .iter()
            .scan(0.0, |sum, a| {
                *sum += a;
                Some(*sum)
            })
            .collect();
        let all = sums.last().copied().unwrap_or(0.0);
        let mut places = Self { on: Vec::new(), surface: Vec::new(), air: Vec::new() };
        let key = sequence::key(0, DOMAIN, 0);
        for i in 0..POINTS {
            #[expect(clippy::cast_possible_truncation, reason = "a few")]
            let mut numbers = Sequence::new(key, i as u32);
            let [a, b, c, d] = numbers.next4();
            // Each from a run of its own, so that no part of the scene is left out by chance.
            let target = all * (i as f64 + f64::from(a)) / POINTS as f64;
            let t = sums.partition_point(|s| *s <= target).min(sums.len().saturating_sub(1));
            let bary = square_to_triangle([b, c]);
            #[expect(clippy::cast_possible_truncation, reason = "an index of a triangle")]
            let t = t as u32;
            let at = world.point(t, bary);
            // Insides of bodies are filled from their charts.
            let inside =
                kernel.meets_back(at.position + at.geometric_normal * at.offset, at.geometric_normal);
            if inside {
                continue;
            }
            let (surface, local) = world.locate(t);
            places.on.push(OnSurface { surface, local, bary });
            places.surface.push([Vec3::from(at.position) + world.origin, at.shading_normal.into()]);
            let ray = Ray {
                origin: at.position + at.geometric_normal * at.offset,
                direction: at.geometric_normal,
                t_max: f32::INFINITY,
            };
            let free = kernel.closest(&ray).map_or(f32::INFINITY, |h| h.t).min(FAR * world.radius);
            let along = free * (ALONG[0] + (ALONG[1] - ALONG[0]) * d);
            let [e, f, ..] = numbers.next4();
            let above: Vec3A = ray.origin + ray.direction * along;
            // Where one body stands in another, faces of the first look into the second.
            if is_in_wall(kernel, above, along) {
                continue;
            }
            places.air.push([Vec3::from(above) + world.origin, square_to_cone([e, f], WHOLE).into()]);
        }
        places
    }

    /// Luminance at the points on surfaces, `E / pi` in nits, by `bake points` with these options.
    ///
    /// # Errors
    ///
    /// As [`Studio::points`].
    pub fn on_surfaces(&self, studio: &Studio<'_>, args: &[String], seed: u64) -> Result<Values> {
        ask(studio, &self.surface, args, seed)
    }

    /// The same in the air.
    ///
    /// # Errors
    ///
    /// As [`Studio::points`].
    pub fn in_the_air(&self, studio: &Studio<'_>, args: &[String], seed: u64) -> Result<Values> {
        ask(studio, &self.air, args, seed)
    }

    /// Luminance that the lightmaps of a bake have at the points on surfaces, by bilinear fetches, nits. `plan` is the bake's own.
    ///
    /// # Errors
    ///
    /// Where a page cannot be read.
    pub fn fetched(&self, plan: &Plan, dir: &Path, manifest: &Manifest) -> Result<Vec<f64>> {
        let read = |page: &tables::format::manifest::Page| exr::read(&folder::resolve(dir, &page.file));
        let pages: Vec<exr::Exr> = manifest.pages.iter().map(read).collect::<Result<_>>()?;
        let atlas = plan.atlas();
        self.on
            .iter()
            .map(|on| {
                let missing =
                    || Error::Usage("a surface of the study has no texels in one of its bakes".to_owned());
                let placement = atlas.placements[on.surface].as_ref().ok_or_else(missing)?;
                let corners = atlas.layouts[placement.layout].triangles[on.local];
                let at =
                    (0..3).map(|k| atlas.texel_position(placement, corners[k]) * on.bary[k]).sum::<Vec2>();
                let page = &pages[placement.page];
                let light = page.rgb("").ok_or_else(missing)?;
                Ok(luminance(light.map(|c| bilinear(&c.values, page.width, page.height, at))))
            })
            .collect()
    }

    /// Luminance that the probes of a bake have in the air, `E / pi` in nits; NaN where no probe is.
    ///
    /// # Errors
    ///
    /// Where the probes cannot be read.
    pub fn from_probes(&self, dir: &Path) -> Result<Vec<f64>> {
        let path = dir.join(FILE_NAME);
        let bytes = std::fs::read(&path).map_err(Error::io(&path, "cannot read"))?;
        let volume =
            ProbeVolume::from_bytes(&bytes).map_err(|e| Error::Usage(format!("{}: {e}", path.display())))?;
        let light = |[p, n]: &[Vec3; 2]| {
            volume.light(p.to_array()).map_or(f64::NAN, |l| luminance(l.irradiance(n.to_array())))
        };
        Ok(self.air.iter().map(light).collect())
    }
}

/// Value between the centres of four texels; those beyond an edge count as those at it.
fn bilinear(values: &[f32], width: usize, height: usize, at: Vec2) -> f32 {
    let place = |x: f32, n: usize| {
        let x = (x - 0.5).clamp(0.0, (n.max(1) - 1) as f32);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped above")]
        let first = x as usize;
        (first, (first + 1).min(n.max(1) - 1), x - first as f32)
    };
    let ((x, x1, u), (y, y1, v)) = (place(at.x, width), place(at.y, height));
    let row = |y: usize| values[y * width + x] * (1.0 - u) + values[y * width + x1] * u;
    row(y) * (1.0 - v) + row(y1) * v
}

fn ask(studio: &Studio<'_>, places: &[[Vec3; 2]], args: &[String], seed: u64) -> Result<Values> {
    let list: Vec<Value> =
        places.iter().map(|[p, n]| json!({"position": p.to_array(), "normal": n.to_array()})).collect();
    let text = studio.points(&json!({ "points": list }).to_string(), args, seed)?;
    let odd = || Error::Usage("`bake points` gave an answer that cannot be read".to_owned());
    let answer: Value = serde_json::from_str(&text).map_err(|_| odd())?;
    let list = answer["points"].as_array().filter(|l| l.len() == places.len()).ok_or_else(odd)?;
    let of = |entry: &Value, what: &str| {
        let channel = |c: usize| entry[what][c].as_f64().ok_or_else(odd);
        Ok::<f64, Error>((0.2126 * channel(0)? + 0.7152 * channel(1)? + 0.0722 * channel(2)?) / f64::from(PI))
    };
    let mut values = Values::default();
    for entry in list {
        values.luminance.push(of(entry, "irradiance")?);
        values.std_err.push(of(entry, "std_err")?);
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fetches_are_those_of_a_bilinear_filter() {
        let values = [0.0, 1.0, 2.0, 3.0];
        let at = |x, y| bilinear(&values, 2, 2, Vec2::new(x, y));
        assert_eq!([at(0.5, 0.5), at(1.5, 0.5), at(0.5, 1.5), at(1.0, 1.0)], [0.0, 1.0, 2.0, 1.5]);
        assert_eq!([at(-3.0, 0.5), at(9.0, 9.0)], [0.0, 3.0], "edges go on");
        assert_eq!(bilinear(&[7.0], 1, 1, Vec2::new(0.3, 0.9)), 7.0);
    }
}
