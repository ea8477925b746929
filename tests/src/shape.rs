//! Indexed triangles in the making: quads, boxes, surfaces of revolution, spheres, arches.
//!
//! Front faces are counter-clockwise and normals point to the front.

use std::f64::consts::TAU;

use glam::{Affine3A, Vec2, Vec3};

/// Geometry of one primitive.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shape {
    /// Metres.
    pub positions: Vec<Vec3>,
    /// Unit normals; may be empty.
    pub normals: Vec<Vec3>,
    /// `TEXCOORD_0`; may be empty.
    pub uvs: Vec<Vec2>,
    /// Three indices each.
    pub triangles: Vec<[u32; 3]>,
}

/// Which sides of a box are there, in the order -X, +X, -Y, +Y, -Z, +Z.
pub type Sides = [bool; 6];

/// All six sides of a box.
pub const ALL: Sides = [true; 6];

/// A box that stands on something: no bottom.
pub const NO_BOTTOM: Sides = [true, true, false, true, true, true];

/// A box that hangs from something: no top.
pub const NO_TOP: Sides = [true, true, true, false, true, true];

/// Rounds a double; the callers' numbers are a few metres.
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
fn single(x: f64) -> f32 {
    x as f32
}

/// Sine and cosine of `turns` full turns, computed in double precision so that rounding hides the differences
/// between mathematical libraries.
#[must_use]
pub fn sin_cos(turns: f64) -> (f32, f32) {
    let (s, c) = (turns * TAU).sin_cos();
    (single(s), single(c))
}

impl Shape {
    fn next(&self) -> u32 {
        u32::try_from(self.positions.len()).expect("test shapes have fewer than 2^32 vertices")
    }

    /// Adds a flat convex polygon, counter-clockwise from the front.
    pub fn polygon(&mut self, corners: &[Vec3]) {
        let first = self.next();
        let n = u32::try_from(corners.len()).expect("few corners");
        // Newell's sum also stands collinear leading corners.
        let normal: Vec3 = (0..corners.len())
            .map(|i| (corners[i] - corners[0]).cross(corners[(i + 1) % corners.len()] - corners[0]))
            .sum();
        self.positions.extend_from_slice(corners);
        self.normals.extend(corners.iter().map(|_| normal.normalize_or(Vec3::Y)));
        self.triangles.extend((1..n - 1).map(|i| [first, first + i, first + i + 1]));
    }

    /// Adds a flat quad, counter-clockwise from the front.
    pub fn quad(&mut self, corners: [Vec3; 4]) {
        self.polygon(&corners);
    }

    /// Adds a flat grid of `n` x `m` cells; `u` x `v` points to the front.
    pub fn grid(&mut self, origin: Vec3, u: Vec3, v: Vec3, n: u16, m: u16) {
        let first = self.next();
        let normal = u.cross(v).normalize_or(Vec3::Y);
        for j in 0..=m {
            for i in 0..=n {
                let at = Vec2::new(f32::from(i) / f32::from(n), f32::from(j) / f32::from(m));
                self.positions.push(origin + u * at.x + v * at.y);
                self.normals.push(normal);
            }
        }
        let row = u32::from(n) + 1;
        for j in 0..u32::from(m) {
            for i in 0..u32::from(n) {
                let a = first + j * row + i;
                self.triangles.extend([[a, a + 1, a + 1 + row], [a, a + 1 + row, a + row]]);
            }
        }
    }

    /// Adds the chosen sides of a box, facing out; `min` and `max` in metres.
    pub fn cuboid(&mut self, min: impl Into<Vec3>, max: impl Into<Vec3>, sides: Sides) {
        let (a, b) = (min.into(), max.into());
        let p = |x: bool, y: bool, z: bool| {
            Vec3::new(if x { b.x } else { a.x }, if y { b.y } else { a.y }, if z { b.z } else { a.z })
        };
        let (o, i) = (false, true);
        let quads = [
            [p(o, o, o), p(o, o, i), p(o, i, i), p(o, i, o)],
            [p(i, o, i), p(i, o, o), p(i, i, o), p(i, i, i)],
            [p(o, o, o), p(i, o, o), p(i, o, i), p(o, o, i)],
            [p(o, i, i), p(i, i, i), p(i, i, o), p(o, i, o)],
            [p(i, o, o), p(o, o, o), p(o, i, o), p(i, i, o)],
            [p(o, o, i), p(i, o, i), p(i, i, i), p(o, i, i)],
        ];
        for (quad, _) in quads.into_iter().zip(sides).filter(|(_, there)| *there) {
            self.quad(quad);
        }
    }

