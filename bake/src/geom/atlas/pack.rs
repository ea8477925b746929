//! Unwrapping and packing with `uvunwrap`: one rectangle for each surface.

use uvunwrap::{Density as UvDensity, Error as UvError, MeshInput, OutputMesh, Packing, Progress, Stage};

use super::{
    AtlasOptions, Density, Meter,
    assemble::narrow as to_f32,
    group::{Class, power_of_two},
    valid::{Kept, Validity},
};
use crate::{
    error::{Error, Finding},
    scene::model::Scene,
};

/// Surfaces whose sizes differ by at most this factor get rectangles of the same size, so that one
/// layout fits the texel grid in all of them. Only whole texels keep charts apart exactly.
const SPREAD: f64 = 1.005;

/// Most charts that are packed by shape.
const SHAPES: u32 = 400;

/// Most triangles that are unwrapped once more to be packed by shape.
const SHAPE_TRIANGLES: usize = 30_000;

/// Attempts at a fixed density before giving up.
const ROUNDS: usize = 16;

/// Shrinks everything by so little that a length which is a whole number of texels but for
/// rounding does not spill into one texel more.
const SNUG: f64 = 1.0 - 1.0 / 16384.0;

/// Several surfaces of one class that share a layout.
pub(super) struct Source {
    /// Index of the class.
    pub(super) class: usize,
    /// Indices into the class's members.
    pub(super) members: Vec<usize>,
    /// Metres per unit of the class's positions, times the ratio of the surfaces' own density to
    /// that of the atlas; for the smallest member.
    pub(super) scale: f64,
}

/// What the packer sees of a class: triangles, or for kept coordinates the rectangle they span.
pub(super) struct Shape {
    positions: Vec<[f32; 3]>,
    indices: Vec<u32>,
    /// Charts of another engine to be packed as they are.
    uvs: Option<Vec<[f32; 2]>>,
    /// Mesh vertex of each vertex of `positions` where these are not the mesh's.
    pub(super) origin: Option<Vec<u32>>,
    /// Kept coordinates.
    pub(super) kept: Option<Kept>,
}

impl Shape {
    /// The class's own triangles, to be unwrapped.
    pub(super) fn mesh(scene: &Scene, class: &Class) -> Self {
        Self {
            positions: class.positions.clone(),
            indices: scene.meshes[class.mesh].triangles.as_flattened().to_vec(),
            uvs: None,
            origin: None,
            kept: None,
        }
    }

    /// A rectangle in place of kept coordinates.
    fn rectangle(kept: Kept) -> Self {
        let size = ((kept.hi - kept.lo) * kept.stretch).as_vec2();
        let (w, h) = (size.x, size.y);
        Self {
            positions: vec![[0.0; 3], [w, 0.0, 0.0], [w, h, 0.0], [0.0, h, 0.0]],
            indices: vec![0, 1, 2, 0, 2, 3],
            uvs: None,
            origin: None,
            kept: Some(kept),
        }
    }

    /// Charts of another engine: vertices with their mesh vertex and coordinates in class units.
    #[cfg(feature = "xatlas")]
    pub(super) fn charted(class: &Class, origin: Vec<u32>, uvs: Vec<[f32; 2]>, indices: Vec<u32>) -> Self {
        Self {
            positions: origin.iter().map(|&v| class.positions[v as usize]).collect(),
            indices,
            uvs: Some(uvs),
            origin: Some(origin),
            kept: None,
        }
    }
}

/// Rectangle of one surface.
pub(super) struct Rect {
    pub(super) page: usize,
    /// Texels.
    pub(super) min: [u32; 2],
    /// Texels.
    pub(super) size: [u32; 2],
    /// Texels per metre.
    pub(super) density: f64,
}

/// What came out.
#[derive(Default)]
pub(super) struct Packed {
    /// Texels per metre.
    pub(super) density: f64,
    /// Number of pages.
    pub(super) pages: usize,
    /// Width that every page keeps, texels; 0 where pages are cropped to what is used.
    pub(super) width: u32,
    pub(super) sources: Vec<Source>,
    /// One for each source.
    pub(super) meshes: Vec<OutputMesh>,
    /// For each source, one for each member.
    pub(super) rects: Vec<Vec<Rect>>,
}

