//! What shaders are told: the structures of `shaders/view.wgsl`, field by field.

use bytemuck::{Pod, Zeroable};
use glam::{Affine3A, Quat, Vec2, Vec3};
use tables::format::manifest::Sky;

use super::{lamps::Shadow, uploaded::Uploaded};
use crate::{
    files::{
        bake::{Bake, Kind, Lamp},
        volume::Medium,
    },
    view::{camera::Pose, look::Look},
};

/// Everything about one picture.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub(super) struct ViewUniform {
    clip_from_world: [[f32; 4]; 4],
    eye: [f32; 4],
    right: [f32; 4],
    up: [f32; 4],
    forward: [f32; 4],
    zenith: [f32; 4],
    horizon: [f32; 4],
    ground: [f32; 4],
    sky_turn: [f32; 4],
    mean_light: [f32; 4],
    grid_first: [f32; 4],
    grid_per_metre: [f32; 4],
    grid_size: [u32; 4],
    probe_origin: [f32; 4],
    probe_size: [u32; 4],
    probe_offsets: [u32; 4],
    froxels: [u32; 4],
    slices: [f32; 4],
    switches: [u32; 4],
    tone: [f32; 4],
    size: [f32; 4],
}

/// A lamp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub(super) struct LampUniform {
    position: [f32; 4],
    direction: [f32; 4],
    intensity: [f32; 4],
    cone: [f32; 4],
    texel: [f32; 4],
}

/// A medium.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub(super) struct MediumUniform {
    sigma_s: [f32; 4],
    sigma_a: [f32; 4],
    cube: [[f32; 4]; 3],
    texture: [[f32; 4]; 3],
    height: [f32; 4],
    size: [u32; 4],
    first: [u32; 4],
}

/// A material.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub(super) struct MaterialUniform {
    pub(super) base: [f32; 4],
    pub(super) glow: [f32; 4],
    pub(super) other: [f32; 4],
}

/// How a picture is cut into froxels and shown.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shot {
    /// Pixels.
    pub(crate) size: [u32; 2],
    /// Froxels along x, y and z.
    pub(crate) froxels: [u32; 3],
    /// Where in a pixel it is looked at, from its middle, and where in a froxel's depth, 0 to 1.
    pub(crate) shift: Vec2,
    pub(crate) depth: f32,
    /// By what part of a froxel froxels are shifted.
    pub(crate) froxel_shift: Vec2,
    /// Whether the last pass encodes as sRGB; else the picture is linear.
    pub(crate) encode: bool,
    /// Whether the last pass leaves out the tone curve: nits.
    pub(crate) radiance: bool,
}

/// The first slice of fog ends at about this part of the way to the last.
const FIRST_SLICE: f32 = 1e-2;

fn wide(v: Vec3, w: f32) -> [f32; 4] {
    v.extend(w).to_array()
}

impl ViewUniform {
    pub(super) fn new(on_card: &Uploaded, bake: &Bake, pose: &Pose, look: &Look, shot: &Shot) -> Self {
        let [w, h] = shot.size.map(|n| n as f32);
        let extent = pose.extent(w / h);
        let [right, up, forward] = pose.axes();
        let eye = (pose.eye - bake.scene.origin).as_vec3();
        let far = (eye.length() + on_card.radius).max(f32::MIN_POSITIVE);
        // Depth is 1 there and falls with the distance, so that nothing is lost by being near.
        let near = (1e-5 * bake.scene.radius).max(f32::MIN_POSITIVE);
        let shift = shot.shift * Vec2::new(2.0 / w, -2.0 / h);
        let mut u = Self {
            clip_from_world: extent.clip_from_world([right, up, forward], eye, [near, far], shift),
            eye: wide(eye, if extent.flat { 1.0 } else { 0.0 }),
            right: wide(right * extent.half.x, shot.froxel_shift.x),
            up: wide(up * extent.half.y, shot.froxel_shift.y),
            forward: wide(forward, far),
            sky_turn: [0.0, 0.0, 0.0, 1.0],
            mean_light: wide(bake.mean_light(), f32::from(u8::from(bake.probes.is_some()))),
            ..Self::default()
        };
        u.sky(&bake.manifest.sky, bake.sky.is_some());
        if let Some(g) = bake.grid.as_ref().filter(|_| on_card.has_grid) {
            u.grid_first = wide(local(g.first, bake), 0.0);
            u.grid_per_metre = wide(g.cell.recip(), 1.0);
            u.grid_size = [g.size[0], g.size[1], g.size[2], g.slices];
        }
        if let Some(p) = &bake.probes {
            let l = &p.lattice;
            u.probe_origin = wide(local(l.origin.into(), bake), l.spacing);
            u.probe_size = [l.size[0], l.size[1], l.size[2], 0];
            u.probe_offsets = [on_card.probe_offsets[0], on_card.probe_offsets[1], 0, 0];
        } else {
            u.probe_origin = [0.0, 0.0, 0.0, 0.01 * bake.scene.radius];
        }
        let media = u32::try_from(bake.media.all.len()).unwrap_or(0);
        let [x, y, z] = shot.froxels;
        u.froxels = [x, y, z, media];
        let first = FIRST_SLICE * far;
        u.slices = [first, (far / first).ln() / (z.max(2) - 1) as f32, shot.depth, 0.0];
        let bits = [look.fog && 0 < media, on_card.lamps_in_fog];
        let bits = bits.iter().enumerate().map(|(i, b)| u32::from(*b) << i).sum();
        u.switches = [on_card.lamps, look.mode.number(), bits, 0];
        // Radiance times the exposure fits into half floats whatever a scene's light is.
        let before = look.exposure;
        u.tone = if shot.radiance {
            [before, 1.0 / before, 0.0, 1.0]
        } else {
            [before, look.stops.exp2(), f32::from(u8::from(shot.encode)), 0.0]
        };
        u.size = [w, h, 1.0 / w, 1.0 / h];
        u
    }

