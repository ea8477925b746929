//! A small software rasteriser: lightmap times base colour plus emission.

use glam::{DVec2, DVec3, Vec2, Vec3};
use image::{Rgb, RgbImage};
use tables::format::manifest::Sky;

use crate::load::{Bake, Camera, Page, Scene, Triangle};

/// Rows of the picture.
const HEIGHT: u16 = 540;
/// Distance in front of the camera where triangles are cut, in parts of the scene's extent.
const NEAR: f32 = 1e-4;
/// Samples per pixel along each axis.
const FINE: u16 = 2;

/// A corner on its way to the screen: camera space and what is interpolated.
#[derive(Clone, Copy)]
struct Corner {
    at: Vec3,
    uv: Vec2,
    light: Vec2,
}

impl Corner {
    fn lerp(self, o: Self, t: f32) -> Self {
        Self { at: self.at.lerp(o.at, t), uv: self.uv.lerp(o.uv, t), light: self.light.lerp(o.light, t) }
    }
}

/// Distance and colour of every sample.
struct Canvas {
    width: usize,
    height: usize,
    depth: Vec<f32>,
    color: Vec<Vec3>,
    /// Half extents of the picture at distance 1.
    half: Vec2,
}

/// Draws the scene; radiance is multiplied by `exposure` and tone mapped.
pub(crate) fn draw(scene: &Scene, bake: &Bake, camera: Camera, exposure: f32) -> RgbImage {
    let tan = (0.5 * camera.yfov).tan();
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 1 to 8 heights")]
    let width = (f32::from(HEIGHT) * camera.aspect.clamp(0.125, 8.0)).round() as u32;
    let (w, h) = (width as usize * usize::from(FINE), usize::from(HEIGHT) * usize::from(FINE));
    let mut canvas = Canvas {
        width: w,
        height: h,
        depth: vec![f32::INFINITY; w * h],
        color: vec![Vec3::ZERO; w * h],
        half: Vec2::new(tan * camera.aspect, tan),
    };
    canvas.background(&bake.manifest.sky, camera);
    let extent =
        scene.triangles.iter().flat_map(|t| t.positions).map(|p| p.abs().max_element()).fold(0.0, f32::max);
    for t in &scene.triangles {
        let seen = t.positions.map(|p| camera.camera_from_world.transform_point3(p));
        canvas.triangle(scene, &bake.pages, t, seen, NEAR * extent);
    }
    resolve(&canvas, width, exposure)
}

impl Canvas {
    /// Fills the picture with the sky; an image of it is no part of the folder and stays black.
    fn background(&mut self, sky: &Sky, camera: Camera) {
        let world_from_camera = camera.camera_from_world.inverse();
        let size = Vec2::new(self.width as f32, self.height as f32);
        for (i, color) in self.color.iter_mut().enumerate() {
            let at = Vec2::new((i % self.width) as f32, (i / self.width) as f32) + 0.5;
            let p = (at / size * 2.0 - 1.0) * self.half;
            let up = world_from_camera.transform_vector3(Vec3::new(p.x, -p.y, -1.0)).normalize_or_zero().y;
            *color = match sky {
                Sky::Black | Sky::Image { .. } => Vec3::ZERO,
                Sky::Uniform { radiance } => Vec3::from(*radiance),
                Sky::Gradient { zenith, horizon, ground } => {
                    Vec3::from(*horizon).lerp(Vec3::from(if up < 0.0 { *ground } else { *zenith }), up.abs())
                }
            };
        }
    }

    /// Cuts a triangle at the near plane and fills what is left.
    fn triangle(&mut self, scene: &Scene, pages: &[Page], t: &Triangle, seen: [Vec3; 3], near: f32) {
        let material = &scene.materials[t.material];
        let normal = (seen[1] - seen[0]).cross(seen[2] - seen[0]);
        // The camera is at the origin: a triangle that shows its front has it on its normal's side.
        if normal.dot(seen[0]) < 0.0 || material.double_sided {
            let corner = |i: usize| Corner {
                at: seen[i],
                uv: t.uvs[i],
                light: t.lightmap.map_or(Vec2::ZERO, |(_, uvs)| uvs[i]),
            };
            let page = t.lightmap.map(|(page, _)| &pages[page]);
            let shade = |c: &Corner| {
                let light = page.map_or(Vec3::ZERO, |page| page.sample(c.light));
                light * material.albedo(c.uv) + material.emission
            };
            let kept = clip([corner(0), corner(1), corner(2)], near);
            for i in 1..kept.len().saturating_sub(1) {
                self.fill([kept[0], kept[i], kept[i + 1]], &shade);
            }
        }
    }

