//! Peak memory of a bake, before it starts.
//!
//! A bake goes through stages, each with its own working memory over what stays: loading and
//! unwrapping, building the tree, then for each page gathering, putting together and writing, at
//! last `scene.glb`. The peak is that of the largest stage. All terms follow from sizes of data;
//! those that were measured, `PROGRAM`, `UNWRAP_PER_VERTEX` and a part of `BUILD_PER_TRIANGLE`, say so.

use super::Plan;
use crate::geom::atlas::{Atlas, Layout, NO_CHART};
use crate::geom::cells;
use crate::geom::world::World;
use crate::light::fires::Fires;
use crate::plan::settings::{Denoise, MediaMode, Sampling, TextureFormat};
use crate::scene::document::Document;
use crate::scene::model::{Density, Image, Medium, Mesh, ProbeBox, Region, Sky};
use glam::Vec2;
use serde::Serialize;

/// Bytes by what they are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Memory {
    /// Program, libraries and threads.
    pub program: u64,
    /// Meshes, images and the file they came from.
    pub scene: u64,
    /// What unwrapping needed and the allocator keeps in small pieces.
    pub unwrap: u64,
    /// Texture coordinates of the atlas.
    pub atlas: u64,
    /// Placed triangles and the tree.
    pub tracing: u64,
    /// What building the tree needs for a moment; includes the finished tree.
    pub build: u64,
    /// Finding seams; the list of them counts with what rays need.
    pub seams: u64,
    /// Filling the light grid of media; the filled grid counts with the stages behind it.
    pub grid: u64,
    /// Finding the places of the irradiance cache; the filled cache counts with the stages behind it.
    pub cache: u64,
    /// Writing what media are, and the sky.
    pub surroundings: u64,
    /// Finding and filling light probes.
    pub probes: u64,
    /// The most that gathering a page needs, with the pages before it.
    pub gather: u64,
    /// The most that putting a page together and writing it needs, with the pages before it.
    pub write: u64,
    /// Stitching seams, with the pages that wait for it and those before them.
    pub stitch: u64,
    /// Writing `scene.glb` and the preview, with all pages.
    pub export: u64,
}

/// Program and libraries, their relocations and the stacks of a few threads, measured on a scene of
/// six rectangles.
const PROGRAM: u64 = 16 << 20;

/// Half-edges, charts and buffers of the unwrapper for each vertex of a layout. Measured: 190 to 250
/// on four scenes of 60,000 to 420,000 triangles. They are freed in pieces too small to go back to
/// the system.
const UNWRAP_PER_VERTEX: u64 = 200;

/// Bytes a triangle while the tree is built: the placed triangle (64), identity (8), boxes (32), two
/// lists of clusters (2 x 48), Morton codes (32), nodes (96), indices (8); and what the allocator keeps
/// beside, measured: 302 to 376 in all on scenes of 262,000 to a million triangles.
const BUILD_PER_TRIANGLE: u64 = 64 + 8 + 32 + 96 + 32 + 96 + 8 + 60;

/// Bytes of the texel map for each covered texel: the texel and where its triangles start. Each
/// triangle in it takes [`PER_ENTRY`] more, and each triangle on the page [`PER_CORNERS`].
const PER_LISTED: u64 = 8;

/// A triangle in the list of a texel.
const PER_ENTRY: u64 = 4;

/// Corners of a triangle on a page.
const PER_CORNERS: u64 = 24;

/// Bytes of the solution for each covered texel.
pub(crate) const PER_SOLVED: u64 = 100;

/// Deviations and next samples of each covered texel while a round is planned, and its variance on the page.
const PER_COVERED_PLANNED: u64 = 16;

/// See [`PER_COVERED_PLANNED`].
const PER_TEXEL_PLANNED: u64 = 4;

/// Bytes per texel of a page in memory: radiance and standard error (12 each), coverage (4).
const PER_TEXEL: u64 = 28;

/// Texels whose flag of having been filled takes a byte.
const FLAGS: u64 = 8;

/// Bytes of that flag per texel in a file.
const PER_TEXEL_FLAGGED: u64 = 4;

/// Bytes per texel of `direct` and `indirect`.
const PER_TEXEL_SPLIT: u64 = 24;

/// Bytes per texel of `sh1`.
const PER_TEXEL_DIRECTED: u64 = 36;
/// Bytes per texel of `noisy` and `rmse`.
const PER_TEXEL_DENOISED: u64 = 24;

