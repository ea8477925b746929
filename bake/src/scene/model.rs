//! What a scene is, after loading: plain data in glTF's units, decoded and checked.
//!
//! A [`Surface`] is one primitive of one node (or of one GPU instance of a node): the unit that
//! gets its own rectangle in the atlas. Surfaces share [`Mesh`] geometry.

use super::voxels::Voxels;
use glam::{Affine3A, Mat4, Quat, Vec2, Vec3, Vec4};
use std::sync::Arc;

/// Linear Rec. 709 colour; the unit depends on the place (nits, lux, candela, or 1 for albedo).
pub type Rgb = Vec3;

/// A loaded scene.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// File stem, used for the default output folder.
    pub name: String,
    /// Unique geometry, each entry one glTF primitive.
    pub meshes: Vec<Mesh>,
    /// What is placed in the world.
    pub surfaces: Vec<Surface>,
    /// Materials; the last one is glTF's default material where a primitive names none.
    pub materials: Vec<Material>,
    /// Decoded images that some material uses.
    pub images: Vec<Image>,
    /// Punctual and directional lights.
    pub lights: Vec<Light>,
    /// What rays see that leave the scene.
    pub sky: Sky,
    /// Cameras in file order.
    pub cameras: Vec<Camera>,
    /// `texels_per_metre` asked for by the scene's extras or the configuration file.
    pub texels_per_metre: Option<f32>,
    /// Whether metals have no albedo.
    pub metals_black: bool,
    /// What fills the air.
    pub media: Vec<Medium>,
    /// Where light probes are asked for by name; `None` where they find their places by themselves.
    pub probe_boxes: Option<Vec<ProbeBox>>,
    /// Nodes whose mesh bounds a medium or light probes and is no surface, and the glTF's number of that mesh.
    pub bounds: Vec<(usize, usize)>,
}

/// Word of a node's extras for the number of a mesh that only bounds a medium or light probes.
pub const BOUNDS: &str = "bounds_mesh";

/// A box that is filled with light probes.
#[derive(Clone, Debug, PartialEq)]
pub struct ProbeBox {
    /// Where it stands in the file.
    pub path: String,
    /// Corner with the smallest coordinates, metres.
    pub min: Vec3,
    /// Corner with the greatest.
    pub max: Vec3,
    /// Distance of probes, metres.
    pub spacing: f32,
}

/// A participating medium.
#[derive(Clone, Debug, PartialEq)]
pub struct Medium {
    /// Path for messages and the manifest.
    pub path: String,
    /// Scattering per metre where the density is 1.
    pub sigma_s: Rgb,
    /// Absorption per metre where the density is 1.
    pub sigma_a: Rgb,
    /// What it emits where the density is 1, nits per metre of way.
    pub emission: Rgb,
    /// How dense it is from place to place.
    pub density: Density,
    /// Mean cosine of scattering, Henyey-Greenstein.
    pub g: f32,
    /// Where it is.
    pub region: Region,
}

impl Medium {
    /// Whether it does anything to light.
    #[must_use]
    pub fn acts(&self) -> bool {
        self.emission != Vec3::ZERO || self.dims()
    }

    /// Whether it scatters or absorbs.
    #[must_use]
    pub fn dims(&self) -> bool {
        self.sigma_s + self.sigma_a != Vec3::ZERO
    }
}

/// How dense a [`Medium`] is from place to place.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Density {
    /// 1 throughout.
    #[default]
    Constant,
    /// exp(-(y - base) / falloff) at the height y.
    Height {
        /// Where the density is 1, metres.
        base: f32,
        /// Over which it falls by a factor of e, metres.
        falloff: f32,
    },
    /// That of a voxel; 0 outside the grid.
    Voxels {
        /// The grid.
        values: Arc<Voxels>,
        /// World space to the space of its voxels.
        voxels_from_world: Affine3A,
    },
}

