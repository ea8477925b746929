//! Light that a medium without bounds scatters: the tables' impulse responses, made ready for a scene's media (\[IR19\]).
//!
//! A response takes the coefficients along the way between emitter and receiver as if they were the same everywhere (\[IR19\] section
//! 4.4), and nothing shadows the medium itself. Points and patches are of all orders of scattering, suns of the first ten: with an albedo
//! of 1 all of them together do not fade with depth, and count light from beneath the ground.

use super::{Crossing, Media};
use crate::error::Error;
use crate::scene::model::Rgb;
use glam::{Vec3, Vec3A};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use tables::table::file::{Emitter, Part};
use tables::table::{Combined, CombinedPatch, Orders, Range, Tables};

/// Mean cosines beyond this either way are taken as this: the tables end there.
pub const MOST_G: f32 = 0.9;

/// Optical depths beyond this leave no light.
const MOST_DEPTH: f32 = 100.0;

/// Responses of a scene's media.
#[derive(Debug)]
pub struct Responses {
    lamp: Combined,
    sun: Combined,
    patch: CombinedPatch,
    /// All channels are alike.
    grey: bool,
    /// Surfaces farther away than this are found by the directions that surfaces sample alone, metres.
    reach: f32,
    /// Answers below 0, which truncated harmonics give, that were taken as 0.
    clamped: AtomicU64,
    /// Paths that were ended because the medium added light at every reflection.
    grown: AtomicU64,
}

impl Responses {
    /// Adds up tables for `media`, in a scene whose points lie within `radius` metres; `None` if nothing scatters. The tables are those
    /// of `file`, else the embedded ones; of their bands the first `order` count. With `any_albedo` they stay apart by albedo even where media have
    /// one alone.
    ///
    /// A file that lacks the sum of all orders, as that of \[IR19\] does, gives the first ten.
    ///
    /// # Errors
    ///
    /// If the file cannot be read or lacks a table.
    pub fn new(
        media: &Media,
        radius: f32,
        any_albedo: bool,
        (file, order): (Option<&Path>, usize),
    ) -> Result<Option<Self>, Error> {
        let scattering = || media.bodies.iter().filter(|b| b.sigma_s != Vec3::ZERO);
        if scattering().next().is_none() {
            return Ok(None);
        }
        let range = |values: &mut dyn Iterator<Item = f32>| {
            let (from, to) =
                values.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
            Range { from: f64::from(from), to: f64::from(to) }
        };
        let g = range(&mut scattering().map(|b| b.g.clamp(-MOST_G, MOST_G)));
        let albedos = media.bodies.iter().flat_map(|b| {
            let albedo = b.sigma_s / (b.sigma_s + b.sigma_a);
            albedo.to_array().into_iter().filter(|a| a.is_finite())
        });
        let albedo = if any_albedo { Range { from: 0.0, to: 1.0 } } else { range(&mut albedos.into_iter()) };
        let thinnest =
            scattering().map(|b| (b.sigma_s + b.sigma_a).max_element()).fold(f32::INFINITY, f32::min);
        let name = file.map_or_else(|| "the embedded tables".to_owned(), |f| f.display().to_string());
        let unreadable = |e: &dyn std::fmt::Display| Error::Usage(format!("{name}: {e}"));
        let tables = match file {
            None => Tables::embedded().map_err(|e| unreadable(&e))?,
            Some(path) => {
                let bytes = std::fs::read(path).map_err(Error::io(path, "cannot read"))?;
                Tables::from_bytes(bytes).map_err(|e| unreadable(&e))?
            }
        };
        let ten = Orders::Span(1, 10);
        let has_all = |emitter| tables.block(emitter, Part::Rest).is_some();
        let of = |emitter| if has_all(emitter) { Orders::All } else { ten };
        let combined = |emitter, orders| {
            let all = Combined::new(&tables, emitter, orders, g, albedo).map_err(|e| unreadable(&e));
            all.map(|c| c.truncated(order))
        };
        let patch = CombinedPatch::new(&tables, of(Emitter::Area), g, albedo).map_err(|e| unreadable(&e))?;
        Ok(Some(Self {
            lamp: combined(Emitter::Point, of(Emitter::Point))?,
            sun: combined(Emitter::Directional, ten)?,
            patch: patch.truncated(order),
            grey: media.small.grey,
            reach: (MEAN_FREE_PATHS / thinnest).min(2.0 * radius),
            clamped: AtomicU64::new(0),
            grown: AtomicU64::new(0),
        }))
    }