/// Bytes for each covered texel while a page is denoised, beside the solution. At the most there are: where texels are (36), what came
/// out of the first part (28), the second as it was gathered (40), what texels are compared by (48), their noise, the
/// error that is left and their radius (12), the filtered texels (40), their errors twice (8), whether they are black (1) and what comes out (28).
const PER_DENOISED: u64 = 36 + PER_WALLED + 28 + 40 + 48 + 12 + 40 + 8 + 1 + 28;

/// Bytes of what a texel knows of walls around it while a page is denoised, with those that an allocation takes.
pub(crate) const PER_WALLED: u64 = 56;

/// Bytes per texel of a page that is kept for the preview: radiance and coverage.
const PER_TEXEL_KEPT: u64 = 16;

/// A place on a seam while seams are stitched: where it is (56), what is around (24), its row of the equations (72) and
/// its number (4). `crate::output::stitch` makes them.
const PER_PLACE: u64 = 156;

/// A texel that is stitched: its place (8), freedom (8), island and place in there (8), result (12), and if there is one
/// island, start, four vectors and the diagonal (12 + 4 x 24 + 8).
const PER_STITCHED: u64 = 36 + 116;

/// Texels that are stitched, for each place. Measured: 4.8 in a corridor of large quads, 5.9 in the hall, 6.0 where
/// seams are short.
const STITCHED_PER_PLACE: u64 = 6;

/// Chart and validity of each texel while a page is put together.
const PER_TEXEL_FLAGS: u64 = 5;

/// Chart and origin of each texel while charts are continued outwards.
const PER_TEXEL_DILATED: u64 = 8;

/// Bytes for each texel along the charts' borders while charts are continued: ring and front with
/// repetitions, in pieces and joined (64), new values (52).
const PER_BORDER: u64 = 116;

/// Pixels of a preview image and their compressed form, per texel.
const PER_TEXEL_IMAGE: u64 = 6;

/// Beams that the texels share, where there are suns or lamps.
pub(crate) const SHARED_BEAMS: u64 = (1 << 14) * 80;

/// A cell of the irradiance cache in its hash table, and the lists of cells while it is filled.
const PER_CACHE_CELL: u64 = 96;

/// A record of the irradiance cache.
pub(crate) const PER_CACHE_RECORD: u64 = 28;

/// A point that was found for the irradiance cache.
pub(crate) const PER_CACHE_POINT: u64 = 32;

/// Luminance of a covered texel while exposure is found.
const PER_COVERED_IMAGE: u64 = 8;

/// Rows that an EXR compresses together.
const EXR_ROWS: u64 = 16;

/// Tables and windows that packing and unpacking a texture need at most; a small one needs no more than it holds.
const TEXTURE: u64 = 8 << 20;

/// Rows of a texture that are made at once, and then joined.
const TEXTURE_ROWS: u64 = 2 * 256;

/// The preview picture of 540 rows in the usual format of 16:9: radiance (12) and, one after the
/// other, luminances (8) or bytes and their compressed form (6) for each pixel.
const PICTURE: u64 = 960 * 540 * 20;