/// What the packer sees of each class.
pub(super) fn shapes(scene: &Scene, classes: &[Class], validity: &[Validity]) -> Vec<Shape> {
    classes
        .iter()
        .zip(validity)
        .map(|(class, v)| match v {
            Ok(kept) => Shape::rectangle(*kept),
            Err(_) => Shape::mesh(scene, class),
        })
        .collect()
}

/// Packs everything at the density asked for.
pub(super) fn pack(
    scene: &Scene,
    classes: &[Class],
    shapes: &[Shape],
    options: &AtlasOptions,
    meter: &Meter<'_>,
    findings: &mut Vec<Finding>,
) -> Result<Packed, Error> {
    let job = Job { scene, classes, shapes, options, meter };
    if classes.is_empty() {
        return Ok(Packed::default());
    }
    match options.density {
        Density::Fixed(density) => job.fixed(f64::from(density), options.max_size, findings),
        Density::Fit { page_size } => job.fit(page_size.min(options.max_size), findings),
    }
}

struct Job<'a> {
    scene: &'a Scene,
    classes: &'a [Class],
    shapes: &'a [Shape],
    options: &'a AtlasOptions,
    meter: &'a Meter<'a>,
}

/// How one call of the packer chooses density and pages.
#[derive(Clone, Copy)]
enum Mode {
    /// Highest density on one page of this size.
    Auto(u32),
    /// The same, but in rectangles even for a single surface.
    Rectangles(u32),
    /// Texels per metre, on one page that grows.
    Grow(f64),
    /// Texels per metre, on pages of this size.
    Pages(f64, u32),
}

