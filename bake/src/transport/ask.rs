//! What solvers ask for. Each question goes to the kernel without media where there are none.

use crate::sample::Sequence;
use crate::scene::model::Rgb;
use crate::transport::around::Place;
use crate::transport::path::{Estimate, Kernel, Vertex};
use glam::Vec3A;

impl Kernel<'_> {
    /// One path that starts at `start` in the direction that `u` chooses. The rest of its numbers come
    /// from `sequence`.
    #[must_use]
    pub fn estimate(&self, start: &Vertex, u: [f32; 2], sequence: &mut Sequence) -> Estimate {
        match self.without_air() {
            Some(clear) => clear.whole(start, u, sequence),
            None => self.whole(start, u, sequence),
        }
    }

    /// What suns and lamps, and many emissive triangles, bring straight away, and what media scatter of lamps' light on the first leg, `E / pi`, nits: together with
    /// [`Kernel::arriving`] an estimate of the whole.
    pub(crate) fn small(&self, at: &Vertex, sequence: &mut Sequence) -> Estimate {
        match self.without_air() {
            Some(clear) => clear.small_part(at, sequence),
            None => self.small_part(at, sequence),
        }
    }

    /// As [`Kernel::estimate`], without what [`Kernel::small`] finds.
    pub(crate) fn arriving(&self, start: &Vertex, u: [f32; 2], sequence: &mut Sequence) -> Estimate {
        match self.without_air() {
            Some(clear) => clear.arriving_part(start, u, sequence),
            None => self.arriving_part(start, u, sequence),
        }
    }

    /// One sample of the light at a place in the air: `visit` hears of directions and of what arrives from there, for
    /// [`Finds::Radiance`](super::around::Finds::Radiance) in nits times steradian. `u` chooses the direction of a path. Light straight from suns and lamps
    /// is part of a share of the samples, those with `straight`, which stands for as many. Lights whose direct part the game adds bring only the rest.
    pub fn sample_around(
        &self,
        from: Place,
        u: [f32; 2],
        straight: Option<f32>,
        sequence: &mut Sequence,
        rays: &mut u32,
        visit: &mut dyn FnMut(Vec3A, Rgb),
    ) {
        match self.without_air() {
            Some(clear) => clear.sample(from, u, straight, sequence, rays, visit),
            None => self.sample(from, u, straight, sequence, rays, visit),
        }
    }
}