/// Where a [`Medium`] is.
#[derive(Clone, Debug, PartialEq)]
pub enum Region {
    /// Everywhere.
    Everywhere,
    /// In a box, metres in world space.
    Box {
        /// Lower corner.
        min: Vec3,
        /// Upper corner.
        max: Vec3,
    },
    /// In a box that may be turned and sheared: where this leads into the unit cube.
    Turned {
        /// World space to the space of the cube [0, 1]^3.
        unit_from_world: Affine3A,
    },
    /// Within a closed mesh.
    Mesh(Arc<Shell>),
}

/// A mesh that encloses a medium.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shell {
    /// Vertex positions, metres in world space.
    pub positions: Vec<Vec3>,
    /// Three indices into `positions` per triangle, in range.
    pub triangles: Vec<[u32; 3]>,
}

/// Geometry of one glTF primitive, in its mesh's own space. Always triangles.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Name for messages, such as `meshes[3].primitives[0] (arch)`.
    pub name: String,
    /// glTF mesh and primitive index this came from.
    pub source: (usize, usize),
    /// Vertex positions, metres in mesh space.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals; empty where the file has none (then faces are flat).
    pub normals: Vec<Vec3>,
    /// Texture coordinate sets, `uvs[n]` is `TEXCOORD_n`; a set that is absent is an empty vector.
    pub uvs: Vec<Vec<Vec2>>,
    /// Linear vertex colours with alpha; empty where the file has none.
    pub colors: Vec<Vec4>,
    /// Three indices into `positions` per triangle, in range.
    pub triangles: Vec<[u32; 3]>,
}

/// One mesh placed in the world with a material.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Path of node names from the root, such as `hall/column.3`, for messages and the manifest.
    pub path: String,
    /// glTF node index.
    pub node: usize,
    /// Index within the node's `EXT_mesh_gpu_instancing` instances, if it has them.
    pub gpu_instance: Option<usize>,
    /// Index into [`Scene::meshes`].
    pub mesh: usize,
    /// Index into [`Scene::materials`].
    pub material: usize,
    /// Mesh space to world. May mirror (negative determinant) or be singular.
    pub world_from_mesh: Affine3A,
    /// Whether this surface gets texels.
    pub lightmap: LightmapMode,
    /// Whether this surface blocks light and is seen by rays.
    pub casts_shadow: bool,
    /// Density override, texels per metre.
    pub texels_per_metre: Option<f32>,
}

/// What a surface receives.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightmapMode {
    /// Gets texels.
    #[default]
    On,
    /// Gets no texels but takes part in light transport.
    Off,
    /// Lit by probes at run time: no texels, takes part in light transport.
    Probes,
}

/// How a material covers what is behind it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// Present where alpha is at least the cutoff.
    Mask(f32),
    /// Covers the fraction alpha of the light.
    Blend,
}

/// A diffuse material with emission and straight transmission.
#[derive(Clone, Debug)]
pub struct Material {
    /// Name for messages.
    pub name: String,
    /// Diffuse albedo (rgb) and alpha, multiplied by texture and vertex colour.
    pub base_color: Vec4,
    /// sRGB texture with alpha.
    pub base_color_texture: Option<TextureRef>,
    /// Emitted radiance in nits, strength included; multiplied by the texture.
    pub emission: Rgb,
    /// sRGB texture.
    pub emission_texture: Option<TextureRef>,
    /// Alpha coverage.
    pub alpha_mode: AlphaMode,
    /// One-sided surfaces block light from behind and reflect and emit nothing there.
    pub double_sided: bool,
    /// Fraction of light that passes straight through, tinted by the base colour.
    pub transmission: f32,
    /// Red channel multiplies `transmission`.
    pub transmission_texture: Option<TextureRef>,
    /// `KHR_materials_unlit`: gets no texels.
    pub unlit: bool,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: Vec4::ONE,
            base_color_texture: None,
            emission: Vec3::ZERO,
            emission_texture: None,
            alpha_mode: AlphaMode::Opaque,
            double_sided: false,
            transmission: 0.0,
            transmission_texture: None,
            unlit: false,
        }
    }
}

