#![expect(clippy::cast_possible_truncation, reason = "small numbers")]

use super::*;
use crate::scene::voxels::Sparse;
use glam::{IVec3, UVec3, uvec3};

/// Numbers that are the same in every run.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// From 0 to 1.
    fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u32 << 24) as f32
    }

    fn below(&mut self, n: u32) -> u32 {
        (self.next() >> 32) as u32 % n
    }

    fn one_of<T: Copy>(&mut self, list: &[T]) -> T {
        list[self.below(list.len() as u32) as usize]
    }

    /// A coordinate: anywhere, in a face, beside one, far away.
    fn coordinate(&mut self, size: u32) -> f32 {
        let face = self.below(size + 1) as f32;
        match self.below(8) {
            0 | 1 => face,
            2 => face + 0.5,
            3 => face.next_up(),
            4 => face.next_down(),
            5 => (self.unit() - 0.5) * 4e4,
            _ => (self.unit() * 3.0 - 1.0) * size as f32,
        }
    }

    fn component(&mut self) -> f32 {
        match self.below(8) {
            0 => 0.0,
            1 => -0.0,
            2 => 1.0,
            3 => -1.0,
            4 => (self.unit() - 0.5) * 1e-6,
            _ => self.unit() * 2.0 - 1.0,
        }
    }

    fn ray(&mut self, size: UVec3) -> (Vec3A, Vec3A) {
        let origin = size.to_array().map(|n| self.coordinate(n));
        let direction = [0; 3].map(|_| self.component());
        let scale = self.one_of(&[1.0, 0.125, 7.3]);
        (origin.into(), Vec3A::from(direction) * scale)
    }

    /// A grid with bricks that vary, that do not, and that are empty.
    fn grid(&mut self) -> Voxels {
        let size = [0; 3].map(|_| 1 + self.below(20));
        let kinds: Vec<u32> = (0..27).map(|_| self.below(4)).collect();
        let base = self.next();
        Voxels::from_fn(size.into(), usize::MAX, |v| {
            let brick = v / SIDE;
            let mut own = Dice(base ^ u64::from(v.x | v.y << 8 | v.z << 16));
            match kinds[(brick.x + 3 * (brick.y + 3 * brick.z)) as usize] {
                0 => 0.0,
                1 => 2.5,
                2 if own.below(2) == 0 => 0.0,
                2 => 1000.0 * own.unit(),
                _ => own.unit() + 0.01,
            }
        })
        .unwrap_or_else(|_| Voxels::dense(UVec3::ONE, &[1.0], usize::MAX).expect("a voxel"))
    }
}

fn voxels(grid: &Voxels) -> impl Iterator<Item = UVec3> {
    let size = grid.size();
    (0..size.element_product()).map(move |i| uvec3(i % size.x, i / size.x % size.y, i / size.x / size.y))
}

fn density(grid: &Voxels, voxel: UVec3) -> f64 {
    f64::from(grid.at(voxel.as_vec3a() + 0.5))
}

/// Where a ray is in a voxel.
fn clip(voxel: UVec3, o: Vec3A, d: Vec3A, from: f32, to: f32) -> (f64, f64) {
    let (mut t0, mut t1) = (f64::from(from), f64::from(to));
    for axis in 0..3 {
        let (low, high) = (f64::from(voxel[axis]), f64::from(voxel[axis] + 1));
        let (o, d) = (f64::from(o[axis]), f64::from(d[axis]));
        if d == 0.0 {
            if o < low || high <= o {
                return (0.0, 0.0);
            }
            continue;
        }
        let (a, b) = ((low - o) / d, (high - o) / d);
        t0 = t0.max(a.min(b));
        t1 = t1.min(a.max(b));
    }
    (t0, t1.max(t0))
}

/// The integral, voxel by voxel.
fn oracle(grid: &Voxels, o: Vec3A, d: Vec3A, from: f32, to: f32) -> f64 {
    let part = |v| {
        let (t0, t1) = clip(v, o, d, from, to);
        let density = density(grid, v);
        if t0 < t1 && density != 0.0 { density * (t1 - t0) } else { 0.0 }
    };
    voxels(grid).map(part).sum()
}

/// What rounding a distance to f64 is worth.
fn slack(grid: &Voxels, o: Vec3A, d: Vec3A) -> f64 {
    let least = d.abs().to_array().into_iter().filter(|c| 0.0 < *c).fold(f32::INFINITY, f32::min);
    if least == f32::INFINITY {
        return 0.0;
    }
    1e-14 * f64::from(grid.most()) * f64::from((o.abs().max_element() + 64.0) / least)
}

