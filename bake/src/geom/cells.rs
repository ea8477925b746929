//! How a scene's surfaces are cut into cells for the irradiance cache.

use crate::geom::World;

/// Side of a cell, texels.
const CELL: f32 = 4.0;

/// Cells grow until about this many cover the scene's area.
const MOST: f32 = 65_536.0;

/// Most points that a cell keeps.
pub const POINTS: usize = 8;

/// Rays for each expected cell that look for cells.
const RAYS: f32 = 16.0;

/// Side of the cells, metres; `texel_size` likewise.
#[must_use]
pub fn side(world: &World, texel_size: f32) -> f32 {
    (CELL * texel_size).max((world.total_area() / MOST).sqrt())
}

/// About how many cells there are. Corners and curved places have several for one cell's area.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "at most a few times MOST")]
pub fn expected(world: &World, texel_size: f32) -> u64 {
    let side = side(world, texel_size);
    (1.3 * world.total_area() / (side * side)) as u64
}

/// Rays that look for the cells.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
pub fn search(world: &World, texel_size: f32) -> u64 {
    let side = side(world, texel_size);
    (RAYS * world.total_area() / (side * side)).clamp(4096.0, 1e6) as u64
}