/// A texture as a material uses it.
#[derive(Clone, Debug)]
pub struct TextureRef {
    /// Index into [`Scene::images`].
    pub image: usize,
    /// Which of [`Mesh::uvs`].
    pub uv_set: usize,
    /// `KHR_texture_transform`: `uv' = (x.dot((u, v, 1)), y.dot((u, v, 1)))`.
    pub transform: [Vec3; 2],
    /// Behaviour outside [0, 1], per axis.
    pub wrap: [Wrap; 2],
    /// Nearest texel instead of bilinear interpolation.
    pub nearest: bool,
}

/// Texture addressing outside [0, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// Tile.
    #[default]
    Repeat,
    /// Tile, every other one mirrored.
    Mirror,
    /// Edge texel.
    Clamp,
}

/// A decoded 8-bit image, row 0 at the top. The values are as stored (sRGB encoded where the use says so).
#[derive(Clone, Debug)]
pub struct Image {
    /// Name for messages.
    pub name: String,
    /// Texels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` RGBA texels.
    pub pixels: Vec<[u8; 4]>,
    /// The glTF image that this is, unless it was made from others.
    pub source: Option<usize>,
}

/// Which part of a light is baked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightMode {
    /// Direct and indirect light.
    #[default]
    Baked,
    /// Indirect light only; the game adds the direct part.
    Mixed,
    /// Nothing: the game lights with it.
    Dynamic,
}

/// A punctual or directional light in world space.
#[derive(Clone, Debug)]
pub struct Light {
    /// Path for messages and the manifest.
    pub path: String,
    /// glTF's number of its node; `None` for lamps that words add.
    pub node: Option<usize>,
    /// Which part is baked.
    pub mode: LightMode,
    /// Shape and strength.
    pub kind: LightKind,
}

/// Shape and strength of a [`Light`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LightKind {
    /// Shines equally in all directions.
    Point {
        /// World position, metres.
        position: Vec3,
        /// Candela.
        intensity: Rgb,
        /// Where `KHR_lights_punctual`'s window reaches zero, metres.
        range: Option<f32>,
    },
    /// Shines in a cone.
    Spot {
        /// World position, metres.
        position: Vec3,
        /// Unit vector the light travels along.
        direction: Vec3,
        /// Candela on the axis.
        intensity: Rgb,
        /// Where the window reaches zero, metres.
        range: Option<f32>,
        /// Half angle where fall-off starts, radians.
        inner_cone: f32,
        /// Half angle where it ends, radians.
        outer_cone: f32,
    },
    /// From infinitely far away.
    Directional {
        /// Unit vector the light travels along.
        direction: Vec3,
        /// Lux on a surface that faces the light.
        illuminance: Rgb,
        /// Full angle of the disc it seems to come from, radians; 0 gives sharp shadows.
        angular_diameter: f32,
    },
}

/// Radiance of directions that hit nothing.
#[derive(Clone, Debug, Default)]
pub enum Sky {
    /// No light.
    #[default]
    Black,
    /// The same from everywhere, nits.
    Uniform(Rgb),
    /// Linear in the sine of elevation, nits.
    Gradient {
        /// Straight up.
        zenith: Rgb,
        /// At the horizon, from above.
        horizon: Rgb,
        /// Straight down; the lower half goes from `horizon` to this.
        ground: Rgb,
    },
    /// Equirectangular image: the top row is +Y, the middle column looks along -Z, +X is a quarter to its right.
    Image {
        /// Texels per row.
        width: usize,
        /// Rows.
        height: usize,
        /// Nits before `scale`, row 0 at the top.
        pixels: Vec<Rgb>,
        /// Sky space to world.
        rotation: Quat,
        /// Multiplies `pixels`.
        scale: f32,
    },
}

/// A camera, for preview pictures.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Name.
    pub name: String,
    /// Looks along -Z of this, +Y up.
    pub world_from_camera: Mat4,
    /// What it covers.
    pub projection: Projection,
}

/// What a [`Camera`] covers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// Pinhole with a vertical field of view in radians.
    Perspective {
        /// Full vertical angle, radians.
        yfov: f32,
        /// Width over height where the file says so.
        aspect: Option<f32>,
    },
    /// Parallel; half extents in metres.
    Orthographic {
        /// Half width.
        xmag: f32,
        /// Half height.
        ymag: f32,
    },
}
