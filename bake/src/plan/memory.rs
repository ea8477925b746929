//! Peak memory of a bake, before it starts.

use super::Plan;
use serde::Serialize;

/// Bytes by what they are for. The peak is the base plus the larger of the two stages that follow
/// one another on a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Memory {
    /// Program, libraries and threads.
    pub program: u64,
    /// Meshes, images and the file they came from.
    pub scene: u64,
    /// Placed triangles and the tree.
    pub tracing: u64,
    /// Texture coordinates of the atlas.
    pub atlas: u64,
    /// The largest page while it is gathered.
    pub gather: u64,
    /// The largest page while it is written.
    pub write: u64,
}

/// Program and libraries before anything is loaded, measured on an empty scene.
const PROGRAM: u64 = 24 << 20;

/// Bytes per covered texel while a page is gathered: texel list, offsets and triangles of the map
/// (16), a solution (44).
const PER_COVERED: u64 = 60;

/// Bytes per texel of a page in memory: radiance, coverage and standard error.
const PER_TEXEL: u64 = 28;

/// Bytes per texel that writing adds: chart ids and flags, and the file's compressed blocks.
const PER_TEXEL_WRITTEN: u64 = 40;

impl Memory {
    /// Estimates the memory of a plan.
    #[must_use]
    pub fn estimate(plan: &Plan) -> Self {
        let scene = plan.scene();
        let meshes: usize = scene
            .meshes
            .iter()
            .map(|m| {
                m.positions.len() * 12
                    + m.normals.len() * 12
                    + m.uvs.iter().map(|u| u.len() * 8).sum::<usize>()
                    + m.colors.len() * 16
                    + m.triangles.len() * 12
            })
            .sum();
        let images: usize = scene.images.iter().map(|i| i.pixels.len() * 4).sum();
        let tracing = plan.tracing();
        let layouts: usize = plan
            .atlas()
            .layouts
            .iter()
            .map(|l| l.vertices.len() * 4 + l.uvs.len() * 8 + l.triangles.len() * 12 + l.charts.len() * 4)
            .sum();
        let largest =
            plan.atlas().pages.iter().map(|p| u64::from(p.width) * u64::from(p.height)).max().unwrap_or(0);
        let covered = (largest as f64 * f64::from(plan.atlas().utilisation)).ceil();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of texels")]
        let covered = covered as u64;
        let layers = if plan.settings().split_direct { 24 } else { 0 };
        Self {
            program: PROGRAM,
            // The document stays in memory: `scene.glb` is made from it.
            scene: 2 * meshes as u64 + images as u64,
            tracing: (tracing.world.triangles.len() * 44 + tracing.bvh.bytes()) as u64,
            atlas: layouts as u64,
            gather: covered * PER_COVERED,
            write: largest * (PER_TEXEL + PER_TEXEL_WRITTEN + layers),
        }
    }

    /// Bytes at the peak.
    #[must_use]
    pub fn peak(&self) -> u64 {
        self.program + self.scene + self.tracing + self.atlas + self.gather + self.write
    }
}
