//! Emissive triangles.

use crate::geom::World;
use crate::geom::world::luminance;
use crate::light::many::FEW_EMITTERS;
use crate::light::tree::{Receiver, Shine, TreeLight};
use crate::sample::discrete::Cdf;
use crate::sample::spherical::SphericalTriangle;
use crate::sample::warp::square_to_triangle;
use crate::scene::model::Scene;
use glam::{DVec3, Vec3A};

/// The emissive triangles of a scene and how one of them is chosen.
#[derive(Clone, Debug, Default)]
pub struct Emitters {
    list: Vec<Emitter>,
    /// Index into `list` for each world triangle, `u32::MAX` where it does not emit; empty if none does.
    of_triangle: Vec<u32>,
    groups: Vec<Group>,
    /// For each entry of `list` the group that it belongs to, `u32::MAX` for none.
    group: Vec<u32>,
}

/// Points of triangles whose squared extent is more than this part of the squared distance are chosen by solid angle.
const WIDE_FROM: f32 = 0.05;

/// Emissive surfaces wider than this part of the scene are no lamps in media: any direction may find them.
const WIDE: f32 = 0.5;

/// The emissive triangles of one surface, as a light in media.
#[derive(Clone, Debug)]
pub struct Group {
    /// Mean of its triangles' centres by power, metres.
    pub centre: Vec3A,
    /// No corner is farther from the centre, metres.
    pub radius: f32,
    /// Mean luminous intensity over all directions, candela.
    pub intensity: f32,
    first: usize,
    choice: Cdf,
}

/// A point of a group.
#[derive(Clone, Copy, Debug)]
pub struct GroupSample {
    /// World triangle.
    pub triangle: u32,
    /// Barycentric weights.
    pub bary: [f32; 3],
    /// Metres, relative to the world's origin.
    pub position: Vec3A,
    /// Unit normal.
    pub normal: Vec3A,
    /// Shines to both sides.
    pub both_sides: bool,
    /// Density per area, choice of the triangle included.
    pub pdf: f32,
}

#[derive(Clone, Copy, Debug)]
struct Emitter {
    triangle: u32,
    corners: [Vec3A; 3],
    centre: Vec3A,
    normal: Vec3A,
    area: f32,
    /// Largest squared distance of a corner from the centre.
    extent2: f32,
    /// Mean luminance, nits.
    luminance: f32,
    both_sides: bool,
}

/// A point chosen on an emissive triangle.
#[derive(Clone, Copy, Debug)]
pub struct EmitterSample {
    /// World triangle.
    pub triangle: u32,
    /// Barycentric weights.
    pub bary: [f32; 3],
    /// Unit direction towards it.
    pub wi: Vec3A,
    /// Distance, metres.
    pub distance: f32,
    /// Density per steradian, choice of the triangle included: 0 where the side that shines is not seen, or along its plane.
    pub pdf_solid_angle: f32,
    /// Density per area, likewise.
    pub pdf_area: f32,
}

impl Emitters {
    /// Finds the emissive triangles among those that rays can hit.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the loader admits fewer than 2^32 triangles")]
    pub fn new(scene: &Scene, world: &World) -> Self {
        let mut list = Vec::new();
        for (i, s) in scene.surfaces.iter().enumerate() {
            let m = &scene.materials[s.material];
            if m.emission.max_element() <= 0.0 || !s.casts_shadow || m.unlit {
                continue;
            }
            for triangle in world.first_triangle[i]..world.first_triangle[i + 1] {
                list.extend(Emitter::new(scene, world, triangle, m.double_sided));
            }
        }
        if !list.iter().any(|e| 0.0 < e.power() && e.power().is_finite()) {
            return Self::default();
        }
        let mut of_triangle = vec![u32::MAX; world.len()];
        for (k, e) in list.iter().enumerate() {
            of_triangle[e.triangle as usize] = k as u32;
        }
        let mut group = vec![u32::MAX; list.len()];
        let mut first = 0;
        let mut groups = Vec::new();
        for members in list.chunk_by(|a, b| world.surface(a.triangle) == world.surface(b.triangle)) {
            if let Some(g) = Group::new(first, members).filter(|g| g.radius < WIDE * world.radius) {
                group[first..first + members.len()].fill(groups.len() as u32);
                groups.push(g);
            }
            first += members.len();
        }
        Self { list, of_triangle, groups, group }
    }

