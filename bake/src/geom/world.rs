//! All triangles of a scene in one list, in world space.

use crate::geom::ray::offset_distance;
use crate::geom::shade::Met;
use crate::scene::model::{Rgb, Scene};
use glam::{Affine3A, Mat3A, Vec2, Vec3, Vec3A};

/// The scene's triangles, placed.
///
/// Coordinates are relative to [`World::origin`], the centre of the scene's bounds: a scene that
/// lies 100 km from its origin keeps its precision if its nodes carry the distance.
#[derive(Clone, Debug, Default)]
pub struct World {
    /// What was subtracted from every position, metres.
    pub origin: Vec3,
    /// Every triangle of every surface, in the order of the surfaces.
    faces: Vec<Face>,
    /// What rays meet on each surface, where that is the same all over it; else empty.
    pub(super) constant: Vec<Met>,
    /// Index of each surface's first triangle; one entry more than there are surfaces.
    pub first_triangle: Vec<u32>,
    /// Half the largest extent of the bounds, metres.
    pub radius: f32,
}

/// A triangle with what every hit needs, in one line of the processor's cache: rays meet triangles in no order, so each
/// hit waits for memory as often as it asks for something else.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Face {
    corners: [Vec3; 3],
    /// Unit normal of the front side; zero for a triangle without area.
    normal: Vec3,
    /// Unit normals of the corners as [`pack`] has them, or [`FLAT`] where the file has none.
    normals: [u32; 3],
    surface: u32,
}

/// A point on a triangle with what shading needs.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Position, metres, relative to [`World::origin`].
    pub position: Vec3A,
    /// Unit normal of the triangle's plane on its front side.
    pub geometric_normal: Vec3A,
    /// Unit interpolated normal on the same side, or the geometric one where the file has none.
    pub shading_normal: Vec3A,
    /// Distance that rays have to start off the plane, metres.
    pub offset: f32,
}

impl World {
    /// Places every surface's triangles.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^32 triangles")]
    pub fn new(scene: &Scene) -> Self {
        let origin = centre(scene);
        let mut world = Self { origin, first_triangle: vec![0], ..Self::default() };
        for (i, s) in scene.surfaces.iter().enumerate() {
            let mesh = &scene.meshes[s.mesh];
            let placed = Affine3A {
                matrix3: s.world_from_mesh.matrix3,
                translation: s.world_from_mesh.translation - Vec3A::from(origin),
            };
            let place = |i: u32| placed.transform_point3(mesh.positions[i as usize]);
            let mirrored = placed.matrix3.determinant() < 0.0;
            let cofactors = cofactors(placed.matrix3);
            let turned =
                |i: u32| pack((cofactors * Vec3A::from(mesh.normals[i as usize])).normalize_or_zero());
            for t in &mesh.triangles {
                let corners = t.map(place);
                let normal = plane(corners.map(Vec3A::from), mirrored).into();
                let normals = if mesh.normals.is_empty() { [FLAT; 3] } else { t.map(turned) };
                world.faces.push(Face { corners, normal, normals, surface: i as u32 });
            }
            world.first_triangle.push(world.faces.len() as u32);
        }
        let extent = world.triangles().flatten().fold(Vec3::ZERO, |m, v| m.max(v.abs()));
        world.radius = extent.max_element();
        world
    }

    /// The surface and the triangle's index within its mesh.
    #[must_use]
    pub fn locate(&self, triangle: u32) -> (usize, usize) {
        let surface = self.surface(triangle);
        (surface, (triangle - self.first_triangle[surface]) as usize)
    }

    /// Number of triangles.
    #[must_use]
    pub fn len(&self) -> usize {
        self.faces.len()
    }

    /// Whether there are no triangles.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// Bytes held for each triangle.
    pub const BYTES: usize = size_of::<Face>();

    /// Corners of all triangles.
    pub fn triangles(&self) -> impl Iterator<Item = [Vec3; 3]> {
        self.faces.iter().map(|f| f.corners)
    }