impl Memory {
    /// Estimates the memory of a plan whose scene came from `document`.
    #[must_use]
    pub fn estimate(plan: &Plan, document: &Document) -> Self {
        let files: u64 = document.inputs().iter().map(|f| f.bytes).sum();
        let document = document.total_bytes();
        let scene = plan.scene();
        let atlas = plan.atlas();
        let meshes: u64 = scene.meshes.iter().map(mesh_bytes).sum();
        let images: u64 = scene.images.iter().map(|i: &Image| 4 * i.pixels.len() as u64).sum();
        let tracing = plan.tracing();
        let triangles = tracing.world.len() as u64;
        let split = if plan.settings().split_direct { PER_TEXEL_SPLIT } else { 0 };
        let directed = if plan.settings().directional.is_some() { PER_TEXEL_DIRECTED } else { 0 };
        let per_packed = match plan.settings().texture {
            None => 0,
            Some(TextureFormat::Bc6h) => 1,
            Some(TextureFormat::Rgba16f) => 8,
        };
        let denoises = plan.settings().denoise != Denoise::Off;
        let per_texel = PER_TEXEL + split + directed + if denoises { PER_TEXEL_DENOISED } else { 0 };
        let targeted = matches!(plan.settings().sampling, Sampling::Target(_));
        let unwrapped = atlas.layouts.iter().filter(|l| !l.kept);
        let layouts: u64 = atlas.layouts.iter().map(layout_bytes).sum();

        let (fill, grid) = grid_bytes(plan);
        let (find, filled) = if plan.settings().caches() { cache_bytes(plan) } else { (0, 0) };
        let fires = tracing.fires.as_ref().map_or(0, Fires::bytes);
        let (mut kept, mut gather, mut write) = (fires + grid + filled + SHARED_BEAMS, 0, 0);
        let seams = plan.seams();
        let places = seams.places(&tracing.world, atlas);
        let waiting = seams.join_pages(&tracing.world, atlas);
        let (mut stitch, mut solved_together, mut written_last) = (0, 0, 0);
        let all: u64 = atlas.pages.iter().map(|p| u64::from(p.width) * u64::from(p.height)).sum();
        let shown = kept + PER_TEXEL_KEPT * all;
        for (load, places) in page_loads(atlas).into_iter().zip(places) {
            let map = PER_LISTED * load.covered + PER_ENTRY * load.entries + PER_CORNERS * load.triangles;
            let planned = PER_COVERED_PLANNED * load.covered + PER_TEXEL_PLANNED * load.texels;
            // A target is measured on the page as it would be written.
            let figure = if targeted { (PER_TEXEL + PER_TEXEL_FLAGS) * load.texels } else { 0 };
            let planned = planned.max(figure);
            // What was found of directions stays beside the texels until the page is put together.
            let found = directed * load.covered;
            let denoised = if denoises { PER_DENOISED * load.covered } else { 0 };
            let solved = map + PER_SOLVED * load.covered + planned.max(found + denoised);
            let flags = load.texels / FLAGS;
            let assembled = map + found + flags + (per_texel + PER_TEXEL_FLAGS) * load.texels;
            let dilated = flags + (per_texel + PER_TEXEL_DILATED) * load.texels + PER_BORDER * load.border;
            // The EXR library holds a block for each thread and two more, raw, sorted and compressed.
            let row = load.width * (per_texel + PER_TEXEL_FLAGGED);
            let blocks = (rayon::current_num_threads() as u64 + 2) * 3 * EXR_ROWS * row;
            let images = PER_TEXEL_IMAGE * load.texels + PER_COVERED_IMAGE * load.covered;
            let texture = (per_packed * load.texels).min(TEXTURE) + per_packed * TEXTURE_ROWS * load.width;
            let writing = images.max(blocks).max(texture);
            let written = flags + per_texel * load.texels + writing;
            gather = gather.max(kept + solved);
            write = write.max(kept + assembled.max(dilated).max(written));
            let stitched = (STITCHED_PER_PLACE * places).min(load.texels);
            let solving = PER_PLACE * places + PER_STITCHED * stitched;
            if waiting {
                // Whole pages wait until all are there, and are then written one after the other.
                kept += flags + per_texel * load.texels;
                solved_together += solving;
                written_last = written_last.max(writing);
                stitch = kept + solved_together.max(written_last);
            } else {
                stitch = stitch.max(kept + flags + per_texel * load.texels + solving);
                kept += PER_TEXEL_KEPT * load.texels;
            }
        }
        // What pages that waited keep for the preview; the others have no more already.
        let kept = kept.min(shown);
        Self {
            program: PROGRAM,
            scene: document + meshes + images + crate::media::Media::bytes(scene),
            unwrap: UNWRAP_PER_VERTEX * unwrapped.map(|l| l.vertices.len() as u64).sum::<u64>(),
            atlas: layouts,
            tracing: (World::BYTES as u64 * triangles)
                + tracing.bvh.bytes() as u64
                + tracing.lights.bytes()
                + seams.bytes() as u64,
            build: BUILD_PER_TRIANGLE * triangles,
            seams: seams.bytes_to_find() as u64,
            grid: fill,
            cache: grid + find,
            surroundings: grid + surroundings_bytes(plan),
            probes: grid + filled + probe_bytes(plan),
            gather,
            write,
            stitch,
            // The file is made in memory and then framed: two copies of what all input files hold.
            export: kept + (2 * files).max(PICTURE),
        }
    }

    /// Bytes at the peak.
    #[must_use]
    pub fn peak(&self) -> u64 {
        let pages = self.gather.max(self.write).max(self.stitch);
        let stages = self.seams.max(self.grid).max(self.cache).max(self.surroundings);
        let stages = stages.max(self.probes).max(pages).max(self.export);
        self.program
            + self.scene
            + self.unwrap
            + self.atlas
            + self.build.max(self.tracing.saturating_add(stages))
    }
}

