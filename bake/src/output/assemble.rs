//! Puts solved texels into a page: validity, fill, gutter.

use crate::geom::texel::TexelMap;
use crate::output::denoise::Light;
use crate::output::dilate::{self, Filled, NO_CHART};
use crate::output::page::{Page, PageStats};
use crate::output::stitch::{self, Bits};
use crate::plan::Plan;
use crate::solve::directional::Direction;
use crate::solve::lightmap::Solution;
use crate::solve::visible::{Validity, is_beside};

/// Texels of the solution that are moved into the page before their memory is given back.
const BATCH: usize = 1 << 16;

/// A page from its solution: every covered texel has its value, hidden ones are filled from their
/// chart, and charts continue outwards by the plan's padding. Ready for stitching. The
/// solution's memory is given back while the page's fills. `clean` is what denoising made of the texels, if it was asked for.
#[must_use]
pub fn page(
    plan: &Plan,
    map: TexelMap,
    mut solution: Solution,
    mut clean: Option<Vec<Light>>,
    directions: Option<Vec<Direction>>,
) -> (stitch::Sheet, Filled) {
    let mut sheet = Sheet::new(&map);
    if let Some(directions) = directions {
        sheet.page.sh1 = Some(std::array::from_fn(|axis| {
            let mut layer = vec![[0.0; 3]; sheet.charts.len()];
            for (k, (texel, d)) in map.texels.iter().zip(&directions).enumerate() {
                // What denoising made brighter or darker comes from the same directions.
                let value = clean
                    .as_deref()
                    .map_or_else(|| solution.texels[k].value(), |clean| clean[k].direct + clean[k].indirect);
                layer[*texel as usize] = (d[axis] * value).to_array();
            }
            layer
        }));
    }
    if clean.is_some() {
        let n = sheet.charts.len();
        sheet.page.noisy = Some(vec![[0.0; 3]; n]);
        sheet.page.rmse = Some(vec![[0.0; 3]; n]);
    }
    if plan.settings().split_direct {
        let n = sheet.charts.len();
        sheet.page.direct = Some(vec![[0.0; 3]; n]);
        sheet.page.indirect = Some(vec![[0.0; 3]; n]);
    }
    while !solution.texels.is_empty() {
        // From the end, because only there can a list be shortened in place.
        let start = solution.texels.len().saturating_sub(BATCH);
        sheet.put(plan, &map, &solution, clean.as_deref(), start);
        solution.texels.truncate(start);
        solution.texels.shrink_to_fit();
        if let Some(clean) = &mut clean {
            clean.truncate(start);
            clean.shrink_to_fit();
        }
    }
    drop(map);
    let (filled, gathered) = sheet.fill();
    dilate::fill_gutter(&mut sheet.page, &sheet.charts, plan.settings().padding);
    sheet.page.limit_directions();
    (stitch::Sheet { page: sheet.page, gathered, backs: sheet.backs }, filled)
}

/// The figures that the page of a solution will have, which stays as it is.
#[must_use]
pub fn figure(plan: &Plan, map: &TexelMap, solution: &Solution) -> PageStats {
    let mut sheet = Sheet::new(map);
    sheet.put(plan, map, solution, None, 0);
    sheet.fill();
    PageStats::of(&sheet.page).with_squares(solution.squares())
}

/// A page in the making.
struct Sheet {
    page: Page,
    charts: Vec<u32>,
    validity: Vec<Validity>,
    backs: Bits,
}

impl Sheet {
    fn new(map: &TexelMap) -> Self {
        let (width, height) = (map.width as usize, map.height as usize);
        let n = width * height;
        Self {
            page: Page::new(width, height),
            charts: vec![NO_CHART; n],
            validity: vec![Validity::Valid; n],
            backs: Bits::new(n),
        }
    }

    /// Enters the texels of a solution from number `start` on, denoised where `clean` is given.
    fn put(
        &mut self,
        plan: &Plan,
        map: &TexelMap,
        solution: &Solution,
        clean: Option<&[Light]>,
        start: usize,
    ) {
        let Self { page, charts, validity, backs } = self;
        for (index, texel) in solution.texels.iter().enumerate().skip(start) {
            let at = map.texels[index] as usize;
            let (value, mut direct, mut indirect) = (texel.value(), texel.direct(), texel.indirect());
            page.radiance[at] = value.to_array();
            if let (Some(clean), Some(noisy), Some(rmse)) = (clean, &mut page.noisy, &mut page.rmse) {
                let light = clean[index];
                (direct, indirect) = (light.direct, light.indirect);
                noisy[at] = value.to_array();
                page.radiance[at] = (direct + indirect).to_array();
                rmse[at] = light.rmse.to_array();
            }
            page.coverage[at] = texel.coverage;
            #[expect(clippy::cast_possible_truncation, reason = "a factor near 1")]
            let factor = solution.factor(texel) as f32;
            page.std_err[at] = (texel.std_err() * factor).to_array();
            if let (Some(d), Some(i)) = (&mut page.direct, &mut page.indirect) {
                d[at] = direct.to_array();
                i[at] = indirect.to_array();
            }
            charts[at] = map.triangles_of(index).first().map_or(NO_CHART, |&t| map.chart(plan.atlas(), t));
            validity[at] = texel.validity;
            if texel.turned() {
                backs.insert(at);
            }
        }
    }

    /// Gives texels that cannot be seen the light of their chart.
    fn fill(&mut self) -> (Filled, Bits) {
        let Self { page, charts, validity, .. } = self;
        let validity = std::mem::take(validity);
        let beside_valid = |at: usize| {
            let counts = |other: usize| charts[other] == charts[at] && validity[other] == Validity::Valid;
            charts[at] != NO_CHART && is_beside([page.width, page.height], at, counts)
        };
        let valid: Vec<bool> = (0..validity.len())
            .map(|at| match validity[at] {
                Validity::Valid => true,
                Validity::Hidden => false,
                Validity::Enclosed => !beside_valid(at),
            })
            .collect();
        drop(validity);
        let gathered = Bits::of(valid.len(), |i| charts[i] != NO_CHART && valid[i]);
        (dilate::fill_invalid(page, charts, &valid), gathered)
    }
}
