//! A camera that flies.

use glam::{DVec3, Vec2, Vec3};
use tables::format::manifest::Projection;

use crate::files::{bake::Bake, scene::Camera};

/// Where the eye is and where it looks.
#[derive(Clone, Debug)]
pub(crate) struct Pose {
    /// Metres in the scene's axes.
    pub(crate) eye: DVec3,
    /// Turn about +Y from -Z to the left, radians.
    pub(crate) yaw: f32,
    /// Upwards, radians.
    pub(crate) pitch: f32,
    /// About the direction that is looked in, radians.
    pub(crate) roll: f32,
    /// How far ahead the first surface was, metres: the measure of steps.
    pub(crate) focus: f32,
    /// Vertical angle, or size.
    projection: Projection,
}

/// What a picture covers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extent {
    /// Whether rays are parallel.
    pub(crate) flat: bool,
    /// Half width and half height at distance 1, metres for parallel rays.
    pub(crate) half: Vec2,
}

/// Steepest look of a camera that flies.
const STEEPEST: f32 = 1.55;

impl Pose {
    /// That of a camera of a bake.
    pub(crate) fn new(camera: &Camera, bake: &Bake) -> Self {
        let m = camera.world_from_camera;
        let axis = |i: usize| m.col(i).truncate().normalize_or_zero().as_vec3();
        let (right, forward) = (axis(0), -axis(2));
        let upright = forward.y.abs() < 0.9999;
        let yaw = if upright { (-forward.x).atan2(-forward.z) } else { (-right.z).atan2(right.x) };
        let eye = m.col(3).truncate();
        let mut pose = Self {
            eye,
            yaw,
            pitch: forward.y.clamp(-1.0, 1.0).asin(),
            roll: 0.0,
            focus: bake.scene.radius,
            projection: camera.projection,
        };
        let [level, up, _] = pose.axes();
        pose.roll = right.dot(up).atan2(right.dot(level));
        let from = (eye - bake.scene.origin).as_vec3();
        pose.focus = bake.scene.meets(from, forward).unwrap_or(bake.scene.radius).max(f32::MIN_POSITIVE);
        pose
    }

    /// Right, up, forward.
    pub(crate) fn axes(&self) -> [Vec3; 3] {
        let ((sy, cy), (sp, cp), (sr, cr)) = (self.yaw.sin_cos(), self.pitch.sin_cos(), self.roll.sin_cos());
        let forward = Vec3::new(-sy * cp, sp, -cy * cp);
        let (side, top) = (Vec3::new(cy, 0.0, -sy), Vec3::new(sy * sp, cp, cy * sp));
        [side * cr + top * sr, top * cr - side * sr, forward]
    }

    /// All that the camera covers, in a picture of this width over height.
    pub(crate) fn extent(&self, aspect: f32) -> Extent {
        let (flat, half, wanted) = match self.projection {
            Projection::Perspective { yfov, aspect } => (false, (0.5 * yfov).tan(), aspect),
            Projection::Orthographic { xmag, ymag } => {
                let height = ymag.abs().max(f32::MIN_POSITIVE);
                (true, height, (xmag.abs() / height).min(1e4))
            }
        };
        let height = half * (wanted / aspect).max(1.0);
        Extent { flat, half: Vec2::new(height * aspect, height) }
    }

    /// Turns by radians; upright again.
    pub(crate) fn turn(&mut self, yaw: f32, pitch: f32) {
        self.yaw += yaw;
        self.pitch = (self.pitch + pitch).clamp(-STEEPEST, STEEPEST);
        self.roll = 0.0;
    }

    /// Moves by metres to the right, up and ahead.
    pub(crate) fn fly(&mut self, by: Vec3) {
        let [right, _, forward] = self.axes();
        self.eye += (right * by.x + Vec3::Y * by.y + forward * by.z).as_dvec3();
    }

    /// Goes around what is in focus, about +Y, by radians.
    pub(crate) fn orbit(&mut self, by: f32) {
        let ahead = (self.axes()[2] * self.focus).as_dvec3();
        let middle = self.eye + ahead;
        self.yaw += by;
        self.eye = middle - (self.axes()[2] * self.focus).as_dvec3();
    }
}