#[test]
fn integrals_are_those_of_all_voxels() {
    let mut dice = Dice(1);
    let mut through = 0;
    for _ in 0..150 {
        let grid = dice.grid();
        for _ in 0..60 {
            let (o, d) = dice.ray(grid.size());
            let from = dice.one_of(&[0.0, 0.0, 3.5]);
            let to = dice.one_of(&[f32::INFINITY, 1e9, 20.0, 4.0]);
            let got = March::new(&grid, o, d).integral(from, to);
            let want = oracle(&grid, o, d, from, to);
            if want == f64::INFINITY {
                assert_eq!(got, f32::INFINITY, "standing still");
                continue;
            }
            through += u32::from(0.0 < want);
            let error = (f64::from(got) - want).abs();
            assert!(
                error <= 1e-6 * want + slack(&grid, o, d),
                "{o} {d} {from} {to} in {grid:?}: {got} {want}"
            );
        }
    }
    assert!(1500 < through, "{through}");
}

#[test]
fn integrals_add_up_and_turn_round() {
    let mut dice = Dice(2);
    for _ in 0..300 {
        let grid = dice.grid();
        for _ in 0..40 {
            let (o, d) = dice.ray(grid.size());
            let (a, b, c) = (2.0 * dice.unit(), 2.0 + 20.0 * dice.unit(), 30.0 + 1e4 * dice.unit());
            let march = March::new(&grid, o, d);
            let (first, second, all) = (march.integral(a, b), march.integral(b, c), march.integral(a, c));
            assert!((first + second - all).abs() <= 3e-7 * all, "{o} {d}: {first} + {second} = {all}");
            assert_eq!(march.integral(b, b), 0.0);
            assert_eq!(march.integral(c, a), 0.0, "backwards");
            // To and fro between places that f32 holds exactly.
            let (o, d) = (
                (o.clamp(Vec3A::splat(-100.0), Vec3A::splat(100.0)) * 64.0).round() / 64.0,
                (d * 16.0).round() / 16.0,
            );
            let there = March::new(&grid, o, d).integral(0.0, 64.0);
            let back = March::new(&grid, o + d * 64.0, -d).integral(0.0, 64.0);
            let error = f64::from((there - back).abs());
            assert!(error <= 3e-7 * f64::from(there) + slack(&grid, o, d), "{o} {d}: {there} {back}");
        }
    }
}

#[test]
fn scaling_is_exact() {
    let mut dice = Dice(3);
    for _ in 0..100 {
        let grid = dice.grid();
        for _ in 0..40 {
            let (o, d) = dice.ray(grid.size());
            let (from, to) = (dice.unit(), 2.0 + 40.0 * dice.unit());
            let once = March::new(&grid, o, d).integral(from, to);
            for k in [1024.0, 1.0 / 4096.0] {
                assert_eq!(March::new(&grid, o, d / k).integral(from * k, to * k), once * k);
            }
        }
    }
}

/// Stretches cover the ray in the box, without gaps, and bound what is in them.
#[test]
fn stretches_bound_what_is_in_them() {
    let mut dice = Dice(4);
    for _ in 0..200 {
        let grid = dice.grid();
        for _ in 0..30 {
            let (o, d) = dice.ray(grid.size());
            let (from, to) = (dice.unit(), 2.0 + 1e5 * dice.unit());
            let march = March::new(&grid, o, d);
            let mut last: Option<(f32, [f32; 2])> = None;
            let (mut low, mut high, mut rounding) = (0.0, 0.0, 0.0);
            march.bricks(from, to, |t0, t1, least, most| {
                assert!(from <= t0 && t0 < t1 && t1 <= to && least <= most);
                if let Some((end, bounds)) = last {
                    assert!(end == t0 && bounds != [least, most]);
                }
                last = Some((t1, [least, most]));
                let part = march.integral(t0, t1);
                let length = t1 - t0;
                // Ends are rounded to f32.
                let slack = grid.most() * (t1.next_up() - t1) + 1e-5 * part;
                rounding += slack;
                assert!(least * length <= part + slack && part <= most * length + slack, "{o} {d} {t0} {t1}");
                (low, high) = (low + least * length, high + most * length);
            });
            let all = march.integral(from, to);
            assert!(low <= all + rounding && all <= high + rounding, "{o} {d}: {low} {all} {high}");
        }
    }
}