    /// Answers below 0 so far that were taken as 0.
    #[must_use]
    pub fn clamped(&self) -> u64 {
        self.clamped.load(Ordering::Relaxed)
    }

    /// Whether a path's throughput has grown a thousandfold; such paths are counted.
    #[must_use]
    pub fn is_too_much(&self, throughput: Rgb) -> bool {
        let grown = MOST_GAIN < throughput.max_element();
        if grown {
            self.grown.fetch_add(1, Ordering::Relaxed);
        }
        grown
    }

    /// Paths so far that grew too much.
    #[must_use]
    pub fn grown(&self) -> u64 {
        self.grown.load(Ordering::Relaxed)
    }

    /// How far away surfaces are looked for by area, metres.
    #[must_use]
    pub fn reach(&self) -> f32 {
        self.reach
    }

    /// Irradiance by a lamp of 1 cd, `distance` metres away, on a plane whose normal has the cosine `cos` to the way there, lux.
    #[must_use]
    pub fn lamp(&self, air: &Crossing, distance: f32, cos: f32) -> Rgb {
        self.channels(air, |depth, g, albedo| {
            let sigma_t = depth / distance;
            sigma_t * sigma_t * self.lamp.irradiance(depth, g, albedo, cos)
        })
    }

    /// Irradiance by a sun of 1 lux whose direction has the cosine `cos` to the plane's normal, lux.
    #[must_use]
    pub fn sun(&self, air: &Crossing, cos: f32) -> Rgb {
        self.channels(air, |depth, g, albedo| self.sun.irradiance(depth, g, albedo, cos))
    }

    /// Irradiance on a plane with the normal `receiver` by a patch of 1 nit and 1 m^2 that lies `distance` metres away in the
    /// direction `wi` and has the normal `patch`, lux.
    #[must_use]
    pub fn patch(&self, air: &Crossing, distance: f32, wi: Vec3A, receiver: Vec3A, patch: Vec3A) -> Rgb {
        let cos = -wi.dot(patch);
        let z = wi.dot(receiver);
        let across = (patch + wi * cos).normalize_or_zero();
        let x = across.dot(receiver);
        let y = (1.0 - x * x - z * z).max(0.0).sqrt();
        self.channels(air, |depth, g, albedo| {
            let sigma_t = depth / distance;
            sigma_t * sigma_t * self.patch.irradiance(depth, g, albedo, cos, [x, y, z])
        })
    }

    #[inline(always)]
    fn channels(&self, air: &Crossing, of: impl Fn(f32, f32, f32) -> f32) -> Rgb {
        let all = air.scattering.element_sum();
        let g = if air.forward == 0.0 { 0.0 } else { air.forward / all };
        let one = |depth: f32, scattering: f32| {
            if !(0.0 < scattering && depth < MOST_DEPTH) {
                return 0.0;
            }
            let value = of(depth, g, (scattering / depth).min(1.0));
            if value < 0.0 {
                self.clamped.fetch_add(1, Ordering::Relaxed);
            }
            value.max(0.0)
        };
        if self.grey {
            return Vec3::splat(one(air.optical_depth.x, air.scattering.x));
        }
        let (d, s) = (air.optical_depth, air.scattering);
        Vec3::new(one(d.x, s.x), one(d.y, s.y), one(d.z, s.z))
    }
}

/// Between walls a medium without bounds adds light that is not there; where each reflection gains more than it loses, the sum has no
/// limit, and paths end here.
const MOST_GAIN: f32 = 1e3;

/// See [`Responses::reach`]: light of surfaces farther away has been scattered and absorbed so often that it may be noisy.
const MEAN_FREE_PATHS: f32 = 6.0;