    fn sky(&mut self, sky: &Sky, image: bool) {
        match sky {
            Sky::Black => {}
            Sky::Uniform { radiance } => {
                for side in [&mut self.zenith, &mut self.horizon, &mut self.ground] {
                    side[..3].copy_from_slice(radiance);
                }
            }
            Sky::Gradient { zenith, horizon, ground } => {
                self.zenith[..3].copy_from_slice(zenith);
                self.horizon[..3].copy_from_slice(horizon);
                self.ground[..3].copy_from_slice(ground);
            }
            Sky::Image { rotation, .. } => {
                self.sky_turn = Quat::from_array(*rotation).inverse().to_array();
                self.zenith[3] = f32::from(u8::from(image));
            }
        }
    }
}

/// A place relative to the middle of the scene.
pub(super) fn local(p: Vec3, bake: &Bake) -> Vec3 {
    (p.as_dvec3() - bake.scene.origin).as_vec3()
}

fn rows(m: &Affine3A, bake: &Bake) -> [[f32; 4]; 3] {
    // The map is of places in the scene's axes; those of shaders are relative to its middle.
    let m3 = m.matrix3.as_dmat3();
    let t = m.translation.as_dvec3() + m3 * bake.scene.origin;
    let rows = m3.transpose();
    [0, 1, 2].map(|i| rows.col(i).extend(t[i]).as_vec4().to_array())
}

impl MediumUniform {
    pub(super) fn new(m: &Medium, bake: &Bake) -> Self {
        let has = [m.cube.is_some(), m.height.is_some(), m.density.is_some()];
        let bits: u8 = has.iter().enumerate().map(|(i, b)| u8::from(*b) << i).sum();
        let mut u = Self {
            sigma_s: wide(m.sigma_s, m.g),
            sigma_a: wide(m.sigma_a, f32::from(bits)),
            ..Self::default()
        };
        if let Some(c) = &m.cube {
            u.cube = rows(c, bake);
        }
        if let Some([base, falloff]) = m.height {
            u.height = [local(Vec3::Y * base, bake).y, falloff, 0.0, 0.0];
        }
        if let Some(d) = &m.density {
            u.texture = rows(&d.cube, bake);
            u.size = [d.size[0], d.size[1], d.size[2], 0];
            u.first = [d.first[0], d.first[1], d.first[2], 0];
        }
        u
    }
}

impl LampUniform {
    pub(super) fn new(lamp: &Lamp, shadow: Option<Shadow>, bake: &Bake) -> Self {
        let kind = match lamp.kind {
            Kind::Point => 0.0,
            Kind::Spot => 1.0,
            Kind::Sun => 2.0,
        };
        // The fall-off of KHR_lights_punctual: the square of a line between the cosines of both angles.
        let [inner, outer] = lamp.cone.map(f32::cos);
        let scale = 1.0 / (inner - outer).max(1e-3);
        let cube = shadow.is_some_and(|s| s.cube);
        let cone = [scale, -outer * scale, f32::from(u8::from(!lamp.baked)), f32::from(u8::from(cube))];
        let layer = shadow.map_or(-1.0, |s| s.layer as f32);
        let [metres, each] = shadow.map_or([0.0; 2], |s| s.texel);
        Self {
            position: wide(local(lamp.position, bake), kind),
            direction: wide(lamp.direction, lamp.range.unwrap_or(0.0)),
            intensity: wide(lamp.intensity, layer),
            cone,
            texel: [metres, each, 0.0, 0.0],
        }
    }
}
