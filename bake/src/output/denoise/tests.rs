use super::filter::LAYERS;
use super::*;
use crate::sample::{Sequence, sequence::key};

/// Texels along the sides of the square that all tests filter.
const SIDE: u16 = 48;

/// A standard normal deviate, about: the sum of four uniform ones has a variance of a third.
fn noise(texel: u32, what: u64) -> f32 {
    let sum: f32 = Sequence::new(key(5, what, u64::from(texel)), 0).next4().iter().sum();
    (sum - 2.0) * 3f32.sqrt()
}

/// A square of texels with the given truth and standard error at column x and row y, and its places.
fn square(of: impl Fn(u16, u16) -> (f32, f32)) -> (Places<'static>, Part, Vec<f32>) {
    let at = |i: u32| {
        let side = u32::from(SIDE);
        #[expect(clippy::cast_possible_truncation, reason = "a row and a column")]
        let [x, y] = [(i % side) as u16, (i / side) as u16];
        [x, y]
    };
    let n = u32::from(SIDE) * u32::from(SIDE);
    let spots: Vec<(Vec3, Vec3)> = (0..n)
        .map(|i| {
            let [x, y] = at(i).map(f32::from);
            (Vec3::new(x, 0.0, y), Vec3::Y)
        })
        .collect();
    let places = Places::at(&spots, 8.0);
    let mut part = Part { layers: Vec::new(), variance: Vec::new(), halves: Vec::new(), worth: WORTH_PATHS };
    let mut truth = Vec::new();
    for &i in &places.texels {
        let [x, y] = at(i);
        let (value, error) = of(x, y);
        let seen = (value + error * noise(i, 0)).max(0.0);
        part.layers.push([Vec3::new(1.0, 0.75, 0.5) * seen, Vec3::splat(0.25 * seen)]);
        part.variance.push((Vec3::new(1.0, 0.75, 0.5) * error).map(|e| e * e));
        part.halves.push(crate::geom::world::luminance(Vec3::new(1.0, 0.75, 0.5)) * error * noise(i, 1));
        truth.push(value);
    }
    (places, part, truth)
}

fn copy(part: &Part) -> Part {
    Part {
        layers: part.layers.clone(),
        variance: part.variance.clone(),
        halves: part.halves.clone(),
        worth: part.worth,
    }
}

fn rms(values: impl Iterator<Item = f32> + Clone) -> f64 {
    let n = values.clone().count().max(1) as f64;
    (values.map(|v| f64::from(v).powi(2)).sum::<f64>() / n).sqrt()
}

/// Errors in red before and after.
fn errors(part: &Part, clean: &[Clean], truth: &[f32]) -> (f64, f64) {
    let before = part.layers.iter().zip(truth).map(|(l, t)| l[0].x - t);
    let after = clean.iter().zip(truth).map(|(l, t)| l.layers[0].x - t);
    (rms(before), rms(after))
}

fn sum(of: impl Iterator<Item = [Vec3; LAYERS]>) -> [f64; 2] {
    of.fold([0.0; 2], |s, l| [s[0] + f64::from(l[0].x), s[1] + f64::from(l[1].y)])
}

/// An even area and a slope lose most of their noise, and the estimate of what is left is of its size: 0.73 of it in a draft,
/// and 0.36 of it in the final filter, where noise has more of a say in the weights.
#[test]
fn noise_goes_and_the_estimate_says_how_much() {
    for slope in [0.0, 0.01] {
        for (method, factor) in [(DRAFT, 0.4), (FINAL, 0.4)] {
            let (places, part, truth) = square(|x, _| (2.0 + slope * f32::from(x), 0.1));
            let clean = copy(&part).denoise(&places, method);
            let (before, after) = errors(&part, &clean, &truth);
            assert!(after < factor * before, "{method:?}, slope {slope}: {before} to {after}");
            // Of luminance, in which the red error is 0.2126 + 0.75 * 0.7152 + 0.5 * 0.0722.
            let stated = rms(clean.iter().map(|c| c.error.sqrt())) / 0.785_1;
            assert!((0.3..1.6).contains(&(stated / after)), "{method:?}: {stated} for {after}");
        }
    }
}

