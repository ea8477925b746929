//! Charts whose lit side is their back.
//!
//! Many files build cupboards, panels and frames of double-sided sheets wound the wrong way round: the
//! front looks into a cavity and the back is what anybody sees. A texel holds the light of one side,
//! so a chart is turned as a whole where its back is lit and its front is not, or where its front sees
//! nothing but its own narrow cavity and next to no light. Rooms built of single sheets are no cavities:
//! they are wide.

use crate::geom::atlas::Atlas;
use crate::geom::texel::{TexelMap, TexelSample, TexelSampler};
use crate::sample::{Sequence, sequence};
use crate::solve::lightmap::{Effort, Side, receiver};
use crate::transport::Kernel;
use crate::transport::path::First;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// Random numbers of the question belong to this domain, whatever the seed, so that this does not decide
/// which charts are turned; see [`sequence::key`].
const DOMAIN: u64 = 0x4643;

/// Texels of a chart that are asked.
const ASKED: usize = 32;

/// Rays from each of them that measure how wide the space before it is.
const LOOKS: u32 = 8;

/// Paths from each of them.
const PATHS: u32 = 8;

/// A front counts as dark where at most one path in so many finds light.
const DARK: usize = 64;

/// A back counts as lit where at least one path in so many finds light, and eight times as many as of the front.
const LIT: usize = 16;

/// Widest cavity, texels.
const CAVITY: f32 = 24.0;

/// The charts of a page, as [`TexelMap::chart`] counts them, that show their back.
#[must_use]
pub fn turned_charts(
    kernel: &Kernel<'_>,
    atlas: &Atlas,
    map: &TexelMap,
    page: usize,
    effort: Effort,
) -> BTreeSet<u32> {
    let mut charts: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for i in 0..map.texels.len() {
        let triangle = map.triangles_of(i)[0];
        if kernel.world.material(kernel.scene, triangle).double_sided {
            charts.entry(map.chart(atlas, triangle)).or_default().push(i);
        }
    }
    charts
        .into_par_iter()
        .filter(|(_, texels)| is_turned(kernel, map, texels, page, effort))
        .map(|(chart, _)| chart)
        .collect()
}

fn is_turned(kernel: &Kernel<'_>, map: &TexelMap, texels: &[usize], page: usize, effort: Effort) -> bool {
    let step = texels.len().div_ceil(ASKED);
    let asked: Vec<usize> = texels.iter().copied().step_by(step).collect();
    let narrow = |side| {
        let (near, all) = count(map, &asked, page, LOOKS, |_, u, on| {
            let vertex = receiver(kernel, on.triangle, on.bary, side)?;
            let (first, distance) = kernel.look(&vertex, u);
            Some(first != First::Nothing && distance < CAVITY * effort.texel_size)
        });
        0 < all && 9 * all <= 10 * near
    };
    let lit = |side| {
        count(map, &asked, page, PATHS, |sequence, u, on| {
            let vertex = receiver(kernel, on.triangle, on.bary, side)?;
            let e = kernel.estimate(&vertex, u, sequence);
            Some(e.direct + e.indirect != Vec3::ZERO)
        })
    };
    let cavity = narrow(Side::Front) && !narrow(Side::BackOfDoubleSided);
    let (front, fronts) = lit(Side::Front);
    // A front that is as good as dark shows its back, whatever is around it.
    if fronts < 10 * front || (fronts < DARK * front && !cavity) {
        return false;
    }
    let (back, backs) = lit(Side::BackOfDoubleSided);
    backs <= LIT * back && 8 * front * backs <= back * fronts
}

/// How many of the questions to a side were answered with yes, and how many were answered.
fn count(
    map: &TexelMap,
    texels: &[usize],
    page: usize,
    n: u32,
    ask: impl Fn(&mut Sequence, [f32; 2], &TexelSample) -> Option<bool>,
) -> (usize, usize) {
    let (mut yes, mut all) = (0, 0);
    for &t in texels {
        let sampler = TexelSampler::new(map, t);
        let key = sequence::key(0, DOMAIN + page as u64, u64::from(map.texels[t]));
        for i in 0..n {
            let mut sequence = Sequence::new(key, i);
            let [a, b, c, d] = sequence.next4();
            if let Some(answer) = ask(&mut sequence, [c, d], &sampler.sample([a, b])) {
                all += 1;
                yes += usize::from(answer);
            }
        }
    }
    (yes, all)
}
