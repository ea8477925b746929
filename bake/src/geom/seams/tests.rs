use super::*;
use crate::geom::atlas::testing::{bare, quad, scene, sheet, sphere};
use crate::geom::atlas::{AtlasOptions, Density, build};
use crate::geom::bvh::Opacity;
use crate::scene::model::Mesh;
use glam::{Affine3A, Quat};
use std::f32::consts::FRAC_PI_2;

fn found(scene: &Scene) -> (World, Atlas, Seams) {
    let world = World::new(scene);
    let options = AtlasOptions { density: Density::Fixed(8.0), ..AtlasOptions::default() };
    let (atlas, _) = build(scene, &options, &|_, _| true).expect("an atlas");
    let seams = Seams::find(scene, &world, &atlas);
    (world, atlas, seams)
}

/// Lengths of the seams between each pair of surfaces, metres.
fn length(world: &World, seams: &Seams, a: usize, b: usize) -> f32 {
    let of = |s: &&Seam| s.triangles.map(|t| world.surface(t)) == [a, b];
    seams.list.iter().filter(of).map(|s| s.length(world)).sum()
}

fn at(x: f32, y: f32, z: f32) -> Affine3A {
    Affine3A::from_translation(Vec3::new(x, y, z))
}

#[test]
fn floors_that_touch_have_a_seam_and_walls_have_none() {
    // `quad` lies in the plane y = 0 with its normal down.
    let wall = Affine3A::from_rotation_translation(Quat::from_rotation_z(FRAC_PI_2), Vec3::ZERO);
    let scene = scene(vec![
        (bare(quad(2.0, 3.0)), vec![at(0.0, 0.0, 0.0), at(2.0, 0.0, 0.0), at(4.01, 0.0, 0.0), wall]),
        (bare(quad(2.0, 1.0)), vec![at(2.0, 0.0, 3.0), at(0.0, 0.0, 3.5)]),
    ]);
    let (world, _, seams) = found(&scene);
    assert!((length(&world, &seams, 0, 1) - 3.0).abs() < 1e-5);
    // A gap of a centimetre is more than a twentieth of a texel.
    assert_eq!(length(&world, &seams, 1, 2), 0.0);
    assert_eq!(length(&world, &seams, 0, 3), 0.0, "a corner");
    assert!((length(&world, &seams, 1, 4) - 2.0).abs() < 1e-5);
    // Half of the edge from z = 3 to 4 lies beside the one from 3.5 to 4.5.
    assert!((length(&world, &seams, 4, 5) - 0.5).abs() < 1e-5);
    assert_eq!(length(&world, &seams, 0, 5), 0.0);
}

#[test]
fn both_sides_of_a_seam_are_the_same_place_of_the_world() {
    let long = bare(quad(4.0, 1.0));
    let short = bare(sheet(3, 2, |u, v| Vec3::new(u * 4.0, 0.0, v - 1.0)));
    let scene = scene(vec![(long, vec![Affine3A::IDENTITY]), (short, vec![Affine3A::IDENTITY])]);
    let (world, atlas, seams) = found(&scene);
    // A long edge and three short ones that end in its middle.
    assert_eq!(seams.list.len(), 3);
    assert!((length(&world, &seams, 0, 1) - 4.0).abs() < 1e-5);
    for seam in &seams.list {
        for t in [0.0, 0.3, 1.0] {
            let [p, q] = [0, 1].map(|side| {
                let weights = weights(seam.edges[side], seam.along(side, t));
                world.point(seam.triangles[side], weights).position
            });
            assert!(p.distance(q) < 1e-5, "{p} {q}");
            let [p, q] = [0, 1].map(|side| seam.place(&world, &atlas, side, t));
            assert!(p.page == q.page && 1.0 < p.at.distance(q.at), "{p:?} {q:?}");
        }
        assert!(seam.aligned);
    }
}

fn smooth(mut mesh: Mesh) -> Mesh {
    mesh.normals = mesh.positions.iter().map(|p| p.normalize()).collect();
    mesh
}