    /// Corners of a triangle, metres.
    #[must_use]
    pub fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.faces[triangle as usize].corners
    }

    /// Triangles of one surface.
    #[cfg(test)]
    pub(crate) fn of_triangles(triangles: Vec<[Vec3; 3]>) -> Self {
        let mut scene = Scene::default();
        let n = u32::try_from(triangles.len()).expect("a few");
        scene.meshes.push(crate::scene::model::Mesh {
            positions: triangles.into_iter().flatten().collect(),
            triangles: (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            ..Default::default()
        });
        scene.materials.push(Default::default());
        scene.surfaces.push(crate::scene::model::Surface {
            path: String::new(),
            node: 0,
            gpu_instance: None,
            mesh: 0,
            material: 0,
            world_from_mesh: glam::Affine3A::IDENTITY,
            lightmap: Default::default(),
            casts_shadow: true,
            texels_per_metre: None,
        });
        Self::new(&scene)
    }

    /// Corners to spoil.
    #[cfg(test)]
    pub(crate) fn corners_mut(&mut self, triangle: u32) -> &mut [Vec3; 3] {
        &mut self.faces[triangle as usize].corners
    }

    /// The surface that a triangle belongs to.
    #[must_use]
    pub fn surface(&self, triangle: u32) -> usize {
        self.faces[triangle as usize].surface as usize
    }

    /// Unit normal of the front side (counter-clockwise, or clockwise in mirrored nodes as glTF
    /// asks); zero for a triangle without area.
    #[must_use]
    pub fn geometric_normal(&self, triangle: u32) -> Vec3A {
        self.faces[triangle as usize].normal.into()
    }

    /// Everything about the point with the given barycentric weights.
    #[must_use]
    pub fn point(&self, triangle: u32, bary: [f32; 3]) -> SurfacePoint {
        let face = &self.faces[triangle as usize];
        let corners = face.corners.map(Vec3A::from);
        let position = corners[0] * bary[0] + corners[1] * bary[1] + corners[2] * bary[2];
        let magnitude = corners[0].abs().max(corners[1].abs()).max(corners[2].abs()).max_element();
        let geometric_normal = face.normal.into();
        SurfacePoint {
            position,
            geometric_normal,
            shading_normal: face.shading_normal(bary),
            offset: offset_distance(magnitude),
        }
    }

    /// Lifts a point of a smooth surface off its facets onto the surface they stand for.
    ///
    /// A facet's point, shaded with the smooth normal, would see the neighbouring facets as a
    /// jagged horizon. \[Han21\] Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II, chapter
    /// 4: the point is moved towards where the tangent planes of the corners put it. We go half the
    /// way, which is exact on quadrics; the chapter goes all of it. Concave places keep their
    /// position, flat ones too.
    #[must_use]
    pub fn lifted(&self, triangle: u32, bary: [f32; 3], at: &SurfacePoint) -> Vec3A {
        let face = &self.faces[triangle as usize];
        if face.normals[0] == FLAT {
            return at.position;
        }
        let mut lift = Vec3A::ZERO;
        for ((corner, normal), weight) in face.corners.into_iter().zip(face.normals).zip(bary) {
            let n = unpack(normal);
            // Distance below the corner's tangent plane; only outward moves.
            let below = (at.position - Vec3A::from(corner)).dot(n).min(0.0);
            lift -= n * (0.5 * below * weight);
        }
        at.position + lift
    }

    /// Interpolated texture coordinates of set `set`, or zero where the mesh lacks it.
    #[must_use]
    pub fn uv(&self, scene: &Scene, surface: usize, local: usize, bary: [f32; 3], set: usize) -> Vec2 {
        let mesh = &scene.meshes[scene.surfaces[surface].mesh];
        match mesh.uvs.get(set) {
            Some(uvs) if !uvs.is_empty() => {
                let [a, b, c] = mesh.triangles[local].map(|i| uvs[i as usize]);
                a * bary[0] + b * bary[1] + c * bary[2]
            }
            _ => Vec2::ZERO,
        }
    }

    /// Area of all triangles, square metres.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "fewer than 2^32 triangles; the sum is f64")]
    pub fn total_area(&self) -> f32 {
        (0..self.len()).map(|t| f64::from(self.area(t as u32))).sum::<f64>() as f32
    }

    /// Area of a triangle, square metres.
    #[must_use]
    pub fn area(&self, triangle: u32) -> f32 {
        let [a, b, c] = self.corners(triangle);
        0.5 * (b - a).cross(c - a).length()
    }
}

