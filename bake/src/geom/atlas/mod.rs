//! Charts and atlas pages: where every lit point of the scene lives in a lightmap.
//!
//! [`build`] gives each [`Surface`](crate::scene::model::Surface) that receives light its own
//! rectangle of whole texels on a page. Inside the rectangle lies the layout of its mesh, which
//! surfaces share where they show the same shape at about the same size. The texture coordinate
//! of a vertex in its page is
//!
//! ```text
//! TEXCOORD_1 = (placement.min + layout.uv * placement.size) / page size
//! ```
//!
//! with v growing downwards and row 0 at the top, as glTF has it.
//!
//! Charts of one rectangle, and of different rectangles, lie at least `2 * padding` texels apart
//! where this module laid them out. Where the file's own second texture coordinates are kept, the
//! distance is the author's; a finding says so where it is below two texels.
//!
//! # uvunwrap and xatlas
//!
//! One 1024 x 1024 page, padding 2, two cores shared with other work, debug profile (optimised), 22
//! November 2026. Packing is the same for both; stretch is the root mean square over the area of
//! length per texel, 1 being perfect. The example `charts` measures the generated meshes anew.
//!
//! | mesh | triangles | uvunwrap: s, charts, stretch, utilisation | xatlas: the same |
//! |---|---|---|---|
//! | bumpy floor | 5,000 | 0.40, 1, 1.004, 99 % | 2.6, 1, 1.004, 99 % |
//! | bumpy floor | 20,000 | 3.2, 1, 1.006, 99 % | over 30 s, stopped |
//! | sphere | 2,048 | 0.65, 5, 1.007, 67 % | 1.15, 35, 1.005, 62 % |
//! | gazebo | 730 | 0.19, 299, 1.001, 81 % | 0.43, 332, 1.001, 80 % |
//! | room of 17 meshes | 63,720 | 2.3, 156, 1.000, 70 % | 5.4, 124, 1.000, 71 % |
//! | level in one mesh | 58,772 | 4.1, 15,609, 1.023, 29 % | 6.6, 14,415, 1.016, 33 % |
//! | Sponza, 170 surfaces | 262,087 | 2.3, 9,725, 1.025, 33 % | 24, 10,425, 1.020, 32 % |
//! | staircase, 775 surfaces | 262,663 | 10.4, 4,939, 1.012, 29 % | 30, 10,940, 1.024, 25 % |
//!
//! So xatlas gains nothing that would pay for a C++ library; it stays an option for comparison.
//!
//! Lengths enter only relative to powers of two of the scene's own size, so scaling a scene by
//! `2^k` and its density by `2^-k` gives the same atlas to the bit.

mod assemble;
mod group;
mod kept;
mod overlap;
mod pack;
#[cfg(test)]
#[expect(clippy::cast_possible_truncation, reason = "small meshes")]
pub(crate) mod testing;
#[cfg(test)]
mod tests;
mod valid;
#[cfg(feature = "xatlas")]
pub mod xatlas;

use std::sync::atomic::{AtomicUsize, Ordering};

use glam::Vec2;

pub(crate) use group::cross;

use crate::{
    error::{Error, Finding, Severity},
    scene::model::{LightmapMode, Scene},
};

/// Chart id of a triangle that has no area and so no texels.
pub const NO_CHART: u32 = u32::MAX;

/// How dense the texels lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Density {
    /// The highest density at which everything fits one page of `page_size` texels a side. The
    /// page is cropped to the rows used.
    Fit {
        /// Width and greatest height of the page, texels; at most [`AtlasOptions::max_size`] counts.
        page_size: u32,
    },
    /// Texels per metre of surface, on as many pages as that takes.
    Fixed(f32),
}

/// What happens to second texture coordinates (`TEXCOORD_1`) that the file brings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Unwrap {
    /// They are used; a surface without valid ones is an error.
    Keep,
    /// They are used where valid, and the other surfaces are unwrapped.
    #[default]
    Auto,
    /// They are ignored.
    Always,
}

