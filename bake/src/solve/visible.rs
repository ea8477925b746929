//! Which parts of a texel can be seen, and from which side.

use crate::geom::texel::TexelSampler;
use crate::geom::world::luminance;
use crate::light::Beams;
use crate::sample::{Sequence, sequence};
use crate::transport::path::First;
use crate::transport::{Kernel, Vertex};
use glam::Vec3A;

/// Random numbers of looks belong to this domain and the page; see [`sequence::key`].
const DOMAIN: u64 = 0x4c50;

/// Whether a texel lies in the open or inside other geometry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Validity {
    /// In the open, at least in part; hidden parts are left out of the mean.
    #[default]
    Valid,
    /// Wholly behind the back of a one-sided surface.
    Hidden,
    /// Black, and nothing but backs of double-sided surfaces around it: probably the inside of a body.
    Enclosed,
}

/// Rings around texels in the open within which a texel that seems to lie inside a double-sided body is
/// filled from them. Bicubic filters reach two texels; deeper ones keep their black, because a room
/// without light looks the same from inside.
const ENCLOSED_RINGS: usize = 2;

/// Whether any texel of a page within [`ENCLOSED_RINGS`] of a texel is one that counts.
pub(crate) fn is_beside([width, height]: [usize; 2], texel: usize, counts: impl Fn(usize) -> bool) -> bool {
    let around = |c: usize, n: usize| c.saturating_sub(ENCLOSED_RINGS)..(c + ENCLOSED_RINGS + 1).min(n);
    around(texel / width, height).any(|y| around(texel % width, width).any(|x| counts(y * width + x)))
}

/// Which side of a surface is gathered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Side {
    #[default]
    Front,
    BackOfDoubleSided,
}

/// The point on a side of a surface from which rays start; `None` where it has no area, or where the
/// back is asked for and the surface has none.
pub(super) fn receiver(kernel: &Kernel<'_>, triangle: u32, bary: [f32; 3], side: Side) -> Option<Vertex> {
    let at = kernel.world.point(triangle, bary);
    if at.geometric_normal == Vec3A::ZERO {
        return None;
    }
    let front = Vertex::front(&at);
    match side {
        Side::Front => Some(Vertex { position: kernel.world.lifted(triangle, bary, &at), ..front }),
        Side::BackOfDoubleSided => {
            kernel.world.material(kernel.scene, triangle).double_sided.then(|| front.turned())
        }
    }
}

/// Rays that look around from each texel before it is gathered. If one of them meets a back, the
/// second number of rays tells which parts of the texel are hidden.
const LOOKS: [u32; 2] = [8, 64];

/// Cells along a texel's side among which hidden parts are told apart: 16 rays to each.
const SIDE: usize = 2;

/// Which cells lie in the open.
pub(super) type Cells = [bool; SIDE * SIDE];

/// Which parts of a texel lie in the open.
pub(super) struct Visible {
    pub(super) cells: Cells,
    pub(super) validity: Validity,
    /// Every ray met a back, nothing, or a front across a crack, and some did not meet nothing: there
    /// is a body around.
    pub(super) inside: bool,
    /// See [`Vertex::open`].
    pub(super) open: bool,
    /// Rays it took.
    pub(super) rays: u64,
}

/// A texel is in the open if this part of its looks meets the sky, percent, and the sky brings more than
/// the beams do to the average place.
const OPEN: u32 = 25;