    /// Adds a surface of revolution about the vertical through the origin. `profile` holds radius and height in metres,
    /// from bottom to top for a surface that faces out; it is smooth along and around.
    pub fn lathe(&mut self, profile: &[Vec2], segments: u16) {
        let first = self.next();
        let rows = profile.len();
        for (r, p) in profile.iter().enumerate() {
            let along = profile[(r + 1).min(rows - 1)] - profile[r.saturating_sub(1)];
            let out = Vec2::new(along.y, -along.x).normalize_or(Vec2::X);
            for s in 0..=segments {
                let (sin, cos) = sin_cos(f64::from(s % segments) / f64::from(segments));
                self.positions.push(Vec3::new(p.x * cos, p.y, -p.x * sin));
                self.normals.push(Vec3::new(out.x * cos, out.y, -out.x * sin).normalize_or(Vec3::Y));
            }
        }
        let row = u32::from(segments) + 1;
        let mut a = first;
        for pair in profile.windows(2) {
            for _ in 0..segments {
                // A radius of 0 is a pole: one triangle of the two is empty there.
                if 0.0 < pair[0].x {
                    self.triangles.push([a, a + 1, a + 1 + row]);
                }
                if 0.0 < pair[1].x {
                    self.triangles.push([a, a + 1 + row, a + row]);
                }
                a += 1;
            }
            a += 1;
        }
    }

    /// Adds a sphere of `20 * 4^level` triangles about the origin; `inward` turns its front to the centre.
    pub fn icosphere(&mut self, radius: f32, level: u32, inward: bool) {
        let first = self.next();
        let (points, faces) = icosahedron(level);
        let side = if inward { -1.0 } else { 1.0 };
        self.positions.extend(points.iter().map(|p| *p * radius));
        self.normals.extend(points.iter().map(|p| *p * side));
        self.triangles.extend(faces.iter().map(|&[a, b, c]| {
            let [b, c] = if inward { [c, b] } else { [b, c] };
            [first + a, first + b, first + c]
        }));
    }

    /// Adds what `other` holds.
    pub fn append(&mut self, other: &Self) {
        let first = self.next();
        self.positions.extend_from_slice(&other.positions);
        self.normals.extend_from_slice(&other.normals);
        self.uvs.extend_from_slice(&other.uvs);
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|i| i + first)));
    }

    /// The shape moved by a rigid motion or uniform scale; a mirroring one also turns the triangles around.
    #[must_use]
    pub fn transformed(mut self, t: Affine3A) -> Self {
        for p in &mut self.positions {
            *p = t.transform_point3(*p);
        }
        for n in &mut self.normals {
            *n = t.transform_vector3(*n).normalize_or(Vec3::Y);
        }
        if t.matrix3.determinant() < 0.0 {
            for t in &mut self.triangles {
                t.swap(1, 2);
            }
        }
        self
    }

    /// Moved by `offset` metres.
    #[must_use]
    pub fn moved(self, offset: impl Into<Vec3>) -> Self {
        self.transformed(Affine3A::from_translation(offset.into()))
    }

    /// With front and back exchanged.
    #[must_use]
    pub fn inside_out(mut self) -> Self {
        for n in &mut self.normals {
            *n = -*n;
        }
        for t in &mut self.triangles {
            t.swap(1, 2);
        }
        self
    }

    /// Without normals, so that faces are flat.
    #[must_use]
    pub fn flat(mut self) -> Self {
        self.normals.clear();
        self
    }

    /// Texture coordinates from the two axes across each vertex normal's largest component, one repeat every `metres`.
    #[must_use]
    pub fn planar_uvs(mut self, metres: f32) -> Self {
        self.uvs = self
            .positions
            .iter()
            .zip(&self.normals)
            .map(|(p, n)| {
                let n = n.abs();
                let (u, v) = if n.x.max(n.z) < n.y {
                    (p.x, p.z)
                } else if n.z < n.x {
                    (p.z, -p.y)
                } else {
                    (p.x, -p.y)
                };
                Vec2::new(u, v) / metres
            })
            .collect();
        self
    }

    /// Texture coordinates that map the corners of a single quad to the corners of the image, first corner bottom left.
    #[must_use]
    pub fn corner_uvs(mut self) -> Self {
        let corners = [Vec2::Y, Vec2::ONE, Vec2::X, Vec2::ZERO];
        self.uvs = (0..self.positions.len()).map(|i| corners[i % 4]).collect();
        self
    }
}

