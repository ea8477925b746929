//! Charts whose lit side is their back.
//!
//! Many files build cupboards, panels and frames of double-sided sheets wound the wrong way round: the
//! front looks into a cavity and the back is what anybody sees. A texel holds the light of one side,
//! so a chart is turned as a whole where its back is lit and its front is dark, or where the back is ten
//! times as bright and the front sees nothing but its own narrow cavity. Rooms built of single sheets are no
//! cavities: they are wide. Charts whose back looks into a body that no light enters are told apart as well, so that not
//! every texel asks again. Media are left out of the question, so that sheets show the same side whatever becomes of these.

use crate::geom::atlas::Atlas;
use crate::geom::texel::{TexelMap, TexelSample, TexelSampler};
use crate::geom::world::luminance;
use crate::sample::{Sequence, sequence};
use crate::solve::Monitor;
use crate::solve::lightmap::Effort;
use crate::solve::visible::{Side, receiver};
use crate::transport::Kernel;
use crate::transport::path::First;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Random numbers of the question belong to this domain, whatever the seed, so that this does not decide
/// which charts are turned; see [`sequence::key`].
const DOMAIN: u64 = 0x4643;

/// Texels of a chart that are asked.
const ASKED: usize = 32;

/// Texels that are asked before all backs of a chart count as closed in, and paths from each: paths in there are long.
const ASKED_OF_CLOSED: usize = 256;

/// See [`ASKED_OF_CLOSED`].
const PATHS_OF_CLOSED: u32 = 2;

/// Rays from each of them that measure how wide the space before it is.
const LOOKS: u32 = 8;

/// Paths from each of them.
const PATHS: u32 = 8;

/// A front counts as dark where at most this part of its paths finds light.
const DARK: f64 = 1.0 / 64.0;

/// A back counts as lit where at least this part of its paths finds light.
const LIT: f64 = 1.0 / 16.0;

/// A back has to be brighter than its front by this factor.
const BRIGHTER: f64 = 10.0;

/// Widest cavity, texels.
const CAVITY: f32 = 24.0;

/// Which sides of a page's charts count; charts are those of [`TexelMap::chart`].
#[derive(Clone, Debug, Default)]
pub struct Facing {
    /// They show their back.
    turned: BTreeSet<u32>,
    /// No light reaches their back: where their front is dark, there is nothing better.
    closed: BTreeSet<u32>,
}

impl Facing {
    /// The side that a chart shows, and whether a dark texel of it may show the other.
    pub(super) fn of(&self, chart: u32) -> (Side, bool) {
        let side = if self.turned.contains(&chart) { Side::BackOfDoubleSided } else { Side::Front };
        (side, side == Side::Front && !self.closed.contains(&chart))
    }
}

/// What a chart shows.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Shows {
    Front,
    Back,
    /// Its front, and behind it is a closed body.
    FrontAlone,
}

/// Which sides of the charts of a page count; not all are told if the monitor asks to stop.
#[must_use]
pub fn facing(
    kernel: &Kernel<'_>,
    atlas: &Atlas,
    map: &TexelMap,
    page: usize,
    effort: Effort,
    monitor: &Monitor,
) -> Facing {
    let kernel = &kernel.plain().in_clear_air();
    let mut charts: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for i in 0..map.texels.len() {
        let triangle = map.triangles_of(i)[0];
        if kernel.world.material(kernel.scene, triangle).double_sided {
            charts.entry(map.chart(atlas, triangle)).or_default().push(i);
        }
    }
    let shown: Vec<(u32, Shows)> = charts
        .into_par_iter()
        .filter(|_| !monitor.stopped())
        .map(|(chart, texels)| (chart, shows(kernel, map, &texels, page, effort)))
        .collect();
    let those = |what| shown.iter().filter(|s| s.1 == what).map(|s| s.0).collect();
    Facing { turned: those(Shows::Back), closed: those(Shows::FrontAlone) }
}

fn shows(kernel: &Kernel<'_>, map: &TexelMap, texels: &[usize], page: usize, effort: Effort) -> Shows {
    let some =
        |n: usize| -> Vec<usize> { texels.iter().copied().step_by(texels.len().div_ceil(n)).collect() };
    let asked = some(ASKED);
    let narrow = |side| {
        let (near, all) = ask(map, &asked, page, LOOKS, |_, u, on| {
            let vertex = receiver(kernel, on.triangle, on.bary, side)?;
            let (first, distance, _) = kernel.look(&vertex, u);
            Some(f64::from(u8::from(first != First::Nothing && distance < CAVITY * effort.texel_size)))
        });
        0.0 < all && 0.9 * all <= near
    };
    // Part of the paths that find light, and mean luminance.
    let light = |asked: &[usize], n, side| {
        let mut lit = 0.0;
        let (sum, all) = ask(map, asked, page, n, |sequence, u, on| {
            let vertex = receiver(kernel, on.triangle, on.bary, side)?;
            let e = kernel.estimate(&vertex, u, sequence);
            let l = luminance(e.direct + e.indirect);
            lit += f64::from(u8::from(0.0 < l));
            Some(f64::from(l))
        });
        let all = all.max(1.0);
        (lit / all, sum / all)
    };
    let (front_lit, front) = light(&asked, PATHS, Side::Front);
    let (back_lit, back) = light(&asked, PATHS, Side::BackOfDoubleSided);
    if back_lit <= 0.0 {
        let (lit, _) = light(&some(ASKED_OF_CLOSED), PATHS_OF_CLOSED, Side::BackOfDoubleSided);
        return if lit <= 0.0 { Shows::FrontAlone } else { Shows::Front };
    }
    if back_lit < LIT || back < BRIGHTER * front {
        return Shows::Front;
    }
    // A front that is as good as dark shows its back, whatever is around it.
    let turned = front_lit <= DARK || (narrow(Side::Front) && !narrow(Side::BackOfDoubleSided));
    if turned { Shows::Back } else { Shows::Front }
}

/// Sum of the answers to questions to a side, and how many were answered.
fn ask(
    map: &TexelMap,
    texels: &[usize],
    page: usize,
    n: u32,
    mut question: impl FnMut(&mut Sequence, [f32; 2], &TexelSample) -> Option<f64>,
) -> (f64, f64) {
    let (mut sum, mut all) = (0.0, 0.0);
    for &t in texels {
        let sampler = TexelSampler::new(map, t);
        let key = sequence::key(0, DOMAIN + page as u64, u64::from(map.texels[t]));
        for i in 0..n {
            let mut sequence = Sequence::new(key, i);
            let [a, b, c, d] = sequence.next4();
            if let Some(answer) = question(&mut sequence, [c, d], &sampler.sample([a, b])) {
                sum += answer;
                all += 1.0;
            }
        }
    }
    (sum, all)
}