/// Where light at a node of the light grid comes from by way of another one.
pub(crate) const PER_LINK: u64 = 28;

/// Light at a node of the light grid.
pub(crate) const PER_NODE: u64 = 108;

/// What lists of links and what cells know take beside, a node.
const PER_NODE_FILLED: u64 = 96;

/// Light of both textures of a node while they are written: of each from all sides (112), of one as half floats, and its file as that grows.
const PER_NODE_WRITTEN: u64 = 2 * 112 + 3 * 64;

/// While the light grid is filled or written, and when it is.
fn grid_bytes(plan: &Plan) -> (u64, u64) {
    let media = plan.tracing().media.as_ref().filter(|m| m.scatters());
    let Some((fineness, media)) = plan.settings().light_grid().zip(media) else { return (0, 0) };
    let fineness = fineness.for_media(media);
    let nodes = u64::from(fineness.nodes);
    // Light of two steps and their difference beside the links.
    let links = u64::from(fineness.paths) * media.channels() as u64;
    let filling = nodes * (links * PER_LINK + 4 * PER_NODE + PER_NODE_FILLED);
    let filled = nodes * (PER_NODE + PER_NODE_FILLED);
    (filling.max(filled + nodes * PER_NODE_WRITTEN), filled)
}

/// Texels of the density of a medium along an axis, at most; `crate::output::media` makes them.
pub(crate) const MOST_DENSITIES: u32 = 128;

/// A texel of a density: as it is found, as a half float, and in its file as that grows.
const PER_DENSITY: u64 = 4 + 2 + 6;

/// A column of such texels.
const PER_DENSITIES: u64 = 40;

/// A triangle around a medium: its corners (40) twice, its part of the tree (64) and of what that is built from, as for [`BUILD_PER_TRIANGLE`].
const PER_ENCLOSING: u64 = 2 * 40 + 64 + 32 + 96 + 32 + 96 + 8;

/// Texels of the sky's image along a row, at most; `crate::output::sky` makes them.
pub(crate) const MOST_SKY: usize = 2048;

/// A texel of that image, as it is and as half floats.
const PER_SKY: u64 = 12 + 6;

/// The textures of media one after the other, and the image of the sky.
fn surroundings_bytes(plan: &Plan) -> u64 {
    let medium = |m: &Medium| {
        let side = u64::from(MOST_DENSITIES);
        let limited = |n: u32| u64::from(n).min(side);
        let texels = match (&m.density, &m.region) {
            (Density::Voxels { values, .. }, _) => values.size().to_array().map(limited),
            (_, Region::Mesh(_)) => [side; 3],
            _ => [0; 3],
        };
        let triangles = match &m.region {
            Region::Mesh(shell) => shell.triangles.len() as u64,
            _ => 0,
        };
        let [x, y, z] = texels;
        PER_DENSITY * x * y * z + PER_DENSITIES * x * y + PER_ENCLOSING * triangles
    };
    let acting = plan.settings().media != MediaMode::Off;
    let media = plan.scene().media.iter().filter(|_| acting).map(medium).max().unwrap_or(0);
    let sky = match &plan.scene().sky {
        Sky::Image { width, height, .. } => {
            let columns = (*width).clamp(1, MOST_SKY);
            let rows = (height * columns).div_ceil((*width).max(1));
            let blocks = (rayon::current_num_threads() as u64 + 2) * 3 * EXR_ROWS * columns as u64 * 6;
            PER_SKY * columns as u64 * rows as u64 + blocks
        }
        _ => 0,
    };
    media.max(sky)
}

/// A light probe while it is gathered and written: place, light twice, figures, its part of bricks and of what cells know.
const PER_PROBE: u64 = 1200;

/// A triangle in the lists of bricks that it passes through.
const PER_LISTED_TRIANGLE: u64 = 16;

/// A voxel of the even grids of probes, with both textures.
const PER_VOXEL: u64 = 208 + 48 + 64;

/// Voxels of the even grid, at most; `crate::output::probes` makes them.
pub(crate) const MOST_VOXELS: u64 = 1 << 17;