/// A wall with one round-arched opening, in the plane z = 0 (front, facing +Z) and z = -`thickness` (back).
#[derive(Clone, Copy, Debug)]
pub struct ArchedWall {
    /// Left and right end, metres.
    pub x: [f32; 2],
    /// Bottom and top.
    pub y: [f32; 2],
    /// Left and right jamb; the arch is a half circle over them.
    pub opening: [f32; 2],
    /// Bottom of the opening; equal to `y[0]` for a door.
    pub sill: f32,
    /// Where the jambs end and the arch begins.
    pub spring: f32,
    /// Metres.
    pub thickness: f32,
    /// Flat pieces of the arch.
    pub pieces: u16,
}

impl ArchedWall {
    /// Front with reveals, and back; the four outer edges stay open.
    #[must_use]
    pub fn shapes(&self) -> [Shape; 2] {
        let [l, r] = self.opening;
        let (centre, radius) = (0.5 * (l + r), 0.5 * (r - l));
        // From the right jamb over the crown to the left one, counter-clockwise seen from the front.
        let arch: Vec<Vec2> = (0..=self.pieces)
            .map(|i| {
                let (sin, cos) = sin_cos(0.5 * f64::from(i) / f64::from(self.pieces));
                match i {
                    0 => Vec2::new(r, self.spring),
                    _ if i == self.pieces => Vec2::new(l, self.spring),
                    _ => Vec2::new(centre + radius * cos, self.spring + radius * sin),
                }
            })
            .collect();
        let mut outline: Vec<[Vec2; 4]> = Vec::new();
        let mut rect = |x0: f32, x1: f32, y0: f32, y1: f32| {
            if x0 < x1 && y0 < y1 {
                let c = [Vec2::new(x0, y0), Vec2::new(x1, y0), Vec2::new(x1, y1), Vec2::new(x0, y1)];
                outline.push(c);
            }
        };
        for [y0, y1] in [[self.y[0], self.sill], [self.sill, self.spring], [self.spring, self.y[1]]] {
            rect(self.x[0], l, y0, y1);
            rect(r, self.x[1], y0, y1);
        }
        rect(l, r, self.y[0], self.sill);
        for pair in arch.windows(2) {
            let top = |p: Vec2| Vec2::new(p.x, self.y[1]);
            outline.push([pair[1], pair[0], top(pair[0]), top(pair[1])]);
        }
        let (mut shape, mut behind) = (Shape::default(), Shape::default());
        let back = -self.thickness;
        for quad in outline {
            shape.quad(quad.map(|p| p.extend(0.0)));
            let [a, b, c, d] = quad;
            behind.quad([b, a, d, c].map(|p| p.extend(back)));
        }
        // Reveals face into the opening.
        let mut ring = Vec::new();
        if self.sill < self.spring {
            ring.push(Vec2::new(r, self.sill));
        }
        ring.extend(&arch);
        if self.sill < self.spring {
            ring.push(Vec2::new(l, self.sill));
        }
        if self.y[0] < self.sill {
            ring.push(ring[0]);
        }
        for pair in ring.windows(2) {
            let (a, b) = (pair[0], pair[1]);
            shape.quad([a.extend(0.0), b.extend(0.0), b.extend(back), a.extend(back)]);
        }
        [shape, behind]
    }
}

