//! A picture of the scene from a camera, lit by the lightmaps alone, as an engine would show it. Media that emit are seen, and what smoke around them hides is not; what media scatter towards the
//! camera is not drawn.

use crate::geom::Ray;
use crate::media::Media;
use crate::output::page::Page;
use crate::plan::Plan;
use crate::sample::{Sequence, sequence};
use crate::scene::model::{Camera, Projection, Rgb};
use crate::transport::Kernel;
use glam::{Mat4, Vec2, Vec3, Vec3A};
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_3, PI};

/// Rays per pixel.
const RAYS: u32 = 4;

/// Height of the picture, pixels; the width follows from the camera.
pub const HEIGHT: usize = 540;

/// Most transparent layers looked through.
const LAYERS: u32 = 64;

/// A picture in linear radiance, nits, row 0 at the top.
#[derive(Clone, Debug)]
pub struct Picture {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Radiance, nits.
    pub pixels: Vec<[f32; 3]>,
}

/// Looks at the scene through `camera`. Surfaces show albedo times lightmap plus emission, bilinearly
/// filtered; those without texels are shown at the lightmaps' mean. Backs of one-sided surfaces are
/// not drawn.
#[must_use]
pub fn draw(plan: &Plan, kernel: &Kernel<'_>, pages: &[Page], camera: &Camera) -> Picture {
    let aspect = aspect(camera);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a clamped size in pixels")]
    let width = (HEIGHT as f32 * aspect) as usize;
    let fire = kernel.glowing().map(|media| (media, media.grids()));
    let viewer = Viewer { plan, kernel, pages, mean: mean(pages), fire };
    let origin = plan.tracing().world.origin;
    let pixels = (0..width * HEIGHT)
        .into_par_iter()
        .map(|i| {
            let mut sum = Vec3::ZERO;
            for k in 0..RAYS {
                let u = Sequence::new(sequence::key(0, 0x5657, i as u64), k).next4();
                let x = ((i % width) as f32 + u[0]) / width as f32 * 2.0 - 1.0;
                let y = 1.0 - ((i / width) as f32 + u[1]) / HEIGHT as f32 * 2.0;
                sum += viewer.look(camera_ray(camera, aspect, x, y, origin));
            }
            (sum / RAYS as f32).to_array()
        })
        .collect();
    Picture { width, height: HEIGHT, pixels }
}

/// Width over height of the picture from a camera.
#[must_use]
pub fn aspect(camera: &Camera) -> f32 {
    let aspect = match camera.projection {
        Projection::Perspective { aspect, .. } => aspect.unwrap_or(16.0 / 9.0),
        Projection::Orthographic { xmag, ymag } => (xmag / ymag).abs(),
    };
    if aspect.is_finite() { aspect.clamp(0.25, 4.0) } else { 16.0 / 9.0 }
}

fn camera_ray(camera: &Camera, aspect: f32, x: f32, y: f32, origin: Vec3) -> Ray {
    let m = camera.world_from_camera;
    let (start, direction) = match camera.projection {
        Projection::Perspective { yfov, .. } => {
            let t = (0.5 * yfov).tan();
            (Vec3::ZERO, Vec3::new(x * t * aspect, y * t, -1.0))
        }
        Projection::Orthographic { xmag, ymag } => (Vec3::new(x * xmag, y * ymag, 0.0), Vec3::NEG_Z),
    };
    Ray {
        origin: Vec3A::from(m.transform_point3(start) - origin),
        direction: Vec3A::from(m.transform_vector3(direction)).normalize_or(Vec3A::NEG_Z),
        t_max: f32::INFINITY,
    }
}

struct Viewer<'a> {
    plan: &'a Plan,
    kernel: &'a Kernel<'a>,
    pages: &'a [Page],
    mean: Rgb,
    /// Media that emit with all others, and those of them that are grids.
    fire: Option<(&'a Media, Option<Media>)>,
}

impl Viewer<'_> {
    fn look(&self, mut ray: Ray) -> Rgb {
        let (scene, world) = (self.plan.scene(), &self.plan.tracing().world);
        let mut left = Vec3::ONE;
        let mut seen = Vec3::ZERO;
        for _ in 0..LAYERS {
            let hit = self.kernel.closest(&ray);
            if let Some((media, smoke)) = &self.fire {
                let t = hit.map_or(f32::INFINITY, |h| h.t);
                seen += left * media.emitted(ray.origin, ray.direction, t);
                if let Some(smoke) = smoke {
                    left *= smoke.transmittance(ray.origin, ray.direction, t);
                }
            }
            let Some(hit) = hit else {
                return seen + left * self.kernel.lights.sky.radiance(ray.direction);
            };
            let at = world.point(hit.triangle, hit.bary);
            let material = world.material(scene, hit.triangle);
            let front = ray.direction.dot(at.geometric_normal) < 0.0;
            if front || material.double_sided {
                let shade = world.shade(scene, hit.triangle, hit.bary);
                let light = self.lightmap(hit.triangle, hit.bary).unwrap_or(self.mean);
                seen += left * (shade.albedo * light * shade.cover + shade.emission);
                left *= shade.pass;
                if left.max_element() < 1e-3 {
                    return seen;
                }
            }
            let beyond = if front { -at.offset } else { at.offset };
            ray.origin = at.position + at.geometric_normal * beyond;
        }
        seen
    }

    fn lightmap(&self, triangle: u32, bary: [f32; 3]) -> Option<Rgb> {
        let (surface, local) = self.plan.tracing().world.locate(triangle);
        let atlas = self.plan.atlas();
        let placement = atlas.placements[surface].as_ref()?;
        let corners =
            atlas.layouts[placement.layout].triangles[local].map(|v| atlas.texel_position(placement, v));
        let p = corners[0] * bary[0] + corners[1] * bary[1] + corners[2] * bary[2];
        Some(bilinear(&self.pages[placement.page], p))
    }
}

