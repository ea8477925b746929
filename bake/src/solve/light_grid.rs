//! Fills the light grid of media ([`crate::transport::light_grid`]).
//!
//! Every node looks around by a few paths. What these bring of lights, by way of surfaces and scattered once, is taken at once; where light was
//! scattered before, a path reaches into the grid, and only one such node, the direction and its weight are kept. These links are a system of
//! linear equations, whose solution has every order of scattering and every exchange with surfaces without another ray. So the grid needs no
//! irradiance cache, and the cache is gathered with the grid's help.
//!
//! What was tried instead, in the rooms of `tests/tests/bounded.rs` (worst deviation of a point):
//!
//! - Gathering the grid anew with what surfaces made of it, four times, in place of links that go by way of surfaces: -5 % between grey
//!   walls in fog of 0.5/m (eight times: -3 %), where the links leave less than 1 %.
//! - Nodes in the plane of walls, which see half of what they should: -10 % (sun through a slab), +11 % (black walls).
//! - Links that keep the noise of their weights: +4 to +37 % in a furnace of sigma_s x size = 10.
//! - Nodes' light scattered with g itself, without the forward peak passing through ([`crate::media::Media::smoothed`]): 8.3 % off in a room with every kind
//!   of light at g = 0.8, sigma_s = 0.6; 5.3 % with it, most of that a lamp's light near the lamp.
//! - One link for all channels of coloured media: +11 % in the channel with sigma_s x size = 10 of a furnace that has 0.3 in another (g = 0.5), by
//!   the noise of weights; -0.2 % with a link for each.
//! - Paths that start at the node itself and not around it: +10 to +13 % at single points with 4096 nodes, by a node a few centimetres from a lamp; 8192
//!   were needed for what 4096 do now, and twice the time.
//! - Lamps' visibility guessed by how many nodes of a cell see them, asked of a ray half the time: errors of texels grew by 5 % in the hall and no time
//!   was saved.
//! - Lamps' light at nodes from places on the rays that are there anyway, in place of rays of its own around the lamps: around a corner, in coloured fog of g = 0.6,
//!   up to +16 % at a single place (the worst of two seeds, 4096 nodes, 32 paths).
//! - As many paths of fewer nodes, or fewer of as many, there (the worst of three seeds): 4096 nodes with 32 paths +10 %, 8192 with 16 +24 %; 8192 with 24 +5 %, and they
//!   take 1.5 times as long as the first.
//! - Russian roulette that begins at a quarter of a node's light, as on other paths, and not at all of it: 1.25 times the time, no less error in the rooms.
//! - Wide emitters along rays, as small ones are: -2 % in a thin furnace, by rare great values; by chance at nodes 0.2 %.

use crate::error::Error;
use crate::geom::World;
use crate::geom::world::{luminance, unpack};
use crate::media::Media;
use crate::plan::settings::Fineness;
use crate::sample::{Sequence, sequence};
use crate::scene::model::Rgb;
use crate::solve::Monitor;
use crate::solve::accumulate::{Gate, Kind, Rejected};
use crate::solve::replay::Replayed;
use crate::transport::Kernel;
use crate::transport::airlight::{Link, Links, in_air};
use crate::transport::lamps::{Patches, Straight};
use crate::transport::light_grid::{COEFFICIENTS, LightGrid, Seen, dot, even, harmonics, scattering};
use glam::{Quat, Vec3, Vec3A};
use rayon::prelude::*;
use std::f32::consts::PI;

/// Random numbers of the grid belong to this domain; see [`sequence::key`].
const DOMAIN: u64 = 0x4c47;

/// What is still missing when the equations count as solved, as a part of the mean.
const SOLVED: f64 = 2e-4;

/// Light that has been scattered and reflected before is not more than this times what has not.
const MOST_GAIN: f64 = 1e3;

/// Most steps towards the solution.
const STEPS: u32 = 400;

/// What mean cosines are multiplied with until there is a solution.
const FORWARD: [f32; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];

/// The numbers of [`Sequence::coins`] by which paths start around their node.
const AROUND: u32 = 6;

/// Steps between two leaps along what changes slowest.
const LEAP: u32 = 8;

/// A grid that is not filled yet.
#[derive(Debug)]
pub struct Gathering {
    grid: LightGrid,
    fineness: Fineness,
    seed: u64,
}