    fn fill(&mut self, corners: [Corner; 3], shade: &impl Fn(&Corner) -> Vec3) {
        // Corners near the camera lie far outside of the picture: in f32 their edges would miss it by texels.
        let size = DVec2::new(self.width as f64, self.height as f64);
        let screen = corners.map(|c| {
            let p = c.at.truncate().as_dvec2() / -f64::from(c.at.z) / self.half.as_dvec2();
            (DVec2::new(p.x, -p.y) * 0.5 + 0.5) * size
        });
        let [a, b, c] = screen;
        let area = (b - a).perp_dot(c - a);
        if area == 0.0 || !area.is_finite() {
            return;
        }
        let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
        for y in span(lo.y, hi.y, self.height) {
            for x in span(lo.x, hi.x, self.width) {
                let p = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
                let w = DVec3::new((c - b).perp_dot(p - b), (a - c).perp_dot(p - c), (b - a).perp_dot(p - a))
                    / area;
                if w.min_element() < 0.0 {
                    continue;
                }
                // 1/z is linear on the screen, and so is everything divided by z.
                let over = DVec3::from(corners.map(|c| -1.0 / f64::from(c.at.z))) * w;
                let distance = 1.0 / over.element_sum();
                let (w, depth) = ((over * distance).as_vec3(), single(distance));
                let i = y * self.width + x;
                if depth < self.depth[i] {
                    let mix = |f: fn(&Corner) -> Vec2| {
                        f(&corners[0]) * w.x + f(&corners[1]) * w.y + f(&corners[2]) * w.z
                    };
                    let at = Corner { at: Vec3::ZERO, uv: mix(|c| c.uv), light: mix(|c| c.light) };
                    self.depth[i] = depth;
                    self.color[i] = shade(&at);
                }
            }
        }
    }
}

/// The part of a triangle at least `near` in front of the camera.
fn clip(corners: [Corner; 3], near: f32) -> Vec<Corner> {
    let mut kept = Vec::with_capacity(4);
    for (i, &b) in corners.iter().enumerate() {
        let a = corners[(i + 2) % 3];
        let (da, db) = (-a.at.z - near, -b.at.z - near);
        if (da < 0.0) != (db < 0.0) {
            kept.push(a.lerp(b, da / (da - db)));
        }
        if 0.0 <= db {
            kept.push(b);
        }
    }
    kept
}

#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
fn single(x: f64) -> f32 {
    x as f32
}

/// Whole samples that the interval from `lo` to `hi` touches.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the picture")]
fn span(lo: f64, hi: f64, n: usize) -> std::ops::Range<usize> {
    let end = n as f64;
    (lo.floor().clamp(0.0, end) as usize)..(hi.ceil().clamp(0.0, end) as usize)
}

/// Tone maps every sample and averages them per pixel.
fn resolve(canvas: &Canvas, width: u32, exposure: f32) -> RgbImage {
    let fine = usize::from(FINE);
    RgbImage::from_fn(width, HEIGHT.into(), |x, y| {
        let mut sum = Vec3::ZERO;
        for j in 0..fine {
            for i in 0..fine {
                let at = (y as usize * fine + j) * canvas.width + x as usize * fine + i;
                // A curve that keeps the dark and bends the bright towards white.
                let v = canvas.color[at].max(Vec3::ZERO) * exposure;
                sum += v / (v + 1.0);
            }
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to 0 to 255")]
        let encode = |c: f32| {
            let c = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
            (c.clamp(0.0, 1.0) * 255.0).round() as u8
        };
        Rgb((sum / (fine * fine) as f32).to_array().map(encode))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn corner(x: f32, y: f32, z: f32) -> Corner {
        Corner { at: Vec3::new(x, y, z), uv: Vec2::new(x, y), light: Vec2::ZERO }
    }

    #[test]
    fn clipping_keeps_what_is_in_front() {
        let inside = clip([corner(0.0, 0.0, -1.0), corner(1.0, 0.0, -2.0), corner(0.0, 1.0, -1.0)], 0.5);
        assert_eq!(inside.len(), 3);
        let cut = clip([corner(0.0, 0.0, -1.0), corner(1.0, 0.0, -2.0), corner(0.0, 1.0, 1.0)], 0.5);
        assert_eq!(cut.len(), 4);
        assert!(cut.iter().all(|c| c.at.z <= -0.5 + 1e-6));
        assert!(clip([corner(0.0, 0.0, 1.0); 3], 0.5).is_empty());
    }

    #[test]
    fn interpolation_is_right_in_perspective() {
        let (w, h) = (64, 64);
        let mut canvas = Canvas {
            width: w,
            height: h,
            depth: vec![f32::INFINITY; w * h],
            color: vec![Vec3::ZERO; w * h],
            half: Vec2::ONE,
        };
        // A wall that runs away from the camera along the plane x = -z - 3: u and v are world x and y.
        let corners = [corner(-2.0, -9.0, -1.0), corner(6.0, -9.0, -9.0), corner(6.0, 9.0, -9.0)];
        canvas.fill(corners, &|c| c.uv.extend(1.0));
        let seen = canvas.color.iter().zip(&canvas.depth).enumerate().filter(|(_, (c, _))| c.z == 1.0);
        let mut n = 0;
        for (i, (c, depth)) in seen {
            let x = ((i % w) as f32 + 0.5) / w as f32 * 2.0 - 1.0;
            assert!((c.x - x * depth).abs() < 1e-3, "{c} at {x}, {depth}");
            assert!((c.x - (depth - 3.0)).abs() < 1e-3, "{c} at depth {depth}");
            n += 1;
        }
        assert!(200 < n, "{n} samples");
    }
}