/// What cuts and flattens the charts. Packing is the same for both.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// The crate `uvunwrap`.
    #[default]
    Uvunwrap,
    /// The library xatlas in a child process, with this many seconds for each mesh; where it takes
    /// longer `uvunwrap` does the work and a finding says so.
    #[cfg(feature = "xatlas")]
    Xatlas {
        /// Seconds of wall time for one mesh.
        seconds: u32,
    },
}

/// How [`build`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AtlasOptions {
    /// Texel density.
    pub density: Density,
    /// Greatest width and height of a page, texels; pages come in multiples of four.
    pub max_size: u32,
    /// Empty texels around each chart: two charts are `2 * padding` apart. Two are enough for
    /// bicubic sampling.
    pub padding: u32,
    /// What happens to second texture coordinates in the file.
    pub unwrap: Unwrap,
    /// What flattens.
    pub engine: Engine,
}

impl Default for AtlasOptions {
    fn default() -> Self {
        Self {
            density: Density::Fit { page_size: 1024 },
            max_size: 4096,
            padding: 2,
            unwrap: Unwrap::Auto,
            engine: Engine::Uvunwrap,
        }
    }
}

/// One lightmap image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Page {
    /// Texels per row, a multiple of 4 unless the greatest size is not.
    pub width: u32,
    /// Rows, a multiple of 4 unless the greatest size is not.
    pub height: u32,
}

/// Texture coordinates of one mesh within a rectangle.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// Index into [`Scene::meshes`].
    pub mesh: usize,
    /// For each vertex of the layout, the vertex of the mesh it stands for. Vertices on seams are
    /// repeated.
    pub vertices: Vec<u32>,
    /// Texture coordinate of each vertex, in [0, 1] of the rectangle, finite, v downwards.
    pub uvs: Vec<Vec2>,
    /// The mesh's triangles in the mesh's order, as indices into `vertices`.
    pub triangles: Vec<[u32; 3]>,
    /// Chart of each triangle, counted from 0 in this layout; [`NO_CHART`] where it has none.
    pub charts: Vec<u32>,
    /// Whether this is the file's own `TEXCOORD_1`.
    pub kept: bool,
}

/// Where a surface lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Index into [`Atlas::layouts`].
    pub layout: usize,
    /// Index into [`Atlas::pages`].
    pub page: usize,
    /// Corner of the rectangle with the smallest coordinates, texels.
    pub min: [u32; 2],
    /// Width and height of the rectangle, texels, each at least 1.
    pub size: [u32; 2],
    /// Mean density on this surface, texels per metre.
    pub texels_per_metre: f32,
}

/// Charts of a scene on pages.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Atlas {
    /// The images.
    pub pages: Vec<Page>,
    /// Texture coordinates, each used by one or more placements.
    pub layouts: Vec<Layout>,
    /// One entry for each of [`Scene::surfaces`]; `None` where it has no texels. Rectangles do not
    /// overlap, except where the file's shared atlas is kept: there each is the whole page.
    pub placements: Vec<Option<Placement>>,
    /// Density of surfaces without an override, texels per metre; 0 where nothing has texels.
    pub texels_per_metre: f32,
    /// Number of charts over all placements.
    pub charts: usize,
    /// Area of the charts over the area of the pages, in [0, 1].
    pub utilisation: f32,
}

impl Atlas {
    /// Page coordinates in texels of vertex `vertex` of the layout that `placement` shows.
    pub fn texel_position(&self, placement: &Placement, vertex: u32) -> Vec2 {
        let uv = self.layouts[placement.layout].uvs[vertex as usize];
        let [x, y] = placement.min;
        let [w, h] = placement.size;
        Vec2::new(x as f32 + uv.x * w as f32, y as f32 + uv.y * h as f32)
    }

    /// Page coordinates in [0, 1], glTF's `TEXCOORD_1`, of vertex `vertex` of the layout that
    /// `placement` shows.
    pub fn page_uv(&self, placement: &Placement, vertex: u32) -> Vec2 {
        let page = self.pages[placement.page];
        self.texel_position(placement, vertex) / Vec2::new(page.width as f32, page.height as f32)
    }
}