/// What a node found.
#[derive(Default)]
struct Found {
    light: [Rgb; COEFFICIENTS],
    links: Vec<Option<Link>>,
    gate: Gate,
}

impl Gathering {
    /// A dark grid that knows what its nodes see; `None` if nothing scatters.
    #[must_use]
    pub fn new(kernel: &Kernel<'_>, fineness: Fineness, seed: u64) -> Option<Self> {
        let media = kernel.media().filter(|m| m.scatters())?;
        let bounds = around(kernel.world, media.bounds())?;
        let mut grid = LightGrid::new(kernel.world, media.smoothed(), bounds, fineness.nodes);
        let known = LightGrid::looks_at(kernel.air_lights());
        let seen: Vec<Seen> = (0..grid.len())
            .into_par_iter()
            .flat_map_iter(|node| {
                let p = grid.node(node);
                let mut sequence = Sequence::new(sequence::key(seed, DOMAIN ^ 0xffff, node as u64), 0);
                (0..known).map(move |light| kernel.looks(p, light, &mut sequence))
            })
            .collect();
        grid.look(known, &seen);
        let fineness = fineness.for_media(media);
        Some(Self { grid, fineness, seed })
    }

    /// Paths that filling will take.
    #[must_use]
    pub fn paths(&self) -> u64 {
        self.grid.len() as u64 * u64::from(self.fineness.paths)
    }

    /// One path from a node, as [`Gathering::fill`] takes it; `None` where there is none.
    #[must_use]
    pub fn replay(&self, kernel: &Kernel<'_>, node: u32, sample: u32) -> Option<Replayed> {
        let node = Some(node as usize).filter(|n| *n < self.grid.len())?;
        let directions = directions(self.fineness.paths);
        let direction = directions.get(sample as usize)?;
        let kernel = Kernel { grid: Some(&self.grid), media: Some(self.grid.media()), ..*kernel };
        let mut out = Replayed::at(kernel.world, self.grid.node(node), Vec3A::ZERO);
        let path = Path { node, sample, key: self.key(node) };
        let Replayed { rays, around, .. } = &mut out;
        let wi = turn(path.key) * *direction;
        path.follow(&kernel, &self.grid, wi, &mut Links::new(), rays, &mut |wi, light| {
            around.push((wi.into(), light));
        });
        Some(out)
    }

    /// What the random numbers of a node's paths are drawn from.
    fn key(&self, node: usize) -> u64 {
        sequence::key(self.seed, DOMAIN, node as u64)
    }

    /// Fills the grid by paths that `kernel` follows from surface to surface, and says which were not finite.
    ///
    /// # Errors
    ///
    /// [`Error::Interrupted`] when the monitor asks to stop.
    pub fn fill(mut self, kernel: &Kernel<'_>, monitor: &Monitor) -> Result<(LightGrid, Gate), Error> {
        let n = self.fineness.paths;
        let directions = directions(n);
        let suns = kernel.suns_of_air();
        let media = self.grid.media();
        let kernel = Kernel { grid: Some(&self.grid), media: Some(media), ..*kernel };
        let found: Vec<Found> = (0..self.grid.len())
            .into_par_iter()
            .with_max_len(64)
            .map(|node| {
                if monitor.stopped() {
                    return Found::default();
                }
                let (found, rays) = look_around(&kernel, &self.grid, node, &directions, self.key(node));
                monitor.report(&found.gate);
                monitor.add(u64::from(n), rays);
                found
            })
            .collect();
        if monitor.stopped() {
            return Err(Error::Interrupted);
        }
        let gate = found.iter().map(|f| f.gate).fold(Gate::default(), Gate::merge);
        let turns: Vec<Quat> = (0..self.grid.len()).map(|node| turn(self.key(node))).collect();
        let orders = self.fineness.orders;
        let solved =
            FORWARD.iter().find_map(|&f| Some((solve(&found, media, &turns, &directions, f, orders)?, f)));
        // Isotropic scattering alone has a limit, but for light that no surface and no medium ever takes away.
        (self.grid.light, self.grid.forward) =
            solved.unwrap_or_else(|| (found.iter().map(|f| f.light).collect(), 0.0));
        self.grid.summarise(&suns);
        Ok((self.grid, gate))
    }
}