/// Two areas 20 standard errors apart are smoothed each by itself.
#[test]
fn an_edge_stays_where_it_is() {
    for method in [DRAFT, FINAL] {
        let edge = |x: u16, _| (if x < SIDE / 2 { 1.0 } else { 3.0 }, 0.1);
        let (places, part, truth) = square(edge);
        let clean = copy(&part).denoise(&places, method);
        let (before, after) = errors(&part, &clean, &truth);
        assert!(after < 0.5 * before, "{method:?}: {before} to {after}");
        for (c, t) in clean.iter().zip(&truth) {
            assert!((c.layers[0].x - t).abs() < 0.3, "{method:?}: {} for {t}", c.layers[0].x);
        }
    }
}

/// Without noise nothing changes by a bit, whatever the values are, beside noise as well.
#[test]
fn what_is_known_exactly_stays_to_the_bit() {
    for method in [DRAFT, FINAL] {
        let checker = |x: u16, y: u16| {
            let value = 1.0 + f32::from((x / 3 + y / 5) % 7);
            (value, if x < 12 { 0.3 } else { 0.0 })
        };
        let (places, part, _) = square(checker);
        let clean = copy(&part).denoise(&places, method);
        for (i, (old, new)) in part.layers.iter().zip(&clean).enumerate() {
            // Within reach of noise, what agrees with it may be averaged with it.
            if 24 < places.texels[i] % u32::from(SIDE) {
                assert_eq!(*old, new.layers, "{method:?}");
            }
        }
    }
}

/// A texel that caught what others missed gives it to them: it is not lost.
#[test]
fn sums_stay_and_nothing_is_negative() {
    for method in [DRAFT, FINAL] {
        let firefly = |x: u16, y: u16| match (x, y) {
            (20, 20) => (80.0, 80.0),
            (x, _) if x < 10 => (0.02, 0.05),
            _ => (1.0, 0.1),
        };
        let (places, mut part, _) = square(firefly);
        let bright = places.texels.iter().position(|i| *i == 20 * u32::from(SIDE) + 20).expect("it is there");
        part.layers[bright] = [Vec3::splat(80.0), Vec3::splat(20.0)];
        part.halves[bright] = 80.0;
        let clean = copy(&part).denoise(&places, method);
        let (before, after) = (sum(part.layers.iter().copied()), sum(clean.iter().map(|c| c.layers)));
        for (b, a) in before.iter().zip(after) {
            assert!((a / b - 1.0).abs() < 1e-5, "{method:?}: {b} became {a}");
        }
        assert!(clean.iter().all(|c| c.layers.iter().all(|l| 0.0 <= l.min_element() && l.is_finite())));
        assert!(clean[bright].layers[0].x < 40.0, "{method:?}: {}", clean[bright].layers[0]);
    }
}

/// The second layer is filtered as the first one is.
#[test]
fn layers_share_weights() {
    let (places, part, _) = square(|x, y| (1.0 + f32::from(x * y) / 500.0, 0.2));
    for clean in part.denoise(&places, FINAL) {
        assert!((clean.layers[1].x - 0.25 * clean.layers[0].x).abs() < 1e-5, "{clean:?}");
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let bake = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let (places, part, _) = square(|x, y| (1.0 + f32::from(x / 5 + y / 9), 0.3));
            part.denoise(&places, FINAL)
                .iter()
                .map(|c| (c.layers[0].to_array().map(f32::to_bits), c.error.to_bits()))
                .collect::<Vec<_>>()
        })
    };
    assert!(bake(1) == bake(3));
}

#[test]
fn nothing_and_one_texel_are_fine() {
    let empty = Part { layers: vec![], variance: vec![], halves: vec![], worth: 1.0 };
    assert!(empty.denoise(&Places::at(&[], 8.0), FINAL).is_empty());
    let one =
        Part { layers: vec![[Vec3::ONE; LAYERS]], variance: vec![Vec3::ONE], halves: vec![1.0], worth: 1.0 };
    let clean = one.denoise(&Places::at(&[(Vec3::ZERO, Vec3::Y)], 8.0), FINAL);
    assert_eq!(clean[0].layers, [Vec3::ONE; LAYERS]);
}