/// Light probes and their files.
fn probe_bytes(plan: &Plan) -> u64 {
    let Some(settings) = plan.settings().probes else { return 0 };
    let world = &plan.tracing().world;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an estimate, limited")]
    let whole = |n: f64| n.clamp(0.0, MOST_PROBES) as u64;
    let probes = match (&plan.scene().probe_boxes, settings.spacing) {
        (Some(boxes), _) => {
            // Whole bricks of four cells.
            let along =
                |b: &ProbeBox| ((b.max - b.min).as_dvec3() / f64::from(b.spacing) + 4.0).element_product();
            boxes.iter().map(|b| whole(along(b))).max().unwrap_or(0)
        }
        // Six for each square of surface: bricks of four cells on both sides.
        (None, Some(spacing)) => whole(6.0 * f64::from(world.total_area()) / f64::from(spacing).powi(2)),
        (None, None) => u64::from(settings.about),
    };
    PER_PROBE * probes + PER_LISTED_TRIANGLE * world.len() as u64 + PER_VOXEL * MOST_VOXELS.min(8 * probes)
}

/// Probes of a volume, at most.
pub(crate) const MOST_PROBES: f64 = (1u32 << 22) as f64;

/// While the irradiance cache is found, and when it is filled.
fn cache_bytes(plan: &Plan) -> (u64, u64) {
    let (world, texel) = (&plan.tracing().world, plan.atlas().texels_per_metre.recip());
    // Points that rays find: once in pieces and once joined.
    let find = 2 * PER_CACHE_POINT * cells::search(world, texel);
    let cells = cells::expected(world, texel);
    (find, cells * (PER_CACHE_CELL + cells::POINTS as u64 * PER_CACHE_RECORD))
}

fn mesh_bytes(m: &Mesh) -> u64 {
    let bytes = size_of_val(m.positions.as_slice())
        + size_of_val(m.normals.as_slice())
        + m.uvs.iter().map(|u| size_of_val(u.as_slice())).sum::<usize>()
        + size_of_val(m.colors.as_slice())
        + size_of_val(m.triangles.as_slice());
    bytes as u64
}

fn layout_bytes(l: &Layout) -> u64 {
    let bytes = size_of_val(l.vertices.as_slice())
        + size_of_val(l.uvs.as_slice())
        + size_of_val(l.triangles.as_slice())
        + size_of_val(l.charts.as_slice());
    bytes as u64
}

/// What decides the memory of a page.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct PageLoad {
    width: u64,
    texels: u64,
    /// Texels that a chart covers.
    covered: u64,
    /// Pairs of a texel and a triangle in it.
    entries: u64,
    /// Triangles on the page.
    triangles: u64,
    /// Texels along the borders of charts.
    border: u64,
}

/// Estimates what every page holds, without looking at single texels.
fn page_loads(atlas: &Atlas) -> Vec<PageLoad> {
    let shapes: Vec<Outline> = atlas.layouts.iter().map(Outline::of).collect();
    let mut sums = vec![Outline::default(); atlas.pages.len()];
    for p in atlas.placements.iter().flatten() {
        if let Some(sum) = sums.get_mut(p.page) {
            sum.add(&shapes[p.layout].scaled(p.size.map(f64::from)));
        }
    }
    let load = |(sum, page): (&Outline, &crate::geom::atlas::Page)| {
        let texels = u64::from(page.width) * u64::from(page.height);
        // A convex shape at a random place touches as many squares as its area plus half the
        // lengths of its border along both axes. Edges along an axis lie between texels.
        let covered = whole(sum.area + 0.5 * (sum.slanted[0] + sum.slanted[1])).min(texels);
        let entries = whole(sum.area + 0.5 * (sum.edges[0] + sum.edges[1])) + sum.triangles;
        PageLoad {
            width: u64::from(page.width),
            texels,
            covered,
            entries: entries.max(covered),
            triangles: sum.triangles,
            border: whole(sum.border[0].max(sum.border[1])).min(covered),
        }
    };
    sums.iter().zip(&atlas.pages).map(load).collect()
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a number of texels, cut off below 0"
)]
fn whole(x: f64) -> u64 {
    x.max(0.0).ceil() as u64
}

/// Area and lengths of a layout's charts, lengths by axis.
#[derive(Clone, Copy, Debug, Default)]
struct Outline {
    area: f64,
    /// Edges of all triangles.
    edges: [f64; 2],
    /// Edges that belong to one triangle alone.
    border: [f64; 2],
    /// Those of them that run along no axis.
    slanted: [f64; 2],
    triangles: u64,
}

