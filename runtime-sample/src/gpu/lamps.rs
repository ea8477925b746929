//! Shadow maps of suns and lamps. Nothing that casts a shadow moves, so they are drawn once.

use std::f32::consts::FRAC_PI_2;

use glam::{
    Mat4, Vec3,
    camera::rh::{proj::directx as proj, view},
};

use super::uniforms::local;
use crate::files::bake::{Bake, Kind, Lamp};

/// Layers of all maps together, at most.
const MOST_LAYERS: usize = 60;

/// Lamps that can be added to fog: as many as fit when all of them shine all around.
pub(crate) const MOST_LAMPS: usize = MOST_LAYERS / 6;

/// Spots whose half angle is wider, radians, have cubes.
const WIDEST: f32 = 1.2;

/// Where a lamp's map is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Shadow {
    /// Its first layer.
    pub(super) layer: usize,
    /// Whether it has six, the faces of a cube.
    pub(super) cube: bool,
    /// How wide its texels are: metres, and for each metre from the lamp.
    pub(super) texel: [f32; 2],
}

/// The maps of a bake.
#[derive(Debug, Default)]
pub(super) struct Plan {
    /// Of each lamp; none where it needs none or there is no room, and then it is dark.
    pub(super) shadows: Vec<Option<Shadow>>,
    /// World to clip space, layer by layer; depth is 1 near and 0 far away.
    pub(super) clip_from_world: Vec<Mat4>,
}

impl Plan {
    /// Maps of the lamps that are `needed`.
    pub(super) fn new(bake: &Bake, needed: impl Fn(&Lamp) -> bool) -> Self {
        let mut plan = Self::default();
        for lamp in &bake.lamps {
            let views = if needed(lamp) { views(lamp, bake) } else { Vec::new() };
            let layer = plan.clip_from_world.len();
            let fits = !views.is_empty() && layer + views.len() <= MOST_LAYERS;
            plan.shadows.push(fits.then_some(Shadow { layer, cube: views.len() == 6, texel: [0.0; 2] }));
            if fits {
                plan.clip_from_world.extend(views);
            }
        }
        let side = plan.side() as f32;
        for (shadow, lamp) in plan.shadows.iter_mut().zip(&bake.lamps) {
            let Some(shadow) = shadow else { continue };
            shadow.texel = match lamp.kind {
                Kind::Sun => [2.0 * bake.scene.radius / side, 0.0],
                Kind::Spot if !shadow.cube => [0.0, 2.0 * (WIDER * lamp.cone[1]).tan() / side],
                // Cubes see 45 degrees to each side.
                Kind::Point | Kind::Spot => [0.0, 2.0 / side],
            };
        }
        plan
    }

    /// Texels along the sides of each layer.
    pub(super) fn side(&self) -> u32 {
        match self.clip_from_world.len() {
            0 => 1,
            1..=4 => 2048,
            5..=16 => 1024,
            _ => 512,
        }
    }
}

/// Maps of spots are a little wider than their cones.
const WIDER: f32 = 1.01;

/// What a lamp sees: six faces of a cube, a cone, or all of the scene.
fn views(lamp: &Lamp, bake: &Bake) -> Vec<Mat4> {
    let radius = bake.scene.radius;
    let at = local(lamp.position, bake);
    let side = |d: Vec3| if d.y.abs() < 0.99 { Vec3::Y } else { Vec3::X };
    let far = lamp.range.unwrap_or(f32::INFINITY).min(at.length() + radius).max(f32::MIN_POSITIVE);
    // As near as the lamp's own shade; depth is 1 there and 0 far away, where floats are finest.
    let near = 1e-5 * far;
    let looking =
        |d: Vec3, angle: f32| proj::perspective(angle, 1.0, far, near) * view::look_to_mat4(at, d, side(d));
    match lamp.kind {
        Kind::Spot if lamp.cone[1] < WIDEST => vec![looking(lamp.direction, 2.0 * WIDER * lamp.cone[1])],
        Kind::Point | Kind::Spot => {
            Vec3::AXES.into_iter().flat_map(|a| [a, -a]).map(|d| looking(d, FRAC_PI_2)).collect()
        }
        Kind::Sun => {
            let d = lamp.direction;
            let seen = view::look_to_mat4(-d * radius, d, side(d));
            vec![proj::orthographic(-radius, radius, -radius, radius, 2.0 * radius, 0.0) * seen]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lamp(kind: Kind) -> Lamp {
        Lamp {
            kind,
            position: Vec3::new(1.0, 2.0, 3.0),
            direction: Vec3::NEG_Y,
            intensity: Vec3::ONE,
            range: None,
            cone: [0.2, 0.6],
            baked: true,
        }
    }

    fn bake(lamps: Vec<Lamp>) -> Bake {
        let mut bake = Bake::empty();
        (bake.scene.radius, bake.lamps) = (10.0, lamps);
        bake
    }

    #[test]
    fn maps_cover_what_their_lamps_see() {
        let bake = bake(vec![lamp(Kind::Point), lamp(Kind::Spot), lamp(Kind::Sun)]);
        let plan = Plan::new(&bake, |_| true);
        assert_eq!(
            plan.shadows.iter().map(|s| s.map(|s| s.layer)).collect::<Vec<_>>(),
            [Some(0), Some(6), Some(7)]
        );
        let inside = |layer: usize, p: Vec3| {
            let q = plan.clip_from_world[layer].project_point3(p);
            q.abs().max_element() <= 1.0 && 0.0 <= q.z
        };
        // Faces in the order that the shader looks for them.
        for (i, d) in Vec3::AXES.into_iter().flat_map(|a| [a, -a]).enumerate() {
            for layer in 0..6 {
                assert_eq!(inside(layer, Vec3::new(1.0, 2.0, 3.0) + d * 2.0), layer == i, "{layer} {d}");
            }
        }
        assert!(inside(6, Vec3::new(1.5, 0.0, 3.0)) && !inside(6, Vec3::new(4.0, 0.0, 3.0)));
        assert!(inside(7, Vec3::new(5.0, -6.0, 5.0)));
        let mut wide = lamp(Kind::Spot);
        wide.cone = [1.0, 1.5];
        let plan = Plan::new(&self::bake(vec![wide]), |_| true);
        assert_eq!(plan.shadows, [Some(Shadow { layer: 0, cube: true, texel: [0.0, 2.0 / 1024.0] })]);
    }

    #[test]
    fn lamps_without_room_have_no_map() {
        let bake = bake(vec![lamp(Kind::Point); 12]);
        let plan = Plan::new(&bake, |_| true);
        assert_eq!(plan.shadows.iter().flatten().count(), MOST_LAMPS);
        assert!(Plan::new(&bake, |_| false).clip_from_world.is_empty());
    }
}
