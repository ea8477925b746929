//! What a ray does where it meets a surface: passes, is reflected, or ends.

use crate::geom::Hit;
use crate::geom::shade::{Met, Shade};
use crate::geom::world::SurfacePoint;
use crate::sample::Sequence;
use crate::scene::model::Rgb;
use crate::transport::path::{Kernel, Vertex};
use glam::{Vec3, Vec3A};

/// A ray's hit, shaded.
pub(crate) struct Encounter {
    at: SurfacePoint,
    pub(crate) shade: Shade,
    /// Met from the front side.
    front: bool,
    /// The side that was met reflects.
    active: bool,
    /// The side that was met is a light.
    pub(crate) emits: bool,
    /// Nothing in the scene lets light pass.
    opaque: bool,
}

/// How a ray goes on.
pub(crate) enum Onward {
    /// It ends here.
    Absorbed,
    /// It crosses the surface and goes on from `origin` in its direction.
    Through { tint: Rgb, origin: Vec3A },
    /// It is reflected. The reflectance may be black.
    Reflected { vertex: Vertex, reflectance: Rgb },
}

impl<const AIR: bool> Kernel<'_, AIR> {
    pub(crate) fn encounter(&self, hit: &Hit, direction: Vec3A) -> Encounter {
        let at = self.world.point(hit.triangle, hit.bary);
        let Met { shade, double_sided, unlit } = self.world.met(self.scene, hit.triangle, hit.bary);
        let front = direction.dot(at.geometric_normal) < 0.0;
        let active = front || double_sided;
        let emits = active && shade.emission != Vec3::ZERO && !unlit;
        Encounter { at, shade, front, active, emits, opaque: self.bvh.is_opaque() }
    }
}

impl Encounter {
    /// Unit normal of the plane, on the side that was met.
    pub(crate) fn normal(&self) -> Vec3A {
        if self.front { self.at.geometric_normal } else { -self.at.geometric_normal }
    }

    /// Where light is reflected, and how much of it; what passes is left out.
    pub(crate) fn reflection(&self) -> (Vertex, Rgb) {
        let vertex = Vertex::front(&self.at);
        let cover = if self.active { self.shade.cover } else { 0.0 };
        (if self.front { vertex } else { vertex.turned() }, self.shade.albedo * cover)
    }

    /// Chooses between passing and reflection by their strengths.
    pub(crate) fn onward(&self, sequence: &mut Sequence) -> Onward {
        if self.opaque {
            if !self.active {
                return Onward::Absorbed;
            }
            let vertex = Vertex::front(&self.at);
            let vertex = if self.front { vertex } else { vertex.turned() };
            return Onward::Reflected { vertex, reflectance: self.shade.albedo };
        }
        let passing = self.shade.pass.max_element();
        let reflecting = if self.active { self.shade.cover } else { 0.0 };
        if passing + reflecting <= 0.0 {
            return Onward::Absorbed;
        }
        let chance = passing / (passing + reflecting);
        let side = if self.front { 1.0 } else { -1.0 };
        if 0.0 < chance && (1.0 <= chance || sequence.next4()[0] < chance) {
            let origin = self.at.position - self.at.geometric_normal * (side * self.at.offset);
            return Onward::Through { tint: self.shade.pass / chance, origin };
        }
        let vertex = Vertex::front(&self.at);
        let vertex = if self.front { vertex } else { vertex.turned() };
        let reflectance = self.shade.albedo * (reflecting / (1.0 - chance));
        Onward::Reflected { vertex, reflectance }
    }
}
