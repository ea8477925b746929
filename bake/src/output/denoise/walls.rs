//! Which texels something opaque stands between.

use super::places::{Places, Spot};
use crate::geom::bvh::Bvh;
use crate::geom::ray::{Ray, offset_distance};
use crate::sample::warp::Frame;
use glam::{Vec3, Vec3A};
use rayon::prelude::*;
use std::f32::consts::TAU;

/// How far above the surface a wall counts that parts texels, texels: as with seams.
const ABOVE: f32 = 0.5;

/// Directions in which a texel looks for walls. What is narrower than the gaps between them, 3 texels at a distance of 8, may be missed.
const SECTORS: usize = 16;

/// How far texels look, texels.
const REACH: u8 = 8;

/// Places along each axis of a texel's surroundings.
const SIDE: usize = 2 * REACH as usize + 1;

const WORDS: usize = (SIDE * SIDE).div_ceil(64);

/// The surroundings of a texel in its own plane, a bit for each square of a texel: set where something stands before one of the
/// texels there. Its size does not depend on how many there are.
type Mask = [u64; WORDS];

/// What each place knows of walls around it.
#[derive(Debug, Default)]
pub(super) struct Walls {
    /// Empty where there is no wall at all.
    masks: Vec<Option<Box<Mask>>>,
}

impl Walls {
    /// Finds the walls between places of a world of the given radius that are `reach` texels apart at most.
    ///
    /// A pair is free if it ends before what either of them sees on both sides of the way to the other. A ray decides for the rest,
    /// most of which lie along walls.
    pub(super) fn find(places: &Places<'_>, bvh: &Bvh, reach: f32, radius: f32) -> Self {
        debug_assert!(reach <= f32::from(REACH), "surroundings are smaller");
        let spots = places.spots();
        let over =
            |s: &Spot| Vec3A::from(s.position + s.normal * (ABOVE / s.density).max(offset_distance(radius)));
        // How far it is to what stands around a place, in each sector; none where there is nothing.
        let seen: Vec<Option<Box<[f32; SECTORS]>>> = spots
            .par_iter()
            .map(|spot| {
                let (origin, frame) = (over(spot), Frame::new(spot.normal.into()));
                let mut found = None;
                for sector in (0..SECTORS).filter(|_| !places.stopped()) {
                    let (sin, cos) = (sector as f32 / SECTORS as f32 * TAU).sin_cos();
                    let direction = frame.x * cos + frame.y * sin;
                    if let Some(hit) =
                        bvh.closest(&Ray { origin, direction, t_max: reach / spot.density }, |_| false)
                    {
                        found.get_or_insert_with(|| Box::new([f32::INFINITY; SECTORS]))[sector] = hit.t;
                    }
                }
                found
            })
            .collect();
        if seen.iter().all(Option::is_none) {
            return Self::default();
        }
        let free = |i: usize, way: Vec3| {
            let Some(seen) = &seen[i] else { return true };
            let frame = Frame::new(spots[i].normal.into());
            let way = Vec3A::from(way);
            let turn = way.dot(frame.y).atan2(way.dot(frame.x)) / TAU;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a sector")]
            let sector = (turn.rem_euclid(1.0) * SECTORS as f32) as usize % SECTORS;
            way.length() < seen[sector].min(seen[(sector + 1) % SECTORS])
        };
        let masks = places.map(|i, near| {
            let mut mask = None;
            if seen[i].is_none() {
                return mask;
            }
            near.each(i, reach, |j, _, _| {
                let way = spots[j].position - spots[i].position;
                if free(i, way) || free(j, -way) {
                    return;
                }
                // The same ray from whichever side it is asked for.
                let [a, b] = [i.min(j), i.max(j)].map(|k| over(&spots[k]));
                let ray = Ray { origin: a, direction: (b - a).normalize_or_zero(), t_max: (b - a).length() };
                if bvh.occluded(&ray, |_| false) {
                    let at = square(&spots[i], &spots[j]);
                    mask.get_or_insert_with(|| Box::new([0; WORDS]))[at / 64] |= 1 << (at % 64);
                }
            });
            mask
        });
        if masks.iter().all(Option::is_none) { Self::default() } else { Self { masks } }
    }

    /// Whether something stands between two places, the same from either side.
    #[inline]
    pub(super) fn part(&self, (i, a): (usize, &Spot), (j, b): (usize, &Spot)) -> bool {
        self.blocks(i, a, b) || self.blocks(j, b, a)
    }

    #[inline]
    fn blocks(&self, i: usize, a: &Spot, b: &Spot) -> bool {
        self.masks.get(i).and_then(Option::as_ref).is_some_and(|mask| {
            let at = square(a, b);
            mask[at / 64] >> (at % 64) & 1 != 0
        })
    }
}

/// The square of `b` in the surroundings of `a`.
fn square(a: &Spot, b: &Spot) -> usize {
    let frame = Frame::new(a.normal.into());
    let way = Vec3A::from(b.position - a.position) * (a.density * b.density).sqrt();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the surroundings"
    )]
    let along = |axis: Vec3A| {
        let reach = f32::from(REACH);
        (way.dot(axis).round().clamp(-reach, reach) + reach) as usize
    };
    along(frame.y) * SIDE + along(frame.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::World;
    use crate::geom::bvh::Opacity;

    #[test]
    fn the_plan_knows_the_size_of_surroundings() {
        let bytes = size_of::<Option<Box<Mask>>>() + size_of::<Mask>();
        assert_eq!(
            bytes.next_multiple_of(16) + 8,
            usize::try_from(crate::plan::memory::PER_WALLED).expect("small")
        );
    }

    /// A wall stands on a floor, between the second and the third texel; past its end nothing parts them.
    #[test]
    fn walls_part_what_runs_through_below_them() {
        let corners = [(-20.0, -1.0), (0.0, -1.0), (0.0, 2.0), (-20.0, 2.0)];
        let [a, b, c, d] = corners.map(|(z, y)| Vec3::new(2.0, y, z));
        let world = World::of_triangles(vec![[a, b, c], [a, c, d]]);
        let bvh = Bvh::build(&world, |_| Some(Opacity::Opaque)).expect("builds");
        let spots: Vec<(Vec3, Vec3)> = [-4.0f32, 8.0]
            .into_iter()
            .flat_map(|z| (0u8..4).map(move |x| (Vec3::new(f32::from(x) + 0.5, 0.0, z), Vec3::Y)))
            .map(|(p, n)| (p - world.origin, n))
            .collect();
        let reach = f32::from(REACH);
        let mut places = Places::at(&spots, reach);
        places.walls = Walls::find(&places, &bvh, reach, world.radius);
        let lists = places.map(|i, near| {
            let mut list = Vec::new();
            near.each(i, 3.0, |j, _, _| list.push(places.texels[j]));
            list.sort_unstable();
            list
        });
        for (i, list) in places.texels.iter().copied().zip(lists) {
            let [row, x] = [i / 4, i % 4];
            let all = (4 * row..4 * row + 4).filter(|j| *j != i && i.abs_diff(*j) < 3);
            let want: Vec<u32> = all.filter(|j| row == 1 || (x < 2) == (j % 4 < 2)).collect();
            assert_eq!(list, want, "of {i}");
        }
    }
}