    /// Whether a triangle belongs to a group that is near a place, see [`Group::is_near`].
    #[must_use]
    pub fn is_near(&self, triangle: u32, p: Vec3A) -> bool {
        let group = self.index(triangle).and_then(|k| self.group_of(k));
        group.is_some_and(|g| self.groups[g].is_near(p))
    }

    /// Whether a triangle that emits belongs to one of the groups.
    #[must_use]
    pub fn is_grouped(&self, triangle: u32) -> bool {
        self.index(triangle).is_some_and(|k| self.group[k] != u32::MAX)
    }

    /// Which of the emissive triangles a world triangle is.
    fn index(&self, triangle: u32) -> Option<usize> {
        self.of_triangle.get(triangle as usize).filter(|k| **k != u32::MAX).map(|k| *k as usize)
    }

    /// The group of an emissive triangle.
    #[must_use]
    pub fn group_of(&self, k: usize) -> Option<usize> {
        Some(self.group[k] as usize).filter(|_| self.group[k] != u32::MAX)
    }

    /// An emissive triangle as trees see it.
    #[must_use]
    pub fn in_tree(&self, k: usize) -> TreeLight {
        let e = &self.list[k];
        let [a, b, c] = e.corners;
        let shine = if e.both_sides { Shine::Everywhere } else { Shine::Cosine { normal: e.normal } };
        TreeLight { min: a.min(b).min(c), max: a.max(b).max(c), intensity: e.area * e.luminance, shine }
    }

    /// Emissive surfaces that are not wide.
    #[must_use]
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// A point of a group, by power.
    #[must_use]
    pub fn sample_group(&self, group: &Group, u: f32, v: [f32; 2]) -> GroupSample {
        let (k, _) = group.choice.sample(u);
        self.point_on(group.first + k, group.choice.pdf(k), v)
    }

    /// A point of an emissive triangle that was chosen with a probability.
    #[must_use]
    pub fn point_on(&self, k: usize, probability: f32, v: [f32; 2]) -> GroupSample {
        let e = &self.list[k];
        let bary = square_to_triangle(v);
        GroupSample {
            triangle: e.triangle,
            bary,
            position: e.corners[0] * bary[0] + e.corners[1] * bary[1] + e.corners[2] * bary[2],
            normal: e.normal,
            both_sides: e.both_sides,
            pdf: probability / e.area,
        }
    }