/// Lays out every surface that receives light: `lightmap` on, with a material that is lit.
///
/// `progress` hears of work done out of a total in no particular unit, possibly on another thread
/// but never two at a time; when it returns false the work stops.
///
/// # Errors
///
/// [`Error::Interrupted`] when `progress` returned false. [`Error::Usage`] for options out of
/// range or a density no page set can hold. [`Error::Input`] with one finding a surface when
/// [`Unwrap::Keep`] meets texture coordinates it cannot use.
pub fn build(
    scene: &Scene,
    options: &AtlasOptions,
    progress: &(dyn Fn(usize, usize) -> bool + Sync),
) -> Result<(Atlas, Vec<Finding>), Error> {
    check(options)?;
    // So that every page is whole blocks.
    let whole = |n: u32| n / assemble::BLOCK * assemble::BLOCK;
    let density = match options.density {
        Density::Fit { page_size } => Density::Fit { page_size: whole(page_size) },
        fixed @ Density::Fixed(_) => fixed,
    };
    let options = &AtlasOptions { density, max_size: whole(options.max_size), ..*options };
    let meter = Meter { done: AtomicUsize::new(0), progress };
    let mut findings = Vec::new();
    let wanted: Vec<usize> = (0..scene.surfaces.len())
        .filter(|&i| {
            let s = &scene.surfaces[i];
            s.lightmap == LightmapMode::On && scene.materials.get(s.material).is_none_or(|m| !m.unlit)
        })
        .collect();
    let classes = group::classes(scene, &wanted, &mut findings);
    let validity = valid::examine(scene, &classes, options.unwrap);
    if !meter.report(3) {
        return Err(Error::Interrupted);
    }
    if options.unwrap == Unwrap::Keep {
        let refused = valid::refusals(scene, &classes, &validity);
        if refused.iter().any(|f| f.severity == Severity::Error) {
            return Err(Error::Input(refused));
        }
        if let Some(atlas) = kept::shared(scene, options, &classes, &validity) {
            return Ok((atlas, findings));
        }
    }
    let shapes = pack::shapes(scene, &classes, &validity);
    #[cfg(feature = "xatlas")]
    let shapes = match options.engine {
        Engine::Xatlas { seconds } => {
            let mut shapes = shapes;
            xatlas::chart(scene, &classes, &mut shapes, seconds, &meter, &mut findings)?;
            shapes
        }
        Engine::Uvunwrap => shapes,
    };
    let packed = pack::pack(scene, &classes, &shapes, options, &meter, &mut findings)?;
    let atlas = assemble::assemble(scene, &classes, &shapes, packed, options, &mut findings);
    if !meter.report(100) {
        return Err(Error::Interrupted);
    }
    Ok((atlas, findings))
}

fn check(options: &AtlasOptions) -> Result<(), Error> {
    let least = 2 * options.padding.min(1 << 20) + 4;
    let usage = |text: String| Err(Error::Usage(text));
    if options.max_size < least || (1 << 15) < options.max_size {
        return usage(format!(
            "page size limit of {} texels: expected {least} to {} with padding {}",
            options.max_size,
            1 << 15,
            options.padding
        ));
    }
    match options.density {
        Density::Fit { page_size } if page_size < least => {
            usage(format!("page size of {page_size} texels: expected at least {least}"))
        }
        Density::Fixed(d) if !(d.is_finite() && 0.0 < d) => {
            usage(format!("density of {d} texels per metre: expected a positive number"))
        }
        _ => Ok(()),
    }
}

/// Progress as a percentage that never falls.
struct Meter<'a> {
    done: AtomicUsize,
    progress: &'a (dyn Fn(usize, usize) -> bool + Sync),
}

impl Meter<'_> {
    /// Reports `percent` done; false asks to stop.
    fn report(&self, percent: usize) -> bool {
        let before = self.done.fetch_max(percent, Ordering::Relaxed);
        (self.progress)(before.max(percent).min(100), 100)
    }
}