impl Face {
    fn shading_normal(&self, bary: [f32; 3]) -> Vec3A {
        let geometric = Vec3A::from(self.normal);
        if self.normals[0] == FLAT {
            return geometric;
        }
        let [a, b, c] = self.normals.map(unpack);
        let n = (a * bary[0] + b * bary[1] + c * bary[2]).normalize_or_zero();
        // Normals that contradict the winding are the file's mistake; the winding decides.
        if n.dot(geometric) <= 0.0 { geometric } else { n }
    }
}

/// Unit normal of a triangle's plane.
fn plane([a, b, c]: [Vec3A; 3], mirrored: bool) -> Vec3A {
    // Scaling by the longest edge keeps the product in range for millimetres and for 100 km.
    let (u, v) = (b - a, c - a);
    let s = u.abs().max_element().max(v.abs().max_element());
    let n = (u / s).cross(v / s).normalize_or_zero();
    if mirrored { -n } else { n }
}

/// What stands for normals that the file lacks; no packed normal, because those have no component below -32767.
const FLAT: u32 = 0x8000_8000;

/// Steps of a packed component.
const STEPS: f32 = 32767.0;

/// A unit vector as two components of 16 bits on the octahedron, at most 7e-5 radians off (\[CDE14\] Cigolle,
/// Donow, Evangelakos, Mara, McGuire and Meyer, "A Survey of Efficient Representations for Independent Unit
/// Vectors", JCGT 3(2), section 3). Zero becomes +z.
pub(crate) fn pack(n: Vec3A) -> u32 {
    let n = n / n.abs().element_sum().max(f32::MIN_POSITIVE);
    let p = if n.z < 0.0 { fold(n.x, n.y) } else { [n.x, n.y] };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "within 16 bits, as they are"
    )]
    let [x, y] = p.map(|v| u32::from((v * STEPS).round() as i16 as u16));
    x | y << 16
}

/// The vector that [`pack`] got.
#[expect(clippy::cast_possible_truncation, reason = "16 bits as they are")]
pub(crate) fn unpack(packed: u32) -> Vec3A {
    let [x, y] = [packed as i16, (packed >> 16) as i16].map(|v| f32::from(v) / STEPS);
    let z = 1.0 - x.abs() - y.abs();
    let [x, y] = if z < 0.0 { fold(x, y) } else { [x, y] };
    Vec3A::new(x, y, z).normalize()
}

/// The lower half of the octahedron lies around the upper one.
fn fold(x: f32, y: f32) -> [f32; 2] {
    [(1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y)]
}

/// Matrix of cofactors: transforms normals, also for singular and mirroring matrices (where its
/// sign makes normals follow the front side).
fn cofactors(m: Mat3A) -> Mat3A {
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
    let c = Mat3A::from_cols(y.cross(z), z.cross(x), x.cross(y));
    // Cofactors flip normals under mirroring like the winding does; the front side of a mirrored
    // node is the one its normals point to, so the flip is taken back.
    if m.determinant() < 0.0 { c * -1.0 } else { c }
}

/// Centre of the bounds of everything placed, or zero for an empty or unbounded scene.
fn centre(scene: &Scene) -> Vec3 {
    let (mut lo, mut hi) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for s in &scene.surfaces {
        for &p in &scene.meshes[s.mesh].positions {
            let p = s.world_from_mesh.transform_point3(p);
            lo = lo.min(p);
            hi = hi.max(p);
        }
    }
    let c = 0.5 * (lo + hi);
    if c.is_finite() { c } else { Vec3::ZERO }
}

