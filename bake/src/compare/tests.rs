//! Whole comparisons over files.

use std::path::PathBuf;

use tables::format::manifest::{Manifest, Page as ManifestPage, Timings};

use super::*;
use crate::output::{exr, folder::Staging, page::Page};

/// SplitMix64's output function (\[SLF14\]).
fn mix(mut x: u64) -> u64 {
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// Uniform numbers in (0, 1) that depend on (seed, index) alone.
fn uniform(seed: u64, index: u64) -> f64 {
    let x =
        mix(mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15))
            .wrapping_add(index.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
    ((x >> 12) as f64 + 0.5) / (1_u64 << 52) as f64
}

/// Standard normal number (Box and Muller).
fn normal(seed: u64, index: u64) -> f64 {
    let (u, v) = (uniform(seed, 2 * index), uniform(seed, 2 * index + 1));
    (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
}

const SIDE: usize = 16;

fn truth(i: usize, c: usize) -> f64 {
    2.0 + (i % SIDE) as f64 * 0.3 + c as f64
}

fn sigma(i: usize) -> f64 {
    0.01 * (1 + i % 5) as f64
}

#[expect(clippy::cast_possible_truncation, reason = "pages hold 32-bit floats")]
fn float(x: f64) -> f32 {
    x as f32
}

/// The truth plus noise; channels share their noise, as paths do. Half of the last row is gutter.
fn noisy(seed: u64, offset_in_sigma: f64) -> Page {
    let mut page = Page::new(SIDE, SIDE);
    for i in 0..SIDE * SIDE {
        let covered = i < SIDE * SIDE - SIDE / 2;
        page.coverage[i] = if covered { 0.75 } else { 0.0 };
        let noise = sigma(i) * (normal(seed, i as u64) + offset_in_sigma);
        page.radiance[i] = [0, 1, 2].map(|c| if covered { float(truth(i, c) + noise) } else { f32::NAN });
        page.std_err[i] = [float(sigma(i)); 3];
    }
    page
}

/// An estimate from `n` samples with its own estimated standard error.
fn sampled(seed: u64, n: u64) -> Page {
    let mut page = Page::new(SIDE, SIDE);
    for i in 0..SIDE * SIDE {
        let mut moments = tables::num::moments::Moments::default();
        (0..n).for_each(|k| moments.push(1.0 + normal(seed, i as u64 * n + k)));
        page.coverage[i] = 1.0;
        page.radiance[i] = [float(moments.mean); 3];
        page.std_err[i] = [float(moments.std_err()); 3];
    }
    page
}

fn layers(page: &Page) -> input::Layers {
    let planes = |layer: &[[f32; 3]]| [0, 1, 2].map(|c| layer.iter().map(|v| v[c]).collect());
    input::Layers {
        width: page.width,
        height: page.height,
        light: planes(&page.radiance),
        coverage: Some(page.coverage.clone()),
        std_err: Some(planes(&page.std_err)),
        rounding: 1e-6,
    }
}

fn is_equal(a: &Page, b: &Page, samples: Option<u64>) -> bool {
    let mut tester = Tester::new(Options::STANDARD.alpha, samples);
    assert!(tester.add(&layers(a), &layers(b), 0));
    tester.finish().expect("texels").equal
}

fn write(dir: &Path, name: &str, page: &Page) -> PathBuf {
    let path = dir.join(name);
    exr::write_page(&path, page).expect("written");
    path
}

fn write_bake(dir: &Path, name: &str, pages: &[Page], samples: u64) -> PathBuf {
    let path = dir.join(name);
    let staging = Staging::begin(&path).expect("folder");
    let mut manifest = Manifest::new("bake", "0");
    manifest.samples.min = samples;
    for (i, page) in pages.iter().enumerate() {
        let file = format!("lightmap-{i}.exr");
        exr::write_page(&staging.path(&file), page).expect("written");
        manifest.pages.push(ManifestPage { file, ..ManifestPage::default() });
    }
    staging.commit(manifest, &Timings::new()).expect("committed");
    path
}

#[test]
fn identical_files_are_identical() -> anyhow::Result<()> {
    let dir = tempfile::tempdir()?;
    let (a, b) = (write(dir.path(), "a.exr", &noisy(1, 0.0)), write(dir.path(), "b.exr", &noisy(1, 0.0)));
    let report = compare(&a, &b, None)?;
    assert_eq!(report.verdict, Verdict::Identical);
    assert_eq!((report.total.mse, report.total.max_at), (0.0, None));
    assert_eq!(report.total.texels, (SIDE * SIDE - SIDE / 2) as u64);
    assert!(report.to_string().ends_with("identical"), "{report}");
    Ok(())
}

/// alpha is 0.001, so 1000 pairs give one false alarm on average and more than ten once in 10^8.
#[test]
fn noise_alone_is_equal() {
    let alarms = (0..1000).filter(|&s| !is_equal(&noisy(2 * s, 0.0), &noisy(2 * s + 1, 0.0), None)).count();
    assert!(alarms <= 10, "{alarms} of 1000");
}

/// With four samples a normal threshold would see outliers everywhere.
#[test]
fn few_samples_have_long_tails() {
    let n_pairs = 200;
    let alarms = |samples| {
        (0..n_pairs).filter(|&s| !is_equal(&sampled(2 * s, 4), &sampled(2 * s + 1, 4), samples)).count()
    };
    assert!(alarms(Some(4)) <= 2, "{} of {n_pairs}", alarms(Some(4)));
    assert!(20 < alarms(None), "{} of {n_pairs}", alarms(None));
}

#[test]
fn bias_is_different() {
    for seed in 0..100 {
        assert!(!is_equal(&noisy(2 * seed, 5.0), &noisy(2 * seed + 1, 0.0), None), "seed {seed}: all by 5");
        // A bias far below each texel's noise shows in the mean of 248 texels, about 0.7 sqrt(248/2) = 7.8.
        assert!(!is_equal(&noisy(2 * seed, 0.7), &noisy(2 * seed + 1, 0.0), None), "seed {seed}: all by 0.7");
        let mut spot = noisy(2 * seed, 0.0);
        spot.radiance[77] = spot.radiance[77].map(|v| v + 12.0 * float(sigma(77)));
        assert!(!is_equal(&spot, &noisy(2 * seed + 1, 0.0), None), "seed {seed}: one texel by 12");
        let mut loud = noisy(2 * seed, 0.0);
        loud.std_err.iter_mut().for_each(|e| *e = [0.0; 3]);
        assert!(!is_equal(&loud, &loud_twin(seed), None), "seed {seed}: understated errors");
    }
}

fn loud_twin(seed: u64) -> Page {
    let mut page = noisy(2 * seed + 1, 0.0);
    page.std_err.iter_mut().for_each(|e| *e = e.map(|v| v * 0.3));
    page
}

#[test]
fn rounding_is_no_difference() {
    let (mut a, mut b) = (noisy(1, 0.0), noisy(1, 0.0));
    for page in [&mut a, &mut b] {
        page.std_err.iter_mut().for_each(|e| *e = [0.0; 3]);
    }
    b.radiance.iter_mut().for_each(|c| *c = c.map(|v| f32::from_bits(v.to_bits() + 1)));
    assert!(is_equal(&a, &b, None));
    b.radiance.iter_mut().for_each(|c| *c = c.map(|v| v * 1.0001));
    assert!(!is_equal(&a, &b, None));
}

#[test]
fn an_error_that_is_no_number_is_different() {
    let mut a = noisy(1, 0.0);
    a.std_err[3] = [f32::NAN; 3];
    assert!(!is_equal(&a, &noisy(2, 0.0), None));
}

#[test]
fn bakes_are_compared_page_by_page() -> anyhow::Result<()> {
    let dir = tempfile::tempdir()?;
    let a = write_bake(dir.path(), "a", &[noisy(1, 0.0), noisy(2, 0.0)], 1000);
    let b = write_bake(dir.path(), "b", &[noisy(3, 0.0), noisy(4, 5.0)], 1000);
    let out = dir.path().join("out");
    let report = compare(&a, &b, Some(&out))?;
    assert_eq!(report.verdict, Verdict::Different, "{report}");
    assert_eq!(report.equality.as_ref().and_then(|e| e.degrees_of_freedom), Some(999));
    assert!(report.pages[0].figures.rmse < report.pages[1].figures.rmse);
    assert_eq!(report.total.max_at.map(|at| at.page), Some(1));
    assert!(report.total.bias < 0.0);
    assert_eq!(report.pictures.len(), 6);
    assert!(report.pictures.iter().all(|p| out.join(p).is_file()));
    let json = serde_json::to_value(&report)?;
    assert_eq!(json["verdict"], "different");
    assert_eq!(json["pages"][1]["a"], "lightmap-1.exr");

    let c = write_bake(dir.path(), "c", &[noisy(5, 0.0), noisy(6, 0.0)], 1000);
    assert_eq!(compare(&a, &c, None)?.verdict, Verdict::Equal);
    Ok(())
}

#[test]
fn bakes_of_other_layouts_are_different() -> anyhow::Result<()> {
    let dir = tempfile::tempdir()?;
    let mut other = noisy(2, 0.0);
    other.coverage[0] = 0.0;
    let (a, b) = (write_bake(dir.path(), "a", &[noisy(1, 0.0)], 0), write_bake(dir.path(), "b", &[other], 0));
    let report = compare(&a, &b, None)?;
    assert_eq!(report.total.coverage_mismatches, 1);
    assert!(report.verdict == Verdict::Different && report.reasons[0].contains("layouts"), "{report}");
    // As single images only what both cover counts.
    let file = |p: &Path| p.join("lightmap-0.exr");
    assert_eq!(compare(&file(&a), &file(&b), None)?.verdict, Verdict::Equal);
    Ok(())
}

#[test]
fn a_foreign_half_file_is_compared_by_tolerance() -> anyhow::Result<()> {
    let dir = tempfile::tempdir()?;
    let mut page = noisy(1, 0.0);
    page.std_err.iter_mut().for_each(|e| *e = [0.0; 3]);
    let ours = write(dir.path(), "ours.exr", &page);
    let foreign = dir.path().join("foreign.exr");
    let write = |scale: f32| {
        let half = ::exr::prelude::f16::from_f32;
        ::exr::prelude::write_rgba_file(&foreign, SIDE, SIDE, |x, y| {
            let i = y * SIDE + x;
            let [r, g, b] = page.radiance[i].map(|v| half(v * scale));
            (r, g, b, half(if 0.0 < page.coverage[i] { 1.0 } else { 0.0 }))
        })
    };
    write(1.0)?;
    let report = compare(&ours, &foreign, None)?;
    assert_eq!(report.verdict, Verdict::Equal, "{report}");
    assert!(report.equality.is_none() && report.total.non_finite == 0);
    write(1.01)?;
    let report = compare(&ours, &foreign, None)?;
    assert_eq!(report.verdict, Verdict::Different, "{report}");
    assert!(report.total.relative_bias.is_some_and(|b| (b + 0.0099).abs() < 2e-4), "{report}");
    Ok(())
}

#[test]
fn figures_of_a_known_difference() -> anyhow::Result<()> {
    let dir = tempfile::tempdir()?;
    let image = |name: &str, pixels: &[[f32; 3]]| {
        let path = dir.path().join(name);
        exr::write_rgb(&path, 2, 1, pixels).map(|()| path)
    };
    let a = image("a.exr", &[[1.0, 1.0, 1.0], [2.0, 2.0, 5.0]])?;
    let b = image("b.exr", &[[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]])?;
    let t = compare(&a, &b, None)?.total;
    assert_eq!((t.texels, t.max_difference), (2, 3.0));
    assert_eq!(t.max_at, Some(Place { page: 0, x: 1, y: 0, channel: 2, a: 5.0, b: 2.0 }));
    assert!((t.mse - 1.5).abs() < 1e-12);
    assert!((t.mean_b - 1.5).abs() < 1e-12);
    assert!((t.bias - 0.0722 * 3.0 / 2.0).abs() < 1e-12);
    assert!((t.rel_mse - 9.0 / (4.0 + 0.0225) / 6.0).abs() < 1e-12);
    assert!(t.psnr.is_some_and(|p| (p - 10.0 * (4.0_f64 / 1.5).log10()).abs() < 1e-9));
    Ok(())
}

#[test]
fn what_cannot_be_compared_is_said() -> anyhow::Result<()> {
    let dir = tempfile::tempdir()?;
    let said = |a: &Path, b: &Path| compare(a, b, None).map(|_| ()).expect_err("an error").to_string();
    let page = write(dir.path(), "a.exr", &noisy(1, 0.0));
    let small = dir.path().join("small.exr");
    exr::write_rgb(&small, 2, 1, &[[1.0; 3]; 2])?;
    let message = said(&page, &small);
    assert!(message.contains("16 x 16") && message.contains("2 x 1"), "{message}");
    let one = write_bake(dir.path(), "one", &[noisy(1, 0.0)], 1);
    let two = write_bake(dir.path(), "two", &[noisy(1, 0.0), noisy(1, 0.0)], 1);
    assert!(said(&one, &two).contains("1 pages"));
    assert!(said(dir.path(), &one).contains("manifest.json"));
    assert!(said(&page, &dir.path().join("none.exr")).contains("cannot open"));
    Ok(())
}