impl Visible {
    /// Looks around from a texel, to find parts that lie inside other geometry. The rays are the same
    /// whatever the seed and the number of samples, so that these do not decide which texels count.
    ///
    /// A cell is hidden if more than half of its rays meet the back of a one-sided surface, or if all of
    /// them meet backs. Backs here and there are ordinary: one-sided surfaces are black from behind and
    /// stay in the mean. If every cell is hidden, all stay and the texel says so.
    pub(super) fn find(
        kernel: &Kernel<'_>,
        sampler: &TexelSampler,
        side: Side,
        (page, texel): (usize, u32),
        crack: f32,
    ) -> Self {
        let key = sequence::key(0, DOMAIN + page as u64, u64::from(texel));
        let mut cells = [Cell::default(); SIDE * SIDE];
        let mut void = true;
        let mut near = false;
        let mut rays = 0;
        let (mut all, mut backs, mut nothing, mut sky) = (0, 0, 0, 0.0);
        let mut from = 0;
        for until in LOOKS {
            for i in from..until {
                let [a, b, c, d] = Sequence::new(key, i).next4();
                let on = sampler.sample([a, b]);
                let Some(vertex) = receiver(kernel, on.triangle, on.bary, side) else { continue };
                rays += 1;
                let (first, distance, wi) = kernel.look(&vertex, [c, d]);
                let cell = &mut cells[cell_index(on.uv.to_array())];
                cell.all += 1;
                cell.one_sided += u32::from(first == First::Back);
                let back = matches!(first, First::Back | First::DoubleSidedBack);
                cell.back += u32::from(back);
                all += 1;
                backs += u32::from(back);
                if first == First::Nothing {
                    nothing += 1;
                    sky += luminance(kernel.lights.sky.radiance(wi));
                }
                let crack = first == First::Front && distance < crack;
                void &= first != First::Front || crack;
                near |= back || crack;
            }
            from = until;
            if backs == 0 {
                break;
            }
        }
        let reflected = kernel.beams.map_or(0.0, Beams::reflected);
        let open = kernel.sky_guide.is_some()
            && OPEN * all <= nothing * 100
            && reflected * f64::from(all) < f64::from(sky);
        Self { open, rays, ..Self::new(&cells, void, near) }
    }

    fn new(cells: &[Cell; SIDE * SIDE], void: bool, near: bool) -> Self {
        let states = cells.map(|c| c.validity());
        let any = |v| cells.iter().zip(states).any(|(c, s)| 0 < c.all && s == v);
        let validity = if any(Validity::Valid) {
            Validity::Valid
        } else if any(Validity::Enclosed) {
            Validity::Enclosed
        } else {
            Validity::Hidden
        };
        let all = validity != Validity::Valid;
        Self {
            cells: states.map(|s| all || s == Validity::Valid),
            validity,
            inside: void && near,
            open: false,
            rays: 0,
        }
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the grid")]
pub(super) fn cell_index(place: [f32; 2]) -> usize {
    let k = |x: f32| ((x * SIDE as f32).max(0.0) as usize).min(SIDE - 1);
    k(place[1]) * SIDE + k(place[0])
}

/// What the rays from one part of a texel met.
#[derive(Clone, Copy, Default)]
struct Cell {
    all: u32,
    one_sided: u32,
    back: u32,
}

impl Cell {
    fn validity(&self) -> Validity {
        if self.all < 2 * self.one_sided {
            Validity::Hidden
        } else if self.back == self.all && 0 < self.all {
            Validity::Enclosed
        } else {
            Validity::Valid
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(all: u32, one_sided: u32, double_sided: u32) -> Cell {
        Cell { all, one_sided, back: one_sided + double_sided }
    }

    #[test]
    fn the_part_under_another_body_is_left_out() {
        for hidden in [cell(16, 16, 0), cell(16, 9, 0), cell(16, 0, 16)] {
            let v = Visible::new(&[hidden, cell(16, 0, 0), hidden, cell(16, 3, 0)], false, true);
            assert_eq!(v.validity, Validity::Valid);
            assert_eq!(v.cells, [false, true, false, true]);
            assert_eq!([cell_index([0.2, 0.2]), cell_index([0.9, 0.2])], [0, 1]);
        }
    }

    #[test]
    fn wholly_hidden_texels_say_so() {
        let all = |c| Visible::new(&[c, c, c, Cell::default()], true, true);
        assert_eq!(all(cell(16, 16, 0)).validity, Validity::Hidden);
        assert_eq!(all(cell(16, 0, 16)).validity, Validity::Enclosed);
        assert!(all(cell(16, 16, 0)).cells.iter().all(|c| *c), "all stay where none is better");
    }
}