fn icosahedron(level: u32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let g = 0.5 * (1.0 + 5.0f32.sqrt());
    let mut points: Vec<Vec3> = [
        [-1.0, g, 0.0],
        [1.0, g, 0.0],
        [-1.0, -g, 0.0],
        [1.0, -g, 0.0],
        [0.0, -1.0, g],
        [0.0, 1.0, g],
        [0.0, -1.0, -g],
        [0.0, 1.0, -g],
        [g, 0.0, -1.0],
        [g, 0.0, 1.0],
        [-g, 0.0, -1.0],
        [-g, 0.0, 1.0],
    ]
    .map(|p| Vec3::from(p).normalize())
    .into();
    // Faces follow from the points: three neighbours at the edge length, turned outwards.
    let edge = points[0].distance(points[1]) * 1.01;
    let mut faces = Vec::new();
    for a in 0..12u32 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                let [p, q, r] = [a, b, c].map(|i| points[i as usize]);
                if p.distance(q) < edge && q.distance(r) < edge && r.distance(p) < edge {
                    let out = 0.0 < (q - p).cross(r - p).dot(p);
                    faces.push(if out { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    for _ in 0..level {
        let mut middles = std::collections::BTreeMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let m = (points[a as usize] + points[b as usize]).normalize();
                points.push(m);
                u32::try_from(points.len() - 1).expect("few points")
            })
        };
        faces = faces
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    (points, faces)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Six times the signed volume, positive for a closed surface that faces out.
    fn volume(s: &Shape) -> f32 {
        s.triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| s.positions[i as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }

    fn normals_agree_with_faces(s: &Shape) {
        for t in &s.triangles {
            let [a, b, c] = t.map(|i| s.positions[i as usize]);
            let face = (b - a).cross(c - a);
            assert!(0.0 < face.length(), "empty triangle {t:?}");
            for i in t {
                assert!(0.2 < face.normalize().dot(s.normals[*i as usize]), "{t:?}");
            }
        }
    }

    #[test]
    fn closed_shapes_face_out_and_have_the_right_volume() {
        let mut cuboid = Shape::default();
        cuboid.cuboid([1.0, 2.0, 3.0], [2.0, 4.0, 6.0], ALL);
        assert!((volume(&cuboid) - 6.0).abs() < 1e-4);
        let mut sphere = Shape::default();
        sphere.icosphere(1.0, 3, false);
        assert_eq!(sphere.triangles.len(), 1280);
        assert!((volume(&sphere) / 4.19 - 1.0).abs() < 0.02);
        let mut inward = Shape::default();
        inward.icosphere(1.0, 0, true);
        assert!(volume(&inward) < -2.0);
        let mut lathe = Shape::default();
        let profile = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(Vec2::from);
        lathe.lathe(&profile, 64);
        assert!((volume(&lathe) / 3.1416 - 1.0).abs() < 0.01);
        for s in [cuboid, sphere, inward] {
            normals_agree_with_faces(&s);
        }
    }

    #[test]
    fn an_arched_wall_has_consistent_normals_and_the_right_area() {
        let wall = ArchedWall {
            x: [0.0, 4.0],
            y: [0.0, 5.0],
            opening: [1.0, 3.0],
            sill: 1.0,
            spring: 2.0,
            thickness: 0.5,
            pieces: 64,
        };
        let [mut shape, back] = wall.shapes();
        // Reveals look into the opening: towards its middle.
        let middle = Vec3::new(2.0, 2.0, -0.25);
        let reveals = shape.positions.iter().zip(&shape.normals).filter(|(_, n)| n.z.abs() < 0.5);
        assert!(reveals.clone().all(|(p, n)| 0.0 < (middle - *p).dot(*n)));
        assert_eq!(reveals.count(), 4 * (64 + 3));
        shape.append(&back);
        normals_agree_with_faces(&shape);
        let area: f32 = shape
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| shape.positions[i as usize]);
                0.5 * (b - a).cross(c - a).length()
            })
            .sum();
        let hole = 2.0 + 0.5 * std::f32::consts::PI;
        let rim = 2.0 + 1.0 + 1.0 + std::f32::consts::PI;
        assert!((area - (2.0 * (20.0 - hole) + 0.5 * rim)).abs() < 0.01, "{area}");
    }
}
