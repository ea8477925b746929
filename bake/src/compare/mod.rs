//! Compares two bakes, or two EXRs, by their files alone.
//!
//! `b` is the reference: relative figures are divided by its mean luminance. Texels count where
//! both sides cover them (alpha above 0; everywhere without alpha).

mod equality;
mod figures;
mod input;
mod pictures;

use std::{fmt, fs, path::Path};

use serde::Serialize;

pub use equality::Equality;
pub use figures::{Figures, Place};

use crate::error::{Error, Result};
use equality::Tester;
use figures::Sums;

/// How strict a comparison is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Probability in [0, 1] that two bakes of equal expectation are called different.
    pub alpha: f64,
    /// Greatest relative root mean square difference that counts as equal where a side has no variance.
    pub tolerance: f64,
}

impl Options {
    /// One false alarm in a thousand; 0.1 % of the mean luminance.
    pub const STANDARD: Self = Self { alpha: 1e-3, tolerance: 1e-3 };
}

/// What a comparison found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The same bits in colour and coverage.
    Identical,
    /// No difference beyond noise, or beyond the tolerance where there is no variance.
    Equal,
    /// Different; [`Report::reasons`] says in what.
    Different,
}

/// Result of a comparison, for people (`Display`) and programs (`Serialize`).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// First side as it was given.
    pub a: String,
    /// Second side, the reference.
    pub b: String,
    /// The answer.
    pub verdict: Verdict,
    /// Why the two differ; empty otherwise.
    pub reasons: Vec<String>,
    /// Figures over all pages.
    pub total: Figures,
    /// Test of equality, where both sides carry standard errors.
    pub equality: Option<Equality>,
    /// Relative root mean square difference allowed where there is no test.
    pub tolerance: f64,
    /// Figures page by page.
    pub pages: Vec<PageReport>,
    /// Pictures that were written, by file name.
    pub pictures: Vec<String>,
}

/// Figures of one page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PageReport {
    /// File name of the first side's page.
    pub a: String,
    /// File name of the second side's page.
    pub b: String,
    /// Whether colour and coverage are the same bits.
    pub identical: bool,
    /// Error figures.
    pub figures: Figures,
    /// Difference, nits, that the difference picture shows in full colour; 0 without a picture.
    pub picture_scale: f64,
}

/// Compares `a` with the reference `b` under [`Options::STANDARD`]; writes difference pictures into
/// the folder `out` where one is given.
///
/// # Errors
/// As [`compare_with`].
pub fn compare(a: &Path, b: &Path, out: Option<&Path>) -> Result<Report> {
    compare_with(a, b, out, &Options::STANDARD)
}