impl Job<'_> {
    /// The highest density on one page; on several pages where a surface is too large for one whatever the density.
    fn fit(&self, page_size: u32, findings: &mut Vec<Finding>) -> Result<Packed, Error> {
        let members = || self.classes.iter().flat_map(|c| c.members.iter().map(move |m| (c, m)));
        let area: f64 = members().map(|(c, m)| c.area * m.metres * m.metres).sum();
        let mut density = (0.6 / area).sqrt() * f64::from(page_size);
        let overridden = |s: usize| self.scene.surfaces[s].texels_per_metre.is_some();
        let fixed_points = members().any(|(_, m)| overridden(m.surface));
        // Overrides are absolute, so their share of the page depends on the density found.
        for _ in 0..4 {
            let sources = self.sources(density);
            let limits = vec![1.0; sources.len()];
            let out = match self.generate(&sources, &limits, Mode::Auto(page_size)) {
                // The space between the charts of one surface is more than a page already. Alone it may find room, with fewer texels.
                Err(e @ (UvError::ChartTooLarge { .. } | UvError::AtlasTooLarge { .. })) => {
                    return self.fixed(density, page_size, findings).map_err(|other| match other {
                        Error::Usage(_) => refused(&e),
                        other => other,
                    });
                }
                out => out.map_err(|e| refused(&e))?,
            };
            let mut packed = self.packed(sources, &limits, out);
            packed.width = page_size;
            if !fixed_points {
                return Ok(packed);
            }
            let ratio = packed.density / density;
            density = packed.density;
            if (ratio - 1.0).abs() < 0.01 {
                break;
            }
        }
        for _ in 0..8 {
            let mut packed = self.fixed(density, page_size, findings)?;
            if packed.pages == 1 {
                packed.width = page_size;
                return Ok(packed);
            }
            density *= 0.97;
        }
        self.fixed(density, page_size, findings)
    }

    /// The density asked for, on pages of at most `max_size`.
    fn fixed(&self, density: f64, max_size: u32, findings: &mut Vec<Finding>) -> Result<Packed, Error> {
        let sources = self.sources(density);
        // For each source tried alone, the density that fits a page over the one asked for.
        let mut limits: Vec<Option<f64>> = vec![None; sources.len()];
        let side = f64::from(max_size - 2 * self.options.padding);
        for round in 0..ROUNDS {
            // What cannot fit by its area is found without trying; then what is large; then
            // anything. What fits alone may fail beside others by a little.
            match [0.9, 0.02, 0.0].get(round) {
                Some(share) => {
                    for (limit, source) in limits.iter_mut().zip(&sources) {
                        let texels = self.texels(source, density);
                        if limit.is_none() && share * side * side <= texels {
                            *limit = Some(self.limit(source, density, max_size)?);
                        }
                    }
                }
                None => limits.iter_mut().flatten().for_each(|l| *l *= 0.93),
            }
            let factors: Vec<f64> = limits.iter().map(|l| l.unwrap_or(1.0).min(1.0)).collect();
            if let ([only], [factor]) = (sources.as_slice(), factors.as_slice())
                && only.members.len() == 1
                && *factor < 1.0
            {
                let out = self.generate(&sources, &[1.0], Mode::Auto(max_size));
                let out = out.map_err(|e| refused(&e))?;
                self.report_limits(&sources, &[out.1 / density], density, max_size, findings);
                return Ok(self.packed(sources, &[1.0], out));
            }
            let total: f64 = sources
                .iter()
                .zip(&factors)
                .map(|(s, l)| self.texels(s, density * l) * s.members.len() as f64)
                .sum();
            if total < 0.8 * side * side {
                match self.generate(&sources, &factors, Mode::Grow(density)) {
                    Ok(out) if out.0.width.max(out.0.height) <= max_size => {
                        self.report_limits(&sources, &factors, density, max_size, findings);
                        return Ok(self.packed(sources, &factors, out));
                    }
                    Err(UvError::Cancelled) => return Err(Error::Interrupted),
                    _ => {}
                }
            }
            match self.generate(&sources, &factors, Mode::Pages(density, max_size)) {
                Ok(out) => {
                    self.report_limits(&sources, &factors, density, max_size, findings);
                    return Ok(self.packed(sources, &factors, out));
                }
                Err(UvError::ChartTooLarge { .. } | UvError::AtlasTooLarge { .. }) => {}
                Err(e) => return Err(refused(&e)),
            }
        }
        Err(Error::Usage(format!(
            "{density} texels per metre on pages of {max_size} texels is more than can be packed: \
             lower the density or raise --max-size"
        )))
    }

    /// Texels that the charts of one member cover at a density.
    fn texels(&self, source: &Source, density: f64) -> f64 {
        let side = source.scale * density;
        self.classes[source.class].area * side * side
    }

    /// The density with which one of the source's members fits a page, over the density asked for.
    fn limit(&self, source: &Source, density: f64, max_size: u32) -> Result<f64, Error> {
        let alone = [Source { members: vec![source.members[0]], ..*source }];
        let out = self.generate_as(&alone, &[1.0], Mode::Auto(max_size), Packing::Fast);
        let (_, found) = out.map_err(|e| refused(&e))?;
        Ok(found / density * 0.99)
    }

    fn report_limits(
        &self,
        sources: &[Source],
        limits: &[f64],
        density: f64,
        max_size: u32,
        findings: &mut Vec<Finding>,
    ) {
        let mut out = Vec::new();
        for (source, &limit) in sources.iter().zip(limits) {
            let class = &self.classes[source.class];
            for &m in &source.members {
                if limit < 1.0 {
                    let asked = density * source.scale / class.members[m].metres;
                    let surface = class.members[m].surface;
                    out.push((surface, asked, asked * limit));
                }
            }
        }
        out.sort_by_key(|(surface, ..)| *surface);
        findings.extend(out.into_iter().map(|(surface, asked, got)| {
            Finding::warning(
                &self.scene.surfaces[surface].path,
                format!(
                    "{asked:.3} texels per metre need more than one page of {max_size} texels: \
                     it gets {got:.3} texels per metre"
                ),
                "raise --max-size, lower the density, or cut the mesh into several",
            )
        }));
    }

    /// Surfaces grouped for sharing, given the density of the atlas in texels per metre.
    fn sources(&self, density: f64) -> Vec<Source> {
        let mut out: Vec<Source> = Vec::new();
        for (index, class) in self.classes.iter().enumerate() {
            let mut order: Vec<(f64, usize)> = (0..class.members.len())
                .map(|m| {
                    let member = &class.members[m];
                    let asked = self.scene.surfaces[member.surface]
                        .texels_per_metre
                        .filter(|d| d.is_finite() && 0.0 < *d);
                    (member.metres * asked.map_or(1.0, |d| f64::from(d) / density), m)
                })
                .collect();
            order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for (scale, member) in order {
                match out.last_mut() {
                    Some(s) if s.class == index && scale <= s.scale * SPREAD => {
                        s.members.push(member);
                    }
                    _ => out.push(Source { class: index, members: vec![member], scale }),
                }
            }
        }
        out
    }

    /// Runs the packer; the second value is the density in texels per metre.
    ///
    /// Packing by rows takes seconds where packing by shape takes minutes, but leaves more of the
    /// page empty; so shapes are tried where there are few.
    fn generate(
        &self,
        sources: &[Source],
        limits: &[f64],
        mode: Mode,
    ) -> Result<(uvunwrap::Atlas, f64), UvError> {
        let rows = self.generate_as(sources, limits, mode, Packing::Fast)?;
        if let (true, Mode::Auto(size), 2..) = (direct(sources, mode), mode, rows.0.page_count) {
            // A surface cannot be on two pages.
            return self.generate(sources, limits, Mode::Rectangles(size));
        }
        let indices: usize = sources.iter().map(|s| self.shapes[s.class].indices.len()).sum();
        // Alone in their rectangles, charts gain nothing.
        let alone = rows.0.chart_count as usize <= sources.len();
        if alone || SHAPES < rows.0.chart_count || SHAPE_TRIANGLES < indices / 3 {
            return Ok(rows);
        }
        let area = |a: &uvunwrap::Atlas| u64::from(a.width) * u64::from(a.height) * u64::from(a.page_count);
        match self.generate_as(sources, limits, mode, Packing::Shape) {
            Err(UvError::Cancelled) => Err(UvError::Cancelled),
            Ok(shapes)
                if match mode {
                    Mode::Auto(_) | Mode::Rectangles(_) => {
                        rows.1 < shapes.1 && shapes.0.page_count <= rows.0.page_count
                    }
                    _ => area(&shapes.0) < area(&rows.0),
                } =>
            {
                Ok(shapes)
            }
            _ => Ok(rows),
        }
    }

    fn generate_as(
        &self,
        sources: &[Source],
        limits: &[f64],
        mode: Mode,
        packing: Packing,
    ) -> Result<(uvunwrap::Atlas, f64), UvError> {
        // In units of a power of two near the largest surface's, so that lengths cancel exactly.
        let largest = sources.iter().map(|s| s.scale).fold(0.0, f64::max);
        let unit = power_of_two(largest);
        let scales: Vec<Vec<f32>> = sources
            .iter()
            .zip(limits)
            .map(|(s, l)| vec![narrow(s.scale * l * SNUG / unit); s.members.len()])
            .collect();
        let inputs: Vec<MeshInput<'_>> = sources
            .iter()
            .zip(&scales)
            .map(|(source, scales)| {
                let shape = &self.shapes[source.class];
                let direct = direct(sources, mode);
                MeshInput {
                    existing_uvs: shape.uvs.as_deref(),
                    scale: if direct { scales[0] } else { 1.0 },
                    instance_scales: if direct { &[] } else { scales },
                    ..MeshInput::new(&shape.positions, &shape.indices)
                }
            })
            .collect();
        let density = match mode {
            Mode::Auto(page_size) | Mode::Rectangles(page_size) => UvDensity::Auto { page_size },
            Mode::Grow(d) => UvDensity::Fixed { texels_per_unit: narrow(d * unit), page_size: None },
            Mode::Pages(d, size) => {
                UvDensity::Fixed { texels_per_unit: narrow(d * unit), page_size: Some(size) }
            }
        };
        let options =
            uvunwrap::Options { density, padding: self.options.padding, packing, ..Default::default() };
        let out = uvunwrap::generate_with_progress(&inputs, &options, |p| self.heard(p))?;
        let density = f64::from(out.texels_per_unit) / unit;
        Ok((out, density))
    }

    /// Passes progress on; false asks to stop.
    fn heard(&self, p: Progress) -> bool {
        let part = |from: usize, to: usize| match p.total {
            Some(total) if 0 < total => from + (to - from) * p.done.min(total) / total,
            // The number of trials is unknown: half of what is left for every eight.
            _ => from + (to - from) * p.done / (p.done + 8),
        };
        self.meter.report(match p.stage {
            Stage::Segmenting => part(3, 8),
            Stage::Parameterizing => part(8, 60),
            Stage::Packing => part(60, 95),
            _ => part(95, 99),
        })
    }

    fn packed(&self, sources: Vec<Source>, limits: &[f64], out: (uvunwrap::Atlas, f64)) -> Packed {
        let (mut atlas, density) = out;
        let page = [atlas.width, atlas.height];
        let texels = |at: [f32; 2]| [0, 1].map(|i| whole(f64::from(at[i]) * f64::from(page[i])));
        let mut rects = Vec::new();
        for ((source, mesh), limit) in sources.iter().zip(&mut atlas.meshes).zip(limits) {
            let class = &self.classes[source.class];
            let density = |m: usize| density * source.scale * limit / class.members[m].metres;
            let mut list = Vec::new();
            if mesh.instances.is_empty() {
                let (min, size) = whole_page(mesh, page, self.options.padding);
                let m = source.members[0];
                list.push(Rect { page: 0, min, size, density: density(m) });
            }
            for (&m, r) in source.members.iter().zip(&mesh.instances) {
                let (min, max) = (texels(r.min), texels(r.max));
                // The layout was made for this very size, so it is whole but for rounding.
                let size = [0, 1].map(|i| max[i].saturating_sub(min[i]).max(1));
                list.push(Rect { page: r.page as usize, min, size, density: density(m) });
            }
            rects.push(list);
        }
        // A mesh of which no triangle has area has a place but no chart, and the packer no page.
        let pages = rects.iter().flatten().map(|r: &Rect| r.page + 1).max().unwrap_or(0);
        let pages = pages.max(atlas.page_count as usize);
        Packed { density, pages, width: 0, sources, meshes: atlas.meshes, rects }
    }
}

