//! How a scene's surfaces are cut into cells for the irradiance cache.

use crate::geom::World;

/// Side of a cell, texels.
const CELL: f32 = 4.0;

/// Cells grow until about this many cover the scene's area.
const MOST: f32 = 65_536.0;

/// Rays for each expected cell that look for cells.
const RAYS: f32 = 16.0;

/// Side of the cells, metres; `texel_size` likewise.
#[must_use]
pub fn side(world: &World, texel_size: f32) -> f32 {
    (CELL * texel_size).max((world.total_area() / MOST).sqrt())
}

/// Rays that look for the cells.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
pub fn search(world: &World, texel_size: f32) -> u64 {
    let side = side(world, texel_size);
    (RAYS * world.total_area() / (side * side)).clamp(4096.0, 1e6) as u64
}