impl Outline {
    fn of(layout: &Layout) -> Self {
        let mut out = Self { triangles: layout.triangles.len() as u64, ..Self::default() };
        // Edges by the bits of their ends, so that both triangles at an edge name it alike.
        let mut edges: Vec<[[u32; 2]; 2]> = Vec::with_capacity(3 * layout.triangles.len());
        for (t, _) in layout.triangles.iter().zip(&layout.charts).filter(|(_, c)| **c != NO_CHART) {
            let corners = t.map(|v| layout.uvs[v as usize]);
            let [a, b, c] = corners.map(Vec2::as_dvec2);
            out.area += 0.5 * (b - a).perp_dot(c - a).abs();
            for i in 0..3 {
                let mut ends = [corners[i], corners[(i + 1) % 3]].map(|p| p.to_array().map(f32::to_bits));
                ends.sort_unstable();
                edges.push(ends);
            }
        }
        edges.sort_unstable();
        for same in edges.chunk_by(|a, b| a == b) {
            let [a, b] = same[0].map(|p| Vec2::from(p.map(f32::from_bits)).as_dvec2());
            let along = (b - a).abs().to_array();
            let add = |to: &mut [f64; 2], n: f64| (0..2).for_each(|k| to[k] += n * along[k]);
            add(&mut out.edges, same.len() as f64);
            if same.len() == 1 {
                add(&mut out.border, 1.0);
                if 0.0 < along[0].min(along[1]) {
                    add(&mut out.slanted, 1.0);
                }
            }
        }
        out
    }

    fn scaled(&self, [w, h]: [f64; 2]) -> Self {
        let both = |x: [f64; 2]| [x[0] * w, x[1] * h];
        Self {
            area: self.area * w * h,
            edges: both(self.edges),
            border: both(self.border),
            slanted: both(self.slanted),
            triangles: self.triangles,
        }
    }

    fn add(&mut self, o: &Self) {
        self.area += o.area;
        for k in 0..2 {
            self.edges[k] += o.edges[k];
            self.border[k] += o.border[k];
            self.slanted[k] += o.slanted[k];
        }
        self.triangles += o.triangles;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::atlas::{Page, Placement};

    /// One layout of one square of the given corners on a page of 64 x 64 texels.
    fn atlas(corners: [Vec2; 4]) -> Atlas {
        Atlas {
            layouts: vec![Layout {
                mesh: 0,
                vertices: vec![0, 1, 2, 3],
                uvs: corners.to_vec(),
                triangles: vec![[0, 1, 2], [0, 2, 3]],
                charts: vec![0, 0],
                kept: false,
            }],
            placements: vec![Some(Placement {
                layout: 0,
                page: 0,
                min: [0, 0],
                size: [64, 64],
                texels_per_metre: 1.0,
            })],
            pages: vec![Page { width: 64, height: 64 }],
            ..Atlas::default()
        }
    }

    #[test]
    fn an_upright_square_covers_its_area() {
        let [x, y] = [Vec2::X, Vec2::Y];
        let load = page_loads(&atlas([Vec2::ZERO, x, x + y, y]))[0];
        assert_eq!((load.texels, load.covered, load.triangles), (4096, 4096, 2));
        // Its diagonal crosses 64 texels, which both triangles have; the estimate counts the texels along
        // every edge of a triangle and so is above that, by less than the outline's 256 and its corners.
        assert!((4096 + 64..=4096 + 260).contains(&load.entries), "{load:?}");
    }

    #[test]
    fn a_square_on_its_corner_covers_half_and_its_border() {
        let at = |x: f32, y: f32| Vec2::new(x, y);
        let load = page_loads(&atlas([at(0.5, 0.0), at(1.0, 0.5), at(0.5, 1.0), at(0.0, 0.5)]))[0];
        // Half the page, and on each of 64 rows two texels that it cuts in half.
        assert_eq!(load.covered, 2048 + 128);
        assert_eq!(load.border, 128);
    }

    #[test]
    fn the_peak_is_that_of_the_largest_stage() {
        let none = Memory {
            program: 1,
            scene: 2,
            unwrap: 4,
            atlas: 8,
            tracing: 16,
            build: 0,
            seams: 0,
            grid: 0,
            cache: 0,
            surroundings: 0,
            gather: 0,
            write: 0,
            stitch: 0,
            probes: 0,
            export: 0,
        };
        assert_eq!(none.peak(), 31);
        assert_eq!(Memory { build: 100, ..none }.peak(), 115);
        assert_eq!(Memory { gather: 100, write: 50, export: 70, ..none }.peak(), 131);
        assert_eq!(Memory { gather: 100, stitch: 110, ..none }.peak(), 141);
    }
}