    /// Bytes that they take.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.list.len() * (size_of::<Emitter>() + size_of::<u32>())
            + self.of_triangle.len() * size_of::<u32>()
    }

    /// Whether nothing emits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Number of emissive triangles.
    #[must_use]
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Chooses a point on one of a few emissive triangles to light `at`, each of which is weighed.
    #[must_use]
    pub fn sample(&self, at: &Receiver, u: f32, v: [f32; 2]) -> Option<EmitterSample> {
        let (k, probability) = self.choose(at, u)?;
        self.sample_on(k, probability, at, v)
    }

    /// A point on an emissive triangle that was chosen with a probability, as `at` sees it.
    #[must_use]
    pub fn sample_on(&self, k: usize, probability: f32, at: &Receiver, v: [f32; 2]) -> Option<EmitterSample> {
        let e = &self.list[k];
        let wide = e.seen_wide(at);
        let bary = match &wide {
            Some(seen) => e.towards(at.position, seen.sample(v)),
            None => square_to_triangle(v),
        };
        let x = e.corners[0] * bary[0] + e.corners[1] * bary[1] + e.corners[2] * bary[2];
        let d = x - at.position;
        let distance = d.length();
        let wi = d / distance;
        if !wi.is_finite() {
            return None;
        }
        let pdf_solid_angle = probability * e.density(wide.as_ref(), wi, distance);
        let pdf_solid_angle = if pdf_solid_angle.is_finite() { pdf_solid_angle } else { 0.0 };
        let pdf_area = probability / e.area;
        Some(EmitterSample { triangle: e.triangle, bary, wi, distance, pdf_solid_angle, pdf_area })
    }

    /// Density per steradian of the points of `triangle`, chosen with a probability that depends on which of the emissive triangles it is,
    /// where it is seen in direction `wi` at `distance`. 0 if it does not emit.
    #[must_use]
    pub fn pdf(
        &self,
        at: &Receiver,
        triangle: u32,
        wi: Vec3A,
        distance: f32,
        probability: impl FnOnce(usize) -> f32,
    ) -> f32 {
        let Some(k) = self.index(triangle) else { return 0.0 };
        let e = &self.list[k];
        let density = probability(k) * e.density(e.seen_wide(at).as_ref(), wi, distance);
        if density.is_finite() { density } else { f32::MAX }
    }

    /// With which probability [`Emitters::sample`] chooses one of a few.
    #[must_use]
    pub fn probability(&self, at: &Receiver, k: usize) -> f32 {
        let total: f32 = self.list.iter().map(|e| e.importance(at)).sum();
        if 0.0 < total { self.list[k].importance(at) / total } else { 0.0 }
    }

    /// One of a few.
    fn choose(&self, at: &Receiver, u: f32) -> Option<(usize, f32)> {
        let mut weights = [0.0f32; FEW_EMITTERS];
        let mut total = 0.0;
        for (w, e) in weights.iter_mut().zip(&self.list) {
            *w = e.importance(at);
            total += *w;
        }
        if !(0.0 < total && total.is_finite()) {
            return None;
        }
        let mut rest = u * total;
        let mut last = None;
        for (k, &w) in weights[..self.list.len()].iter().enumerate() {
            if 0.0 < w {
                last = Some((k, w / total));
                if rest < w {
                    break;
                }
                rest -= w;
            }
        }
        last
    }
}

/// A group is near where it is not farther than this many of its radii.
const NEAR: f32 = 2.0;

impl Group {
    /// Whether it fills so much of what a place sees that directions find it by chance.
    #[must_use]
    pub fn is_near(&self, p: Vec3A) -> bool {
        (self.centre - p).length_squared() < NEAR * NEAR * self.radius * self.radius
    }

    fn new(first: usize, members: &[Emitter]) -> Option<Self> {
        let choice = Cdf::new(members.iter().map(|e| f64::from(e.power())))?;
        let power: f32 = members.iter().map(Emitter::power).sum();
        let centre = members.iter().map(|e| e.centre * (e.power() / power)).sum::<Vec3A>();
        let corners = members.iter().flat_map(|e| e.corners);
        let radius = corners.map(|c| (c - centre).length()).fold(0.0, f32::max);
        // A patch of 1 nit and 1 m^2 sends pi lumens.
        Some(Self { centre, radius, intensity: 0.25 * power, first, choice })
    }
}

impl Emitter {
    fn new(scene: &Scene, world: &World, triangle: u32, both_sides: bool) -> Option<Self> {
        let corners = world.corners(triangle).map(Vec3A::from);
        let normal = world.geometric_normal(triangle);
        let area = world.area(triangle);
        if normal == Vec3A::ZERO || !(0.0 < area && area.is_finite()) {
            return None;
        }
        let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
        let extent2 = corners.iter().map(|c| (*c - centre).length_squared()).fold(0.0, f32::max);
        let luminance = mean_luminance(scene, world, triangle);
        Some(Self { triangle, corners, centre, normal, area, extent2, luminance, both_sides })
    }