/// Places around each node at which suns and lamps are looked at for [`all_light`].
const PLACES: u32 = 8;

/// Directions in which nodes look for the backs of surfaces.
const LOOKS: u32 = 16;

/// A node that sees so many backs of surfaces is inside of something.
const BACKS: usize = LOOKS as usize / 4;

/// Radiance at nodes; `None` for those inside of solid things.
pub type Nodes = Vec<Option<[Rgb; COEFFICIENTS]>>;

/// What a shader needs to light fog.
#[derive(Clone, Debug)]
pub struct AllLight {
    /// With what suns, lamps and emissive surfaces bring straight away, as far as the game does not add it.
    pub all: Nodes,
    /// Without what suns and lamps bring straight away; `None` where none of them is baked, so that this would be the same.
    pub indirect: Option<Nodes>,
}

/// Radiance at the nodes with what comes straight away. Both sets are of the same rays, so that their difference is what suns and lamps bring and no noise.
#[must_use]
pub fn all_light(kernel: &Kernel<'_>, grid: &LightGrid, seed: u64) -> AllLight {
    let directions = directions(LOOKS);
    let lights = kernel.lights;
    let punctual =
        lights.suns.iter().any(|s| !s.indirect_only) || lights.punctual.iter().any(|l| !l.indirect_only);
    let (all, indirect): (Nodes, Nodes) = (0..grid.len())
        .into_par_iter()
        .map(|node| {
            let backs = |d: &&Vec3A| kernel.meets_back(grid.node(node), **d);
            if BACKS < directions.iter().filter(backs).count() {
                return (None, None);
            }
            let key = sequence::key(seed, DOMAIN ^ 0xff00, node as u64);
            let mut light = *grid.light(node);
            let mut indirect = light;
            for place in 0..PLACES {
                let mut sequence = Sequence::new(key, place);
                let [a, b, c, _] = sequence.next4();
                let p = kernel.near_node(grid, node, [a, b, c], &mut 0);
                let media = Some(grid.media());
                kernel.straight_to(media, Patches::All, p, &mut sequence, &mut 0, |of, lamp, illuminance| {
                    for ((sum, indirect), y) in light.iter_mut().zip(&mut indirect).zip(harmonics(lamp.wi)) {
                        let more = illuminance * (y / PLACES as f32);
                        *sum += more;
                        if of == Straight::Patch {
                            *indirect += more;
                        }
                    }
                });
            }
            (Some(light), punctual.then_some(indirect))
        })
        .unzip();
    AllLight { all, indirect: punctual.then_some(indirect) }
}

/// Where air is asked for its light: around the media, as far as there are surfaces and a little beyond; around the surfaces, where no media are given.
pub(super) fn around(world: &World, media: Option<(Vec3, Vec3)>) -> Option<(Vec3, Vec3)> {
    let scene = world
        .triangles()
        .flatten()
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    let margin = BEYOND * (scene.1 - scene.0).max_element();
    let (min, max) = match media {
        Some((min, max)) => {
            let near = (min.max(scene.0 - margin), max.min(scene.1 + margin));
            // What lies wholly beside the scene is taken as it is.
            if near.0.cmple(near.1).all() { near } else { (min, max) }
        }
        // Over a plane there is air as well.
        None => {
            let thin = (0.5 * (margin - (scene.1 - scene.0))).max(Vec3::ZERO);
            (scene.0 - thin, scene.1 + thin)
        }
    };
    let extent = max - min;
    (extent.is_finite() && 0.0 < extent.max_element()).then_some((min, max))
}

/// Nodes lie outside the scene's bounds by this part of its size at most.
const BEYOND: f32 = 0.25;

/// Directions that cover the sphere evenly: a Fibonacci spiral.
pub(super) fn directions(n: u32) -> Vec<Vec3A> {
    (0..n)
        .map(|i| {
            let z = 1.0 - (2.0 * i as f32 + 1.0) / n as f32;
            let (sin, cos) = (2.0 * PI * (i as f32 * 0.618_034).fract()).sin_cos();
            let r = (1.0 - z * z).max(0.0).sqrt();
            Vec3A::new(r * cos, r * sin, z)
        })
        .collect()
}