/// Bilinear lookup at a position in texels, clamped to the page.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the page")]
fn bilinear(page: &Page, p: Vec2) -> Rgb {
    let limit = Vec2::new(page.width as f32 - 1.0, page.height as f32 - 1.0);
    let q = (p - 0.5).clamp(Vec2::ZERO, limit);
    let (x0, y0) = (q.x as usize, q.y as usize);
    let (x1, y1) = ((x0 + 1).min(page.width - 1), (y0 + 1).min(page.height - 1));
    let (ax, ay) = (q.x - x0 as f32, q.y - y0 as f32);
    let at = |x: usize, y: usize| Vec3::from(page.radiance[y * page.width + x]);
    let row = |y| at(x0, y).lerp(at(x1, y), ax);
    row(y0).lerp(row(y1), ay)
}

fn mean(pages: &[Page]) -> Rgb {
    let (mut sum, mut n) = (glam::DVec3::ZERO, 0u64);
    for p in pages {
        for (c, &coverage) in p.radiance.iter().zip(&p.coverage) {
            if 0.0 < coverage {
                sum += Vec3::from(*c).as_dvec3();
                n += 1;
            }
        }
    }
    if n == 0 { Vec3::ZERO } else { (sum / n as f64).as_vec3() }
}

/// The scene's first camera, or a place to look from where the file has none: of some hundred
/// candidates inside the bounds, the one that sees most of the scene's front sides, evenly lit by
/// distance.
#[must_use]
pub fn camera(plan: &Plan, kernel: &Kernel<'_>) -> Camera {
    if let Some(camera) = plan.scene().cameras.first() {
        return camera.clone();
    }
    let world = &plan.tracing().world;
    let extent = world.triangles().flatten().fold(Vec3::ZERO, |m, v| m.max(v.abs()));
    let radius = extent.length();
    let mut best = (f32::NEG_INFINITY, Vec3::ZERO, Vec3::NEG_Z);
    for i in 0..192u32 {
        let u = Sequence::new(sequence::key(0, 0x4341, 0), i).next4();
        // Half of the candidates stand inside the bounds, half around them, looking at the middle.
        let inside = i % 2 == 0;
        let phi = u[3] * 2.0 * PI;
        let (eye, forward) = if inside {
            let eye = extent * (Vec3::new(u[0], u[1], u[2]) * 2.0 - 1.0) * 0.9;
            (eye, Vec3::new(phi.cos(), -0.15, phi.sin()))
        } else {
            let eye = Vec3::new(phi.cos(), 0.25 + 0.6 * u[0], phi.sin()) * radius * 1.7;
            (eye, -eye)
        };
        let score = score(plan, kernel, eye, forward.normalize(), extent.max_element());
        if best.0 < score {
            best = (score, eye, forward);
        }
    }
    let eye = best.1 + world.origin;
    let back = -best.2.normalize();
    let right = Vec3::Y.cross(back).normalize_or(Vec3::X);
    let up = back.cross(right);
    Camera {
        name: "chosen".to_owned(),
        world_from_camera: Mat4::from_cols(
            right.extend(0.0),
            up.extend(0.0),
            back.extend(0.0),
            eye.extend(1.0),
        ),
        projection: Projection::Perspective { yfov: FRAC_PI_3, aspect: Some(16.0 / 9.0) },
    }
}

fn score(plan: &Plan, kernel: &Kernel<'_>, eye: Vec3, forward: Vec3, size: f32) -> f32 {
    let world = &plan.tracing().world;
    let (right, up) = (forward.cross(Vec3::Y).normalize_or(Vec3::X), Vec3::Y);
    let mut score = 0.0;
    let n = 12i16;
    for i in -n..=n {
        for j in -n / 2..=n / 2 {
            let d = forward + right * (f32::from(i) / f32::from(n)) + up * (f32::from(j) / f32::from(n));
            let ray = Ray { origin: eye.into(), direction: Vec3A::from(d.normalize()), t_max: f32::INFINITY };
            if let Some(hit) = kernel.closest(&ray) {
                let at = world.point(hit.triangle, hit.bary);
                let double = world.material(plan.scene(), hit.triangle).double_sided;
                let front = ray.direction.dot(at.geometric_normal) < 0.0;
                let (surface, _) = world.locate(hit.triangle);
                let textured = plan.atlas().placements[surface].is_some();
                // Deep views say more than a wall in front of the lens; backs are holes in the picture.
                let depth = (hit.t / size).min(1.0).sqrt();
                score += match (front || double, textured) {
                    (true, true) => depth,
                    (true, false) => 0.2 * depth,
                    (false, _) => -1.0,
                };
            }
        }
    }
    score
}