    fn power(&self) -> f32 {
        self.area * self.luminance * if self.both_sides { 2.0 } else { 1.0 }
    }

    /// Density per steradian of its points, which are chosen by area or, where it is seen wide, by solid angle.
    fn density(&self, wide: Option<&SphericalTriangle>, wi: Vec3A, distance: f32) -> f32 {
        let cos = -wi.dot(self.normal);
        let cos = if self.both_sides { cos.abs() } else { cos };
        match wide {
            _ if cos <= 0.0 => 0.0,
            #[expect(clippy::cast_possible_truncation, reason = "a density")]
            Some(seen) => seen.solid_angle().recip() as f32,
            None => distance * distance / (self.area * cos),
        }
    }

    /// The triangle as a place sees it, where its points differ so much in distance that they are chosen by solid angle: next to a tube of neon light
    /// nearly all light comes from the nearest part. By way of media its parts that are seen edge-on count as well, so there they are chosen by area.
    fn seen_wide(&self, at: &Receiver) -> Option<SphericalTriangle> {
        let d2 = (self.centre - at.position).length_squared();
        let wide = at.below == 0.0 && WIDE_FROM * d2 < self.extent2;
        wide.then(|| SphericalTriangle::new(at.position, &self.corners)).flatten()
    }

    /// The point that a place sees in a direction, barycentric.
    #[expect(clippy::cast_possible_truncation, reason = "computed in f64 and stored in f32")]
    fn towards(&self, from: Vec3A, wi: DVec3) -> [f32; 3] {
        let [a, b, c] = self.corners.map(|c| c.as_dvec3() - from.as_dvec3());
        let volumes = [wi.dot(b.cross(c)), wi.dot(c.cross(a)), wi.dot(a.cross(b))];
        let sum: f64 = volumes.iter().sum();
        let [u, v, w] = volumes.map(|x| (x / sum).clamp(0.0, 1.0));
        let all = u + v + w;
        if all.is_finite() { [u / all, v / all, w / all].map(|x| x as f32) } else { [1.0 / 3.0; 3] }
    }

    /// Rough share of the light at `p`: zero only where the triangle lies wholly behind the
    /// receiver or the receiver behind it.
    fn importance(&self, at: &Receiver) -> f32 {
        let (p, n) = (at.position, at.normal);
        let above = self.corners.iter().any(|c| at.below < (*c - p).dot(n));
        let side = (p - self.centre).dot(self.normal);
        if !above || (!self.both_sides && side <= at.below) {
            return 0.0;
        }
        let d = self.centre - p;
        let d2 = d.length_squared();
        // Close to the triangle its centre says little; there only its size counts.
        if d2 <= 4.0 * self.extent2 {
            return self.luminance * self.area / self.extent2.max(d2);
        }
        let inv = 1.0 / d2.sqrt();
        let receiver = (d.dot(n) * inv).max(0.05);
        let emitter = (side.abs() * inv).max(0.05);
        self.luminance * self.area * receiver * emitter / d2
    }
}

/// Mean emitted luminance over the triangle, by a grid of points that follows the texture's
/// resolution. A dark texture keeps a small share of its factor: a bright texel between the
/// points must not have probability zero.
fn mean_luminance(scene: &Scene, world: &World, triangle: u32) -> f32 {
    let (surface, _) = world.locate(triangle);
    let m = &scene.materials[scene.surfaces[surface].material];
    let factor = luminance(m.emission);
    if m.emission_texture.is_none() {
        return factor;
    }
    let n = 8u16;
    let mut sum = 0.0;
    for i in 0..n {
        for j in 0..n {
            let u = [(f32::from(i) + 0.5) / f32::from(n), (f32::from(j) + 0.5) / f32::from(n)];
            sum += luminance(world.shade(scene, triangle, square_to_triangle(u)).emission);
        }
    }
    (sum / f32::from(n * n)).max(1e-3 * factor)
}