/// Compares `a` with the reference `b`.
///
/// Pictures are `difference-N.png` (red where `a` is brighter), `difference-N.exr` (`a - b`) and,
/// where there is a test, `z-N.png` (full colour at 4 standard errors).
///
/// # Errors
/// [`Error::Usage`] where the two cannot be compared: numbers of pages, sizes or channels do not
/// match; [`Error::Io`] where files cannot be read or written.
pub fn compare_with(a: &Path, b: &Path, out: Option<&Path>, options: &Options) -> Result<Report> {
    let (side_a, side_b) = (input::open(a)?, input::open(b)?);
    let (n_a, n_b) = (side_a.pages.len(), side_b.pages.len());
    if n_a != n_b {
        let (a, b) = (a.display(), b.display());
        return Err(Error::Usage(format!("{a} has {n_a} pages and {b} has {n_b}: they cannot be compared")));
    }
    if let Some(out) = out {
        fs::create_dir_all(out).map_err(Error::io(out, "cannot create"))?;
    }
    let mut tester = Tester::new(options.alpha, side_a.samples.min(side_b.samples));
    let mut total = Sums::default();
    let mut pages = Vec::new();
    let mut pictures = Vec::new();
    let mut all_tested = true;
    for (index, (file_a, file_b)) in side_a.pages.iter().zip(&side_b.pages).enumerate() {
        let (page_a, page_b) = (input::read(file_a)?, input::read(file_b)?);
        if (page_a.width, page_a.height) != (page_b.width, page_b.height) {
            return Err(Error::Usage(format!(
                "{} is {} x {} and {} is {} x {}: sizes have to match",
                file_a.display(),
                page_a.width,
                page_a.height,
                file_b.display(),
                page_b.width,
                page_b.height
            )));
        }
        let sums = Sums::of(&page_a, &page_b, index);
        let tested = tester.add(&page_a, &page_b, index);
        all_tested &= tested;
        let mut picture_scale = 0.0;
        if let Some(out) = out {
            let written = pictures::write(out, index, &page_a, &page_b, &sums, tested)?;
            picture_scale = written.scale;
            pictures.extend(written.files);
        }
        pages.push(PageReport {
            a: input::file_name(file_a),
            b: input::file_name(file_b),
            identical: page_a.same_bits(&page_b),
            figures: sums.figures(),
            picture_scale,
        });
        total = total.merge(sums);
    }
    let figures = total.figures();
    let equality = if all_tested { tester.finish() } else { None };
    let identical = pages.iter().all(|p| p.identical);
    // Two bakes of one scene cover the same texels; files of other programs may cover what they like.
    let layouts_differ = side_a.is_bake && side_b.is_bake && figures.coverage_mismatches != 0;
    let reasons =
        if identical { Vec::new() } else { reasons(&figures, equality.as_ref(), layouts_differ, options) };
    let verdict = match (identical, reasons.is_empty()) {
        (true, _) => Verdict::Identical,
        (false, true) => Verdict::Equal,
        (false, false) => Verdict::Different,
    };
    Ok(Report {
        a: a.display().to_string(),
        b: b.display().to_string(),
        verdict,
        reasons,
        total: figures,
        equality,
        tolerance: options.tolerance,
        pages,
        pictures,
    })
}

fn reasons(
    figures: &Figures,
    equality: Option<&Equality>,
    layouts_differ: bool,
    options: &Options,
) -> Vec<String> {
    let mut reasons = Vec::new();
    if layouts_differ {
        let n = figures.coverage_mismatches;
        reasons.push(format!("{n} texels are covered on one side only: the layouts differ"));
    }
    if figures.non_finite != 0 {
        reasons.push(format!("{} texels are not finite", figures.non_finite));
    }
    if figures.texels == 0 {
        reasons.push("no texel is covered on both sides".to_owned());
    }
    match (equality, figures.relative_rmse) {
        (Some(test), _) => reasons.extend(test.reasons()),
        (None, Some(relative)) if options.tolerance < relative => reasons.push(format!(
            "relative RMSE {relative:.3e} is above the tolerance {:.3e} (no standard errors to test with)",
            options.tolerance
        )),
        (None, None) if 0.0 < figures.mse => {
            reasons.push("the reference is black and the other is not".to_owned());
        }
        _ => {}
    }
    reasons
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let t = &self.total;
        let percent = |r: Option<f64>| r.map_or_else(|| "-".to_owned(), |r| format!("{:.4} %", 100.0 * r));
        writeln!(f, "a: {}\nb: {} (reference)", self.a, self.b)?;
        writeln!(
            f,
            "texels {} on {} pages, mean {:.6} and {:.6} nits",
            t.texels,
            self.pages.len(),
            t.mean_a,
            t.mean_b
        )?;
        write!(f, "RMSE {:.6e} ({} of the mean)", t.rmse, percent(t.relative_rmse))?;
        write!(f, ", bias {:+.6e} ({})", t.bias, percent(t.relative_bias))?;
        write!(f, ", relMSE {:.4e}", t.rel_mse)?;
        match t.psnr {
            Some(psnr) => writeln!(f, ", PSNR {psnr:.1} dB")?,
            None => writeln!(f)?,
        }
        if let Some(at) = &t.max_at {
            writeln!(f, "largest difference {:.6e} at {at}", t.max_difference)?;
        }
        if let Some(test) = &self.equality {
            writeln!(f, "{test}")?;
        }
        for reason in &self.reasons {
            writeln!(f, "  {reason}")?;
        }
        f.write_str(match self.verdict {
            Verdict::Identical => "identical",
            Verdict::Equal if self.equality.is_some() => "equal within noise",
            Verdict::Equal => "equal within tolerance",
            Verdict::Different => "different",
        })
    }
}

#[cfg(test)]
mod tests;
