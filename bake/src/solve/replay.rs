//! One sample again, to look at it alone.

use crate::error::Error;
use crate::geom::World;
use crate::geom::atlas::Atlas;
use crate::geom::texel::{TexelMap, TexelSampler};
use crate::sample::Sequence;
use crate::scene::model::Rgb;
use crate::solve::accumulate::{Kind, Rejected, is_admissible};
use crate::solve::facing::Facing;
use crate::solve::lightmap::{self, Effort};
use crate::solve::{directional, lightmap::vertex_of};
use crate::transport::{Estimate, Kernel};
use glam::{Vec3, Vec3A};

/// A sample, where it starts and what it brought, before any gate.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Replayed {
    /// Metres of the file.
    pub position: Vec3,
    /// Unit normal of the plane; zero for a place in the air that has none.
    pub normal: Vec3,
    /// Number of the surface, for texels.
    pub surface: Option<usize>,
    /// Straight from lights, `E / pi`, nits.
    pub direct: Rgb,
    /// Reflected or scattered, `E / pi`, nits.
    pub indirect: Rgb,
    /// For directions, nodes and probes instead of both: unit directions and the light from there times its solid angle.
    pub around: Vec<(Vec3, Rgb)>,
    /// Rays traced.
    pub rays: u32,
}

impl Replayed {
    /// A sample that starts at `position`, metres relative to the world's origin, and has found nothing yet.
    #[must_use]
    pub fn at(world: &World, position: Vec3A, normal: Vec3A) -> Self {
        Self { position: Vec3::from(position) + world.origin, normal: normal.into(), ..Self::default() }
    }

    /// The same with what an estimate brought.
    #[must_use]
    pub fn with(self, e: Estimate) -> Self {
        Self { direct: e.direct, indirect: e.indirect, rays: e.rays, ..self }
    }

    /// Whether the gate lets all of it through.
    #[must_use]
    pub fn is_admissible(&self) -> bool {
        let around = self.around.iter().map(|(_, light)| *light);
        [self.direct, self.indirect].into_iter().chain(around).all(is_admissible)
    }
}

/// A sample of a texel as [`lightmap::bake_page`], [`lightmap::refine_page`] and [`directional::gather`] take it; `None` if it finds no part of the texel in the open.
/// `directions` is the number of samples that these take in all.
///
/// # Errors
///
/// [`Error::Usage`] if the page has no such texel, or it is not a sample of a texel.
pub fn of_texel(
    kernel: &Kernel<'_>,
    atlas: &Atlas,
    map: &TexelMap,
    Effort { seed, texel_size, .. }: Effort,
    facing: &Facing,
    directions: u32,
    at: Rejected,
) -> Result<Option<Replayed>, Error> {
    let Rejected { page, texel, kind, sample } = at;
    let Some(index) = map.texels.iter().position(|t| *t == texel) else {
        return Err(Error::Usage(format!("{at}: page {page} has no chart on texel {texel}")));
    };
    let sampler = TexelSampler::new(map, index);
    let sides = facing.of(map.chart(atlas, map.triangles_of(index)[0]));
    let begun = lightmap::begun(kernel, &sampler, (page, texel), sides, texel_size);
    let key = match kind {
        Kind::Small | Kind::Path => lightmap::key(kind, page, texel, seed),
        Kind::Direction => directional::key(page, texel, seed),
        Kind::Node | Kind::Cell | Kind::Probe | Kind::Point => {
            return Err(Error::Usage(format!("{at} is no sample of a texel")));
        }
    };
    let mut sequence = Sequence::new(key, sample);
    let [a, b, c, d] = sequence.next4();
    let surface = Some(kernel.world.surface(sampler.sample([a, b]).triangle));
    if kind != Kind::Direction {
        let found = lightmap::sample_of(kernel, &sampler, (page, texel, seed), &begun, (kind, sample));
        return Ok(found.map(|(v, e)| Replayed {
            surface,
            ..Replayed::at(kernel.world, v.position, v.geometric_normal).with(e)
        }));
    }
    let Some(v) = vertex_of(kernel, &sampler, &begun, [a, b]) else { return Ok(None) };
    let mut out = Replayed::at(kernel.world, v.position, v.geometric_normal);
    let Replayed { rays, around, .. } = &mut out;
    directional::around(kernel, &v, [c, d], (sample, directions), &mut sequence, rays, &mut |wi, light| {
        around.push((wi.into(), light));
    });
    Ok(Some(Replayed { surface, ..out }))
}