#[test]
fn amounts_are_reached_where_the_integral_says() {
    let mut dice = Dice(5);
    let mut reached = 0;
    for _ in 0..200 {
        let grid = dice.grid();
        for _ in 0..30 {
            let (o, d) = dice.ray(grid.size());
            let march = March::new(&grid, o.clamp(Vec3A::splat(-100.0), Vec3A::splat(100.0)), d);
            let (from, to) = (0.0, 300.0);
            let all = march.integral(from, to);
            let amount = all * (0.01 + 1.2 * dice.unit());
            match march.reach(from, to, amount) {
                Some(t) => {
                    reached += 1;
                    // A step of f32 at that distance is worth as much as this.
                    let step = grid.most() * (t.next_up() - t);
                    assert!((march.integral(from, t) - amount).abs() <= 1e-5 * amount + step, "{o} {d}");
                }
                None => assert!(all <= amount),
            }
        }
    }
    assert!(1000 < reached, "{reached}");
}

/// Rays in faces and edges are on one side, rays through nothing are nothing.
#[test]
fn grazing_rays_are_in_one_voxel() {
    let grid = Voxels::from_fn(uvec3(9, 9, 9), usize::MAX, |v| [1.0, 4.0][((v.x + v.y + v.z) % 2) as usize])
        .expect("a grid");
    let along = |o: [f32; 3], d: [f32; 3]| March::new(&grid, o.into(), d.into()).integral(0.0, f32::INFINITY);
    for zero in [0.0, -0.0] {
        assert_eq!(along([8.0, 2.0, -3.0], [zero, -zero, 1.0]), 5.0 + 16.0, "an edge between bricks");
        assert_eq!(along([0.0, 0.0, -3.0], [zero, zero, 1.0]), 5.0 + 16.0, "the lower edge of the box");
        assert_eq!(along([9.0, 2.0, -3.0], [zero, zero, 1.0]), 0.0, "the upper face of the box");
        assert_eq!(along([-0.0, 4.5, 4.5], [zero, 1.0, zero]), 4.5 * 2.5 - 0.5 * 0.5 * 3.0);
    }
    assert_eq!(along([0.0; 3], [1.0; 3]), 5.0 + 16.0);
    assert_eq!(along([9.0; 3], [-1.0; 3]), along([0.0; 3], [1.0; 3]), "through corners");
    assert_eq!(along([9.0, 4.5, 4.5], [1.0, 0.0, 0.0]), 0.0, "away from the border");
    assert_eq!(along([4.5; 3], [0.0; 3]), f32::INFINITY, "standing still for ever");
    assert_eq!(March::new(&grid, Vec3A::splat(4.5), Vec3A::ZERO).integral(0.0, 2.0), 2.0, "standing still");
    assert_eq!(along([-1.0; 3], [0.0; 3]), 0.0);
    for o in [f32::NAN, f32::INFINITY, 1e30, -1e30, f32::MAX] {
        for d in [1.0, -1.0, 1e-38, 1e38, 1e-45, f32::NAN, f32::INFINITY] {
            for at in [[o, 4.5, 4.5], [4.5, o, o]] {
                for to in [[d, 0.0, 0.0], [d, d, 1.0], [d, -d, d]] {
                    let v = along(at, to);
                    assert!((0.0..1e30).contains(&v), "{at:?} {to:?}: {v}");
                    March::new(&grid, at.into(), to.into())
                        .bricks(0.0, f32::INFINITY, |a, b, _, _| assert!(a < b));
                }
            }
        }
    }
    // Far away, and slowly.
    assert_eq!(along([-1e6, 2.5, 3.5], [1.0, 0.0, 0.0]), 5.0 * 4.0 + 4.0);
    assert_eq!(along([-1e7, 2.5, 3.5], [1.0 / 1024.0, 0.0, 0.0]), 24.0 * 1024.0);
}

/// Rays do not see where bricks begin.
#[test]
fn grids_from_bricks_are_grids() {
    let mut dice = Dice(7);
    let values: Vec<f32> = (0..BRICK).map(|_| dice.unit()).collect();
    let values: &[f32; BRICK] = values.first_chunk().expect("a brick");
    let mut sparse = Sparse::new(usize::MAX);
    sparse.brick(IVec3::new(-1, 4, 7), values).expect("room");
    sparse.cube(IVec3::new(0, 5, 8), 2, 0.5).expect("room");
    sparse.hold(IVec3::new(-11, 31, 50), IVec3::new(20, 60, 90));
    let grid = sparse.finish(|_| None).expect("a grid");
    assert_ne!(grid.margin(), UVec3::ZERO);
    for _ in 0..2000 {
        let (o, d) = dice.ray(grid.size());
        let (got, want) = (March::new(&grid, o, d).integral(0.0, 1e9), oracle(&grid, o, d, 0.0, 1e9));
        assert!((f64::from(got) - want).abs() <= 1e-6 * want + slack(&grid, o, d), "{o} {d}: {got} {want}");
    }
}