/// Whether a single surface gets the page to itself: its charts then go onto the page directly,
/// which is far quicker than into a rectangle that goes onto the page.
fn direct(sources: &[Source], mode: Mode) -> bool {
    let [only] = sources else { return false };
    only.members.len() == 1 && matches!(mode, Mode::Auto(_) | Mode::Grow(_))
}

/// The rectangle of charts that went onto the page directly, with their coordinates turned into
/// those of the rectangle.
fn whole_page(mesh: &mut OutputMesh, page: [u32; 2], padding: u32) -> ([u32; 2], [u32; 2]) {
    let size = page.map(|n| n.saturating_sub(2 * padding).max(1));
    for v in &mut mesh.vertices {
        for axis in 0..2 {
            let texel = f64::from(v.uv[axis]) * f64::from(page[axis]) - f64::from(padding);
            v.uv[axis] = to_f32(texel / f64::from(size[axis])).clamp(0.0, 1.0);
        }
    }
    ([padding; 2], size)
}

/// Nearest whole number of texels.
fn whole(x: f64) -> u32 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "corners on a page of at most 2^15 texels"
    )]
    let n = x.round() as u32;
    n
}

/// To the packer's precision, kept inside its range.
fn narrow(x: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "clamped to what f32 holds")]
    let y = x.clamp(f64::from(f32::MIN_POSITIVE), f64::from(f32::MAX)) as f32;
    y
}

fn refused(e: &UvError) -> Error {
    match e {
        UvError::Cancelled => Error::Interrupted,
        UvError::ChartTooLarge { .. } | UvError::AtlasTooLarge { .. } => Error::Usage(
            "the surfaces cannot be laid out: one of them has more charts than a page has room for; raise --max-size"
                .to_owned(),
        ),
        e => Error::Usage(format!("the surfaces cannot be laid out: {e}")),
    }
}