#[test]
fn a_smooth_sphere_is_cut_and_a_flat_one_falls_apart() {
    let (world, atlas, seams) = found(&scene(vec![(smooth(sphere(12)), vec![Affine3A::IDENTITY])]));
    let cut: f32 = seams.list.iter().map(|s| s.length(&world)).sum();
    // Every border of a closed surface has its other side.
    let border: f32 = borders(&world, &atlas).iter().map(|e| e.ends[0].distance(e.ends[1])).sum();
    assert!(1.0 < cut && (2.0 * cut - border).abs() < 1e-3 * border, "{cut} of {border}");
    // Without normals it has corners, but for the facets around the poles.
    let (world, _, flat) = found(&scene(vec![(sphere(12), vec![Affine3A::IDENTITY])]));
    for seam in &flat.list {
        let [a, b] = seam.triangles.map(|t| world.geometric_normal(t));
        assert!(MOST_TURN.to_radians().cos() <= a.dot(b), "{seam:?}");
    }
    let left: f32 = flat.list.iter().map(|s| s.length(&world)).sum();
    assert!(left < 0.5 * cut, "{left} of {cut}");
}

#[test]
fn backs_go_on_only_where_there_are_two_sides() {
    let turned = Affine3A::from_rotation_translation(
        Quat::from_rotation_z(std::f32::consts::PI),
        Vec3::new(4.0, 0.0, 0.0),
    );
    let mut scene = scene(vec![(bare(quad(2.0, 3.0)), vec![Affine3A::IDENTITY, turned])]);
    assert_eq!(found(&scene).2.list, []);
    scene.materials[0].double_sided = true;
    let list = found(&scene).2.list;
    assert!(list.len() == 1 && !list[0].aligned, "{list:?}");
    // Sheets on one another have no seam with each other.
    scene.surfaces[1].world_from_mesh = Affine3A::IDENTITY;
    assert_eq!(found(&scene).2.list, []);
}

/// Many copies on both sides of an edge are joined, and not each with each.
#[test]
fn copies_are_not_joined_each_with_each() {
    const COPIES: usize = 400;
    let places = [vec![Affine3A::IDENTITY; COPIES], vec![at(2.0, 0.0, 0.0); COPIES]].concat();
    let (world, _, seams) = found(&scene(vec![(bare(quad(2.0, 3.0)), places)]));
    let mut partners = vec![0; 2 * COPIES];
    for seam in &seams.list {
        seam.triangles.iter().for_each(|&t| partners[world.surface(t)] += 1);
    }
    assert!(seams.list.len() <= DEEP * 2 * COPIES, "{}", seams.list.len());
    let lonely = partners.iter().filter(|n| **n == 0).count();
    assert!(lonely < COPIES / 20, "{lonely} of {COPIES} copies have no seam");
}

#[test]
fn a_wall_on_a_seam_closes_it() {
    let wall = Affine3A::from_rotation_translation(Quat::from_rotation_z(-FRAC_PI_2), Vec3::X * 2.0);
    let mut scene = scene(vec![(bare(quad(2.0, 3.0)), vec![Affine3A::IDENTITY, at(2.0, 0.0, 0.0)])]);
    // The floor's front is below it.
    let open = |scene: &Scene| {
        let (world, atlas, seams) = found(scene);
        let bvh = Bvh::build(&world, |_| Some(Opacity::Opaque)).expect("a tree");
        let floor = |s: &&Seam| s.triangles.map(|t| world.surface(t)) == [0, 1];
        let seam = seams.list.iter().find(floor).expect("a seam");
        [0.1, 0.9].map(|t| seam.is_open(&world, &atlas, &bvh, t, [false; 2]))
    };
    assert_eq!(open(&scene), [true, true]);
    scene.surfaces.push(scene.surfaces[0].clone());
    scene.surfaces[2].world_from_mesh = wall;
    assert_eq!(open(&scene), [false, false]);
}

#[test]
fn lengths_times_a_power_of_two_change_nothing() {
    let make = |s: f32| {
        let mut scene = scene(vec![
            (smooth(sphere(7)), vec![Affine3A::from_scale(Vec3::splat(s))]),
            (bare(quad(2.0, 3.0)), vec![Affine3A::from_scale(Vec3::splat(s))]),
            (bare(quad(2.0, 1.0)), vec![at(s, 0.0, 3.0 * s) * Affine3A::from_scale(Vec3::splat(s))]),
        ]);
        scene.materials[0].double_sided = true;
        let world = World::new(&scene);
        let options = AtlasOptions { density: Density::Fixed(8.0 / s), ..AtlasOptions::default() };
        let (atlas, _) = build(&scene, &options, &|_, _| true).expect("an atlas");
        Seams::find(&scene, &world, &atlas)
    };
    let one = make(1.0);
    assert!(10 < one.list.len());
    assert_eq!(one, make(1024.0));
    assert_eq!(one, make(2f32.powi(-12)));
}