/// Rec. 709 luminance of a linear colour, in the colour's own unit.
#[must_use]
pub fn luminance(c: Rgb) -> f32 {
    c.dot(Vec3::new(0.2126, 0.7152, 0.0722))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::model::{LightmapMode, Material, Mesh, Surface};

    fn scene(world_from_mesh: Affine3A) -> Scene {
        Scene {
            meshes: vec![Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
                normals: vec![Vec3::Z; 3],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            }],
            materials: vec![Material::default()],
            surfaces: vec![Surface {
                path: String::new(),
                node: 0,
                gpu_instance: None,
                mesh: 0,
                material: 0,
                world_from_mesh,
                lightmap: LightmapMode::On,
                casts_shadow: true,
                texels_per_metre: None,
            }],
            ..Scene::default()
        }
    }

    /// In a mirrored node the front side is where the transformed normal points, as glTF asks.
    #[test]
    fn normals_agree_under_every_transform() {
        for m in [
            Affine3A::IDENTITY,
            Affine3A::from_scale(Vec3::new(-1.0, 1.0, 1.0)),
            Affine3A::from_scale(Vec3::new(2.0, 0.5, -3.0)),
            Affine3A::from_rotation_x(1.0) * Affine3A::from_scale(Vec3::new(1.0, -4.0, 1.0)),
        ] {
            let scene = scene(m);
            let w = World::new(&scene);
            let want = m.transform_vector3(Vec3::Z).normalize();
            let p = w.point(0, [0.2, 0.3, 0.5]);
            assert!((Vec3::from(p.geometric_normal) - want).length() < 1e-5, "{m:?} {p:?}");
            assert!((Vec3::from(p.shading_normal) - want).length() < 7e-5, "{m:?} {p:?}");
        }
    }

    #[test]
    fn packed_normals_keep_their_direction() {
        let mut worst = 0f32;
        for i in 0..20_000u64 {
            let [a, b, _, _] = crate::sample::Sequence::new(crate::sample::sequence::key(1, 2, i), 0).next4();
            let (z, phi) = (2.0 * a - 1.0, std::f32::consts::TAU * b);
            let r = (1.0 - z * z).max(0.0).sqrt();
            let n = Vec3A::new(r * phi.cos(), r * phi.sin(), z);
            worst = worst.max((unpack(pack(n)) - n).length());
            assert_ne!(pack(n), FLAT);
        }
        assert!(worst < 7e-5, "{worst}");
        for axis in [Vec3A::X, Vec3A::Y, Vec3A::Z] {
            assert_eq!([axis, -axis].map(|n| unpack(pack(n))), [axis, -axis]);
        }
        assert_eq!(unpack(pack(Vec3A::ZERO)), Vec3A::Z);
    }

    #[test]
    fn far_away_scenes_keep_their_shape() {
        let scene = scene(Affine3A::from_translation(Vec3::splat(1e5)));
        let w = World::new(&scene);
        assert!(w.radius <= 0.51, "{}", w.radius);
        assert!((w.area(0) - 0.5).abs() < 1e-6);
    }

    /// On a facet of a sphere with smooth normals the lifted midpoint lies near the sphere.
    #[test]
    fn lifting_follows_the_curve() {
        let mut scene = scene(Affine3A::IDENTITY);
        let dirs = [Vec3::X, Vec3::new(1.0, 0.3, 0.0).normalize(), Vec3::new(1.0, 0.0, 0.3).normalize()];
        scene.meshes[0].positions = dirs.to_vec();
        scene.meshes[0].normals = dirs.to_vec();
        let w = World::new(&scene);
        let b = [1.0 / 3.0; 3];
        let p = w.point(0, b);
        let r = |x: Vec3A| (Vec3::from(x) + w.origin).length();
        let (flat, lifted) = (r(p.position), r(w.lifted(0, b, &p)));
        assert!(flat < 0.995 && (lifted - 1.0).abs() < 0.5 * (1.0 - flat), "{flat} {lifted}");
    }
}