/// A rotation for a node, each as likely as any other.
fn turn(key: u64) -> Quat {
    let [u, v, w, _] = Sequence::new(key, u32::MAX >> 1).next4();
    let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
    let ((s, c), (t, d)) = ((2.0 * PI * v).sin_cos(), (2.0 * PI * w).sin_cos());
    Quat::from_xyzw(a * s, a * c, b * t, b * d)
}

/// One path of a node.
#[derive(Clone, Copy)]
struct Path {
    node: usize,
    sample: u32,
    key: u64,
}

impl Path {
    fn name(&self) -> Rejected {
        #[expect(clippy::cast_possible_truncation, reason = "memory holds fewer nodes")]
        let texel = self.node as u32;
        Rejected { page: 0, texel, kind: Kind::Node, sample: self.sample }
    }

    /// Follows it in the direction `wi`; `visit` hears of what arrives, nits times steradian.
    fn follow(
        &self,
        kernel: &Kernel<'_>,
        grid: &LightGrid,
        wi: Vec3A,
        links: &mut Links,
        rays: &mut u32,
        visit: &mut dyn FnMut(Vec3A, Rgb),
    ) {
        let mut sequence = Sequence::hashed(self.key, self.sample);
        let [a, b, c, _] = sequence.coins(AROUND);
        let from = in_air(kernel.near_node(grid, self.node, [a, b, c], rays));
        kernel.lamps_around(&from, &mut sequence, rays, visit);
        let light = kernel.arrives(&from, wi, Some(links), &mut sequence, rays);
        visit(wi, light * (4.0 * PI));
    }
}

fn look_around(
    kernel: &Kernel<'_>,
    grid: &LightGrid,
    node: usize,
    directions: &[Vec3A],
    key: u64,
) -> (Found, u64) {
    let turn = turn(key);
    let channels = kernel.media().map_or(1, Media::channels);
    let links = Vec::with_capacity(channels * directions.len());
    let mut found = Found { links, ..Found::default() };
    let mut rays = 0;
    let (mut weighs, mut should) = (Vec3::ZERO, Vec3::ZERO);
    for (i, d) in (0..).zip(directions) {
        let mut links = Links::new();
        let path = Path { node, sample: i, key };
        let Found { light: sums, gate, .. } = &mut found;
        path.follow(kernel, grid, turn * *d, &mut links, &mut rays, &mut |wi, light| {
            let light = gate.admit(light, path.name());
            for (sum, y) in sums.iter_mut().zip(harmonics(wi)) {
                *sum += light * (y / directions.len() as f32);
            }
        });
        let chosen = &links.chosen()[..channels];
        weighs += chosen.iter().flatten().map(|l| l.weight).sum::<Vec3>();
        should += links.expected;
        found.links.extend_from_slice(chosen);
    }
    // Noise of the weights would make light of its own where it is scattered often: together they weigh what they should.
    let factor = should / weighs;
    for link in found.links.iter_mut().flatten() {
        link.weight = Vec3::select(weighs.cmpgt(Vec3::ZERO), link.weight * factor, link.weight);
    }
    (found, u64::from(rays))
}

