//! What a surface does with light at a point: albedo, emission and what passes through.

use crate::geom::bvh::Opacity;
use crate::geom::world::World;
use crate::scene::model::{AlphaMode, Material, Rgb, Scene};
use glam::{Vec3, Vec4, Vec4Swizzles};

/// A material evaluated at a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shade {
    /// Diffuse albedo of what is there, 0..=1.
    pub albedo: Rgb,
    /// Emitted radiance on the emitting side, nits.
    pub emission: Rgb,
    /// Fraction of light that goes straight through, tinted; what is left over meets the albedo.
    pub pass: Rgb,
    /// Fraction of the light that meets the diffuse surface, `albedo` not yet applied.
    pub cover: f32,
}

/// What a ray has to know of the surface that it meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Met {
    /// The material at the point.
    pub shade: Shade,
    /// Both sides reflect and emit.
    pub double_sided: bool,
    /// It does not count as a light.
    pub unlit: bool,
}

/// Whether a material is the same all over a surface: no texture and no colour of corners changes it.
#[must_use]
pub fn is_constant(scene: &Scene, surface: usize) -> bool {
    let s = &scene.surfaces[surface];
    let m = &scene.materials[s.material];
    let textured = m.base_color_texture.is_some()
        || (m.emission != Vec3::ZERO && m.emission_texture.is_some())
        || (0.0 < m.transmission && m.transmission_texture.is_some());
    !textured && scene.meshes[s.mesh].colors.is_empty()
}

/// How the tree has to treat a surface with this material.
#[must_use]
pub fn opacity(scene: &Scene, surface: usize) -> Opacity {
    let m = &scene.materials[scene.surfaces[surface].material];
    if m.alpha_mode == AlphaMode::Opaque && m.transmission <= 0.0 { Opacity::Opaque } else { Opacity::Ask }
}

impl World {
    /// Keeps what every point of a surface is alike in, so that hits look up nothing else. Only for scenes all of whose surfaces are
    /// [`is_constant`].
    pub fn keep_constant(&mut self, scene: &Scene) {
        let first =
            |s: usize| (self.first_triangle[s] < self.first_triangle[s + 1]).then(|| self.first_triangle[s]);
        let unseen = Met {
            shade: Shade { albedo: Vec3::ZERO, emission: Vec3::ZERO, pass: Vec3::ZERO, cover: 0.0 },
            double_sided: false,
            unlit: false,
        };
        let of = |s: usize| first(s).map_or(unseen, |t| self.met_anywhere(scene, t, [1.0, 0.0, 0.0]));
        self.constant = (0..scene.surfaces.len()).map(of).collect();
    }

    /// What a ray meets at a point of a triangle.
    #[must_use]
    #[inline]
    pub fn met(&self, scene: &Scene, triangle: u32, bary: [f32; 3]) -> Met {
        match self.constant.get(self.surface(triangle)) {
            Some(met) => *met,
            None => self.met_anywhere(scene, triangle, bary),
        }
    }

    fn met_anywhere(&self, scene: &Scene, triangle: u32, bary: [f32; 3]) -> Met {
        let m = self.material(scene, triangle);
        let shade = self.shade(scene, triangle, bary);
        Met { shade, double_sided: m.double_sided, unlit: m.unlit }
    }

    /// Evaluates the material at a point of a triangle.
    #[must_use]
    pub fn shade(&self, scene: &Scene, triangle: u32, bary: [f32; 3]) -> Shade {
        let (surface, local) = self.locate(triangle);
        let m = &scene.materials[scene.surfaces[surface].material];
        let uv = |set| self.uv(scene, surface, local, bary, set);
        let base = self.base(scene, surface, local, bary);
        let mut emission = m.emission;
        if emission != Vec3::ZERO
            && let Some(t) = &m.emission_texture
        {
            emission *= t.color(scene, uv(t.uv_set)).xyz();
        }
        let alpha = coverage(m.alpha_mode, base.w);
        let albedo = base.xyz().clamp(Vec3::ZERO, Vec3::ONE);
        let mut transmission = m.transmission;
        if 0.0 < transmission
            && let Some(t) = &m.transmission_texture
        {
            transmission *= t.data(scene, uv(t.uv_set)).x;
        }
        let transmission = transmission.clamp(0.0, 1.0);
        Shade {
            albedo,
            emission: emission * alpha,
            pass: Vec3::splat(1.0 - alpha) + albedo * (alpha * transmission),
            cover: alpha * (1.0 - transmission),
        }
    }

    /// The material of a triangle.
    #[must_use]
    pub fn material<'a>(&self, scene: &'a Scene, triangle: u32) -> &'a Material {
        &scene.materials[scene.surfaces[self.surface(triangle)].material]
    }

    /// What passes straight through at a point: 0 for opaque places, 1 for holes.
    #[must_use]
    pub fn pass(&self, scene: &Scene, triangle: u32, bary: [f32; 3]) -> Rgb {
        let m = self.material(scene, triangle);
        if m.alpha_mode == AlphaMode::Opaque && m.transmission <= 0.0 {
            return Vec3::ZERO;
        }
        self.shade(scene, triangle, bary).pass
    }

    /// Base colour with alpha: factor, texture and vertex colour.
    fn base(&self, scene: &Scene, surface: usize, local: usize, bary: [f32; 3]) -> Vec4 {
        let s = &scene.surfaces[surface];
        let m = &scene.materials[s.material];
        let mut base = m.base_color;
        if let Some(t) = &m.base_color_texture {
            base *= t.color(scene, self.uv(scene, surface, local, bary, t.uv_set));
        }
        let mesh = &scene.meshes[s.mesh];
        if !mesh.colors.is_empty() {
            let [a, b, c] = mesh.triangles[local].map(|i| mesh.colors[i as usize]);
            base *= a * bary[0] + b * bary[1] + c * bary[2];
        }
        base
    }
}

fn coverage(mode: AlphaMode, alpha: f32) -> f32 {
    match mode {
        AlphaMode::Opaque => 1.0,
        AlphaMode::Mask(cutoff) => f32::from(cutoff <= alpha),
        AlphaMode::Blend => alpha.clamp(0.0, 1.0),
    }
}
