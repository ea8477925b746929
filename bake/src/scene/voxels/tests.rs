use super::*;
use glam::{IVec3, ivec3, vec3a};

const ENOUGH: usize = 1 << 30;

/// Values that differ from voxel to voxel, some bricks empty, some of one density.
fn value(v: UVec3) -> f32 {
    match (v.x / 8 + v.y / 8 + v.z / 8) % 3 {
        0 => (v.x + 20 * v.y + 400 * v.z) as f32 * 0.25,
        1 => 0.0,
        _ => 3.0,
    }
}

#[test]
fn every_voxel_is_where_it_was_put() {
    for size in [uvec3(1, 1, 1), uvec3(8, 8, 8), uvec3(19, 9, 30), uvec3(1, 70, 2)] {
        let grid = Voxels::from_fn(size, ENOUGH, |v| value(v) + 1.0).expect("a grid");
        assert_eq!(grid.size(), size);
        let mut dense = Vec::new();
        let mut most = 0.0f32;
        for z in 0..size.z {
            for y in 0..size.y {
                for x in 0..size.x {
                    let v = uvec3(x, y, z);
                    let want = value(v) + 1.0;
                    let p = v.as_vec3a();
                    assert_eq!(grid.at(p), want, "the lower corner is inside");
                    assert_eq!(grid.at(p + 0.999), want, "all but the upper one");
                    dense.push(want);
                    most = most.max(want);
                }
            }
        }
        assert_eq!(grid.most(), most);
        assert_eq!(Voxels::dense(size, &dense, ENOUGH).expect("a grid"), grid);
        let s = size.as_vec3a();
        let outside = [
            vec3a(-1e-9, 0.0, 0.0),
            s,
            s * Vec3A::Y,
            vec3a(f32::NAN, 0.0, 0.0),
            Vec3A::INFINITY,
            Vec3A::NEG_INFINITY,
        ];
        assert!(outside.into_iter().all(|p| grid.at(p) == 0.0));
        for (i, cell) in (0..).zip(0..grid.index.len()) {
            let [least, most] = grid.bounds(cell);
            let corner =
                uvec3(i % grid.along.x, i / grid.along.x % grid.along.y, i / grid.along.x / grid.along.y)
                    * SIDE;
            let held: Vec<f32> = (0..512)
                .map(|i| corner + nth(i))
                .filter(|v| v.cmplt(size).all())
                .map(|v| value(v) + 1.0)
                .collect();
            assert_eq!(extremes(&held), [least, most]);
        }
    }
}

#[test]
fn bricks_without_variation_take_no_room() {
    let size = UVec3::splat(64);
    let grid = Voxels::from_fn(size, ENOUGH, value).expect("a grid");
    let third = 512 * 4 * 512 / 3;
    assert!((third..third + 20_000).contains(&grid.memory()), "{}", grid.memory());
    let one = Voxels::from_fn(size, ENOUGH, |_| 2.0).expect("a grid");
    assert!(one.memory() < 4000 && one.bounds.len() == 1, "{}", one.memory());
}

#[test]
fn bad_densities_are_named() {
    let with = |bad: f32| {
        Voxels::from_fn(uvec3(20, 20, 20), ENOUGH, |v| if v == uvec3(17, 3, 9) { bad } else { 1.0 })
    };
    for (bad, said) in [(-0.5, "-0.5"), (f32::NAN, "NaN"), (f32::INFINITY, "inf")] {
        let error = with(bad).expect_err("refused").what;
        assert_eq!(error, format!("voxel [17, 3, 9] has the density {said}"));
    }
    assert!(with(-0.0).is_ok());
    assert!(
        Voxels::dense(uvec3(2, 1, 1), &[0.0, -0.0], ENOUGH).expect_err("empty").what.contains("is empty")
    );
    assert!(Voxels::dense(uvec3(2, 0, 1), &[], ENOUGH).is_err());
    assert!(Voxels::dense(uvec3(2, 2, 1), &[1.0], ENOUGH).is_err());
    let large = Voxels::from_fn(UVec3::splat(1 << 14), 1 << 20, |_| 1.0).expect_err("too large").what;
    assert!(large.contains("32.00 GiB"), "{large}");
    let large = Voxels::from_fn(UVec3::splat(128), 1 << 20, value).expect_err("too large").what;
    assert!(large.contains("needs about 0.00 GiB"), "{large}");
}

/// Grids from bricks are those from values, wherever their first index lies.
#[test]
fn bricks_in_any_order_give_the_same_densities() {
    let size = uvec3(21, 10, 17);
    let whole = Voxels::from_fn(size, ENOUGH, value).expect("a grid");
    for first in [ivec3(0, 0, 0), ivec3(-5, 3, 1_000_001), ivec3(-2_147_483_640, 7, -8)] {
        let mut sparse = Sparse::new(ENOUGH);
        let (from, to): (IVec3, IVec3) = (first >> 3, (first + size.as_ivec3() - 1) >> 3);
        for x in (from.x..=to.x).rev() {
            for y in from.y..=to.y {
                for z in from.z..=to.z {
                    let brick = ivec3(x, y, z);
                    let mut values = [0.0; BRICK];
                    for (i, out) in (0..).zip(&mut values) {
                        let v = (brick - from) * 8 - (first - from * 8) + nth(i).as_ivec3();
                        *out = if v.cmpge(IVec3::ZERO).all() { whole.at(v.as_vec3a()) } else { 0.0 };
                    }
                    sparse.brick(brick, &values).expect("room");
                }
            }
        }
        sparse.hold(first, first);
        sparse.hold(first + size.as_ivec3() - 1, first + size.as_ivec3() - 1);
        let place = |p: glam::I64Vec3| Some(Affine3A::from_translation(p.as_vec3()));
        let grid = sparse.finish(place).expect("a grid");
        assert_eq!(grid.size(), size);
        assert_eq!(grid.place(), Some(Affine3A::from_translation(first.as_vec3())));
        for i in 0..size.element_product() {
            let v = uvec3(i % size.x, i / size.x % size.y, i / size.x / size.y);
            assert_eq!(grid.of(v), whole.of(v), "{first}: {v}");
        }
        assert_eq!(grid.most(), whole.most());
    }
}

#[test]
fn bricks_do_not_overlap() {
    let varied: [f32; BRICK] = std::array::from_fn(|i| i as f32);
    let mut twice = Sparse::new(ENOUGH);
    twice.brick(IVec3::ONE, &varied).expect("room");
    twice.brick(IVec3::ONE, &varied).expect("room");
    assert!(twice.finish(|_| None).expect_err("overlap").what.contains("[8, 8, 8]"));
    let mut within = Sparse::new(ENOUGH);
    within.cube(IVec3::ZERO, 2, 1.0).expect("room");
    within.brick(IVec3::ONE, &varied).expect("room");
    assert!(within.finish(|_| None).is_err());
    assert!(Sparse::new(ENOUGH).finish(|_| None).expect_err("nothing").what.contains("empty"));
    let mut far = Sparse::new(ENOUGH);
    far.hold(IVec3::MIN, IVec3::MIN);
    far.cube(IVec3::splat(268_435_455), 1, 1.0).expect("room");
    assert!(far.finish(|_| None).is_err());
}