impl Extent {
    /// Columns of the matrix to clip space: depth is 1 near and 0 far away, where floats are finest. `shift` is in units of clip space.
    pub(crate) fn clip_from_world(
        self,
        [right, up, forward]: [Vec3; 3],
        eye: Vec3,
        [near, far]: [f32; 2],
        shift: Vec2,
    ) -> [[f32; 4]; 4] {
        let row = |axis: Vec3, size: f32| (axis / size).extend(-axis.dot(eye) / size);
        let (x, y, ahead) = (row(right, self.half.x), row(up, self.half.y), row(forward, 1.0));
        let (z, w) = if self.flat {
            ((glam::Vec4::W * far - ahead) / far, glam::Vec4::W)
        } else {
            (glam::Vec4::W * near, ahead)
        };
        let rows = [x + shift.x * w, y + shift.y * w, z, w];
        std::array::from_fn(|c| rows.map(|r| r[c]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Mat4, Vec4};

    fn pose(eye: DVec3, at: DVec3, up: DVec3) -> Pose {
        let camera = Camera {
            name: String::new(),
            world_from_camera: glam::dcamera::rh::view::look_at_mat4(eye, at, up).inverse(),
            projection: Projection::Perspective { yfov: 1.0, aspect: 1.5 },
        };
        let mut bake = Bake::empty();
        bake.scene.radius = 7.0;
        Pose::new(&camera, &bake)
    }

    /// Poses look where the matrix does, also straight down and with the head on one side.
    #[test]
    fn poses_are_those_of_the_matrix() {
        let eye = DVec3::new(1.0, 2.0, 3.0);
        for (at, up) in [
            (DVec3::new(4.0, 1.0, -2.0), DVec3::Y),
            (DVec3::new(1.0, -5.0, 3.0), DVec3::X),
            (DVec3::new(-3.0, 2.5, 3.0), DVec3::new(0.2, 1.0, -0.4)),
        ] {
            let [right, above, forward] = pose(eye, at, up).axes();
            let m = glam::dcamera::rh::view::look_at_mat4(eye, at, up).inverse();
            for (got, i, sign) in [(right, 0, 1.0), (above, 1, 1.0), (forward, 2, -1.0)] {
                let want = (m.col(i).truncate() * sign).as_vec3();
                assert!((got - want).length() < 2e-3, "{got} and {want}");
            }
        }
    }

    #[test]
    fn what_is_ahead_is_in_the_middle_and_near_is_one() {
        let p = pose(DVec3::ZERO, DVec3::NEG_Z, DVec3::Y);
        let e = p.extent(3.0);
        // All of the camera's height is in a wider picture, all of its width in a higher one.
        assert!(
            (e.half.y - 0.5f32.tan()).abs() < 1e-6
                && (p.extent(0.75).half.x - 1.5 * 0.5f32.tan()).abs() < 1e-6
        );
        let m = Mat4::from_cols_array_2d(&e.clip_from_world(p.axes(), Vec3::ZERO, [0.1, 50.0], Vec2::ZERO));
        let near = m * Vec4::new(0.0, 0.0, -0.1, 1.0);
        assert!((near / near.w - Vec4::new(0.0, 0.0, 1.0, 1.0)).length() < 1e-6);
        let corner = m * Vec4::new(e.half.x * 4.0, e.half.y * 4.0, -4.0, 1.0);
        assert!((corner / corner.w).truncate().truncate().abs_diff_eq(Vec2::ONE, 1e-5));
    }

    #[test]
    fn a_turn_around_keeps_the_middle() {
        let mut p = pose(DVec3::ZERO, DVec3::new(0.0, -0.5, -1.0), DVec3::Y);
        let middle = |p: &Pose| p.eye + (p.axes()[2] * p.focus).as_dvec3();
        let before = middle(&p);
        p.orbit(1.0);
        assert!((middle(&p) - before).length() < 1e-5 && 1.0 < p.eye.length());
    }
}