/// Light at every node from what all of them found: by steps from node to node, with a leap now and then along what changes slowest.
///
/// Where media are thick and scatter forwards, the noise of few paths can make the directional bands grow from step to step: `None` then, unless `orders` ends
/// it anyway.
/// `forward` multiplies the mean cosine, which makes that less likely.
fn solve(
    found: &[Found],
    media: &Media,
    turns: &[Quat],
    directions: &[Vec3A],
    forward: f32,
    orders: Option<u32>,
) -> Option<Vec<[Rgb; COEFFICIENTS]>> {
    let mut light: Vec<[Rgb; COEFFICIENTS]> = found.iter().map(|f| f.light).collect();
    let share = 4.0 * PI / directions.len() as f32;
    let channels = media.channels();
    let brightness = |l: &[Rgb; COEFFICIENTS]| f64::from(luminance(l[0].abs()));
    let start: f64 = light.iter().map(brightness).sum();
    let mut before = f64::INFINITY;
    for step in 1..=orders.unwrap_or(STEPS) {
        let next: Vec<[Rgb; COEFFICIENTS]> = found
            .par_iter()
            .zip(turns)
            .with_min_len(64)
            .map(|(f, turn)| {
                let mut sum = f.light;
                for (links, d) in f.links.chunks_exact(channels).zip(directions) {
                    let wi = *turn * *d;
                    let mut arrives = Vec3::ZERO;
                    for link in links.iter().flatten() {
                        let from = &light[link.node as usize];
                        let scattered = if media.small().isotropic {
                            even(from)
                        } else {
                            let bands = media.bands(link.g).map(|b| b * forward);
                            dot(from, &scattering(unpack(link.direction), bands))
                        };
                        arrives += link.weight * scattered * share;
                    }
                    for (sum, y) in sum.iter_mut().zip(harmonics(wi)) {
                        *sum += arrives * y;
                    }
                }
                sum
            })
            .collect();
        let all: f64 = next.iter().map(brightness).sum();
        let change: Vec<[Rgb; COEFFICIENTS]> =
            next.iter().zip(&light).map(|(a, b)| std::array::from_fn(|k| a[k] - b[k])).collect();
        let size: f64 = change.iter().map(brightness).sum();
        light = next;
        if !all.is_finite() || MOST_GAIN * start < all {
            return None;
        }
        if size == 0.0 {
            return Some(light);
        }
        // How fast it converges takes two steps to see.
        let slowest = if before == f64::INFINITY { 1.0 } else { size / before };
        before = size;
        let left = slowest / (1.0 - slowest);
        if slowest < 1.0 && size * left < SOLVED * all {
            return Some(light);
        }
        if step % LEAP == 0 && slowest < 0.999 {
            #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
            let left = left as f32;
            for (l, c) in light.iter_mut().zip(&change) {
                l.iter_mut().zip(c).for_each(|(l, c)| *l += *c * left);
            }
            before = f64::INFINITY;
        }
    }
    // Without a limit of orders, light that still changes has none.
    orders.map(|_| light)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The plan states memory without knowing this module.
    #[test]
    fn the_plan_knows_the_size_of_a_link() {
        assert_eq!(size_of::<Option<Link>>() as u64, crate::plan::memory::PER_LINK);
        assert_eq!(size_of::<[Rgb; COEFFICIENTS]>() as u64, crate::plan::memory::PER_NODE);
    }

    #[test]
    fn directions_are_even() {
        for n in [8, 32, 33, 160] {
            let all = directions(n);
            let mut sums = [0.0f32; COEFFICIENTS];
            for d in &all {
                assert!((d.length() - 1.0).abs() < 1e-5);
                sums.iter_mut().zip(harmonics(*d)).for_each(|(s, y)| *s += y / n as f32);
            }
            assert!(sums[1..].iter().all(|s| s.abs() < 0.05), "{n}: {sums:?}");
        }
    }

    /// Two nodes that send each other half of their light: x = 1 + x / 2 has the solution 2, and one that gains has none.
    #[test]
    fn links_are_solved() {
        let directions = directions(32);
        let ring = |weight: f32| -> Vec<Found> {
            (0..2u32)
                .map(|node| {
                    let mut light = [Vec3::ZERO; COEFFICIENTS];
                    light[0] = Vec3::ONE;
                    let link = |d: &Vec3A| Link {
                        node: 1 - node,
                        direction: crate::geom::world::pack(*d),
                        weight: Vec3::splat(weight),
                        g: 0.0,
                    };
                    Found {
                        light,
                        links: directions.iter().map(|d| Some(link(d))).collect(),
                        gate: Gate::default(),
                    }
                })
                .collect()
        };
        let turns = [Quat::IDENTITY; 2];
        let grey = Media::default();
        for (weight, want) in [(0.5, 2.0), (0.9, 10.0), (0.99, 100.0)] {
            let light = solve(&ring(weight), &grey, &turns, &directions, 1.0, None).expect("a solution");
            for l in light {
                assert!((l[0] / want - 1.0).abs().max_element() < 2e-3, "{weight}: {}", l[0]);
            }
        }
        assert!(solve(&ring(1.5), &grey, &turns, &directions, 1.0, None).is_none());
        let once = solve(&ring(0.5), &grey, &turns, &directions, 1.0, Some(1)).expect("one step");
        assert!((once[0][0].x - 1.5).abs() < 1e-3, "{}", once[0][0]);
    }
}
