//! Irradiance that was gathered beforehand, at places all over the scene's surfaces.
//!
//! A path that would turn at a surface may end there instead and take the cached value: light of
//! suns and lamps is still found by a shadow ray of its own, so the cache holds the smooth rest, that is
//! emitters, sky and everything that was reflected before. This is the final gather of \[WRC88\] Ward,
//! Rubinstein and Clear, "A Ray Tracing Solution for Diffuse Interreflection", with cells in a hash table
//! (\[BGA20\] Binder, Fricke and Keller, "Massively Parallel Path Space Filtering", sections 3 and 4)
//! in place of their octree. Inside a cell the nearest record counts, and its
//! value stands for the points around it, which is a bias: README states its size. Where rays are short the bias would be seen, so they go on as paths. In
//! cells that surfaces part a record counts only where a ray finds it, so that walls do not leak.

use crate::scene::model::Rgb;
use crate::transport::path::{Kernel, Vertex};
use glam::{Vec3, Vec3A};
use std::collections::HashMap;
use std::ops::Range;

/// Records further off the plane of the place than this part of a cell belong to something else.
const ASIDE: f32 = 0.25;

/// Points of a cell are looked at from this part of its side above them, so that bumps do not part them.
pub const ABOVE: f32 = 0.25;

/// Rays shorter than this many cells do not end at the cache.
const NEAR: f32 = 2.0;

/// Components of a normal beyond this count as towards that axis, so that 26 classes of normals result;
/// a little under tan(22.5 degrees), which would make them equally wide in a plane.
const TOWARDS: f32 = 0.38;

/// Bits of a cell's coordinate along one axis.
const BITS: u32 = 19;

/// A place with the irradiance there.
#[derive(Clone, Copy, Debug)]
pub struct Record {
    /// Metres, relative to the world's origin.
    pub position: Vec3,
    /// How far from there the value holds, metres.
    pub reach: f32,
    /// `E / pi` of everything but suns and lamps straight away, nits.
    pub value: Rgb,
}

/// Places with their irradiance, by cells.
#[derive(Clone, Debug, Default)]
pub struct IrradianceCache {
    /// Side of a cell, metres.
    cell: f32,
    /// Where a cell's records are, and whether surfaces part it.
    index: HashMap<u64, (Range<u32>, bool)>,
    records: Vec<Record>,
}

impl IrradianceCache {
    /// A cache of the given cells: key, number of records, which lie one after the other in `records`, and whether surfaces part the cell.
    #[must_use]
    pub fn new(cell: f32, cells: impl Iterator<Item = (u64, u32, bool)>, records: Vec<Record>) -> Self {
        let mut end = 0;
        let index = cells
            .map(|(key, n, parted)| {
                end += n;
                (key, (end - n..end, parted))
            })
            .collect();
        Self { cell, index, records }
    }

    /// The same places with other values.
    pub fn replace(&mut self, values: &[Rgb]) {
        for (record, value) in self.records.iter_mut().zip(values) {
            record.value = *value;
        }
    }

    /// Which cell a point belongs to, by place and normal.
    #[must_use]
    pub fn key(cell: f32, position: Vec3A, normal: Vec3A) -> u64 {
        let half = (1i64 << (BITS - 1)) as f32;
        let place = (position / cell).floor().clamp(Vec3A::splat(-half), Vec3A::splat(half - 1.0)) + half;
        let class = |x: f32| if TOWARDS < x { 2 } else { u64::from(-TOWARDS <= x) };
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped above")]
        let axis = |x: f32| x as u64;
        let normal = class(normal.x) * 9 + class(normal.y) * 3 + class(normal.z);
        ((normal << BITS | axis(place.x)) << BITS | axis(place.y)) << BITS | axis(place.z)
    }

    /// Shortest ray that may end at the cache, metres.
    #[must_use]
    pub fn near(&self) -> f32 {
        NEAR * self.cell
    }

