//! The tool as a whole on tiny scenes.

use glam::DVec3;
use suite::baked::Baked;
use suite::tool;

/// What most cases leave out, and one thread, because cases run side by side.
const QUICK: [&str; 8] = ["--probes", "off", "--texture", "none", "--seams", "off", "--threads", "1"];

pub(crate) fn bake(scene: &[u8], args: &[&str]) -> Baked {
    tool::baked(scene, &[&QUICK, args].concat())
}

/// [`bake`] in one medium, in the words of a configuration file.
pub(crate) fn bake_in(scene: &[u8], medium: &str, args: &[&str]) -> Baked {
    tool::baked_in(scene, medium, &[&QUICK, args].concat())
}

/// Irradiance and its standard error at (position, normal), by `bake points`.
pub(crate) fn points(scene: &[u8], at: &[[[f64; 3]; 2]], args: &[&str]) -> Vec<[DVec3; 2]> {
    let dir = tool::folder_with(scene);
    let got = tool::points(&dir.path().join("scene.glb"), at, &[&["--threads", "1"], args].concat());
    got.into_iter().map(|p| p.map(DVec3::from)).collect()
}

/// 0 if all values are finite and not negative and no sample was rejected, else infinite.
pub(crate) fn sanity(baked: &Baked) -> f64 {
    let values = baked.pages.iter().flat_map(|p| &p.channels);
    // Directions have signs.
    let unsigned = |name: &str| !name.starts_with("sh1.");
    let bad = |(name, values): (&String, &Vec<f32>)| {
        values.iter().any(|v| !v.is_finite() || (unsigned(name) && *v < 0.0))
    };
    let fault = values.into_iter().any(bad) || baked.manifest.counts.rejected_samples != 0;
    if fault { f64::INFINITY } else { 0.0 }
}

/// Covered texels: coverage and value.
pub(crate) fn covered(baked: &Baked) -> impl Iterator<Item = (f32, DVec3)> + '_ {
    baked.pages.iter().flat_map(|page| {
        let [r, g, b, a] = ["R", "G", "B", "A"].map(|c| &page.channels[c]);
        (0..a.len())
            .filter(|i| 0.0 < a[*i])
            .map(move |i| (a[i], glam::Vec3::new(r[i], g[i], b[i]).as_dvec3()))
    })
}

/// Worst deviation of a covered texel from a value, as a part of it; infinite if something else is wrong with the bake.
pub(crate) fn all_are(baked: &Baked, want: f64) -> f64 {
    let worst = covered(baked).map(|(_, v)| (v / want - 1.0).abs().max_element()).fold(0.0, f64::max);
    let none = if covered(baked).next().is_none() { f64::INFINITY } else { 0.0 };
    worst.max(none).max(sanity(baked))
}

/// Deviation of the mean of all covered texels from a value, as a part of it.
pub(crate) fn mean_is(baked: &Baked, want: f64) -> f64 {
    (mean(baked) / want - 1.0).abs().max(sanity(baked))
}

/// Mean of all channels of covered texels.
pub(crate) fn mean(baked: &Baked) -> f64 {
    let (mut sum, mut n) = (0.0, 0.0);
    for (_, v) in covered(baked) {
        sum += v.element_sum();
        n += 3.0;
    }
    sum / n
}

/// Relative, or absolute where nothing is wanted; infinite if it is no number.
pub(crate) fn off(got: f64, want: f64) -> f64 {
    let off = if want == 0.0 { got.abs() } else { (got / want - 1.0).abs() };
    if off.is_nan() { f64::INFINITY } else { off }
}