    /// The nearest record in the cell of a point, or `None` where there is none, and whether surfaces part the cell.
    #[must_use]
    pub fn nearest(&self, at: &Vertex) -> Option<(&Record, bool)> {
        let (range, parted) = self.index.get(&Self::key(self.cell, at.position, at.geometric_normal))?;
        let mut best = (f32::INFINITY, None);
        for r in &self.records[range.start as usize..range.end as usize] {
            let d = r.position.distance_squared(at.position.into());
            if d < best.0 {
                best = (d, Some(r));
            }
        }
        Some((best.1?, *parted))
    }

    /// The nearest record, for tests.
    #[cfg(test)]
    fn lookup(&self, at: &Vertex) -> Option<Rgb> {
        self.nearest(at).map(|(r, _)| r.value)
    }

    /// How far above points others of their cell are looked for, metres.
    #[must_use]
    pub fn above(&self) -> f32 {
        ABOVE * self.cell
    }

    /// Number of cells.
    #[must_use]
    pub fn len(&self) -> usize {
        self.index.len()
    }

    /// Whether there are no cells.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.index.is_empty()
    }
}

impl<const AIR: bool> Kernel<'_, AIR> {
    /// `E / pi` at a point of everything but suns and lamps straight away, nits, if the cache knows it.
    pub(crate) fn cached(&self, at: &Vertex, rays: &mut u32) -> Option<Rgb> {
        let cache = self.cache?;
        let (record, parted) = cache.nearest(at)?;
        let way = Vec3A::from(record.position) - at.position;
        if record.reach * record.reach < way.length_squared() {
            return None;
        }
        if ASIDE * cache.cell < way.dot(at.geometric_normal).abs() {
            return None;
        }
        if parted {
            *rays += 2;
            let up = at.geometric_normal * at.offset.max(cache.above());
            // In a gap lower than that the way would lead along its other side.
            let open = self.closest(&at.ray(at.geometric_normal, cache.above())).is_none();
            if !open || !self.sees(at.position + up, at.position + way + up) {
                return None;
            }
        }
        Some(record.value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::vec3a;

    /// The plan states memory without knowing this module.
    #[test]
    fn the_plan_knows_the_size_of_a_record() {
        assert_eq!(size_of::<Record>() as u64, crate::plan::memory::PER_CACHE_RECORD);
    }

    #[test]
    fn cells_tell_places_and_sides_apart() {
        let k = |p: [f32; 3], n: Vec3A| IrradianceCache::key(0.5, Vec3A::from(p), n);
        let up = Vec3A::Y;
        assert_eq!(k([0.1, 0.2, 0.3], up), k([0.4, 0.45, 0.1], up));
        assert_ne!(k([0.1, 0.2, 0.3], up), k([0.1, 0.2, -0.3], up));
        assert_ne!(k([0.1, 0.2, 0.3], up), k([0.1, 0.2, 0.3], -up));
        assert_ne!(k([0.1, 0.2, 0.3], up), k([0.1, 0.2, 0.3], vec3a(0.6, 0.8, 0.0)));
        // Far outside the range the last cell is used: no overflow into another axis.
        assert_ne!(k([1e30, 0.0, 0.0], up), k([0.0, 1e30, 0.0], up));
    }

    #[test]
    fn a_lookup_finds_its_cell_or_says_so() {
        let at = |x: f32| Vertex {
            position: vec3a(x, 0.0, 0.0),
            geometric_normal: Vec3A::Y,
            shading_normal: Vec3A::Y,
            offset: 0.0,
            open: false,
            detached: false,
        };
        let key = IrradianceCache::key(1.0, vec3a(0.5, 0.0, 0.0), Vec3A::Y);
        let record =
            |x, v| Record { position: Vec3::new(x, 0.0, 0.0), reach: f32::INFINITY, value: Vec3::splat(v) };
        let mut cache = IrradianceCache::new(
            1.0,
            [(key, 2, false)].into_iter(),
            vec![record(0.1, 3.0), record(0.9, 5.0)],
        );
        assert_eq!(cache.lookup(&at(0.4)), Some(Vec3::splat(3.0)));
        assert_eq!(cache.lookup(&at(0.6)), Some(Vec3::splat(5.0)));
        assert_eq!(cache.lookup(&at(7.5)), None);
        cache.replace(&[1.0, 2.0].map(Vec3::splat));
        assert_eq!(cache.lookup(&at(0.6)), Some(Vec3::splat(2.0)));
    }
}
