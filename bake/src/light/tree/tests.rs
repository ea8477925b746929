use super::*;
use crate::sample::sequence::{key, mix64};
use build::BinaryTree;
use published::{Lightcuts, Rule, Until};

/// Numbers in [0, 1).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        (mix64(self.0) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn single(&mut self) -> f32 {
        (mix64(self.next().to_bits()) >> 40) as f32 / 16_777_216.0
    }

    fn place(&mut self, size: f32) -> Vec3A {
        size * (2.0 * Vec3A::new(self.single(), self.single(), self.single()) - 1.0)
    }

    fn direction(&mut self) -> Vec3A {
        loop {
            let p = self.place(1.0);
            if 0.01 < p.length() && p.length() < 1.0 {
                return p.normalize();
            }
        }
    }
}

/// Lights of every kind: clustered, of intensities over six orders of magnitude, a few of them dark.
fn lights(n: usize, seed: u64) -> Vec<TreeLight> {
    let mut u = Numbers(key(seed, 1, 2));
    let clusters: Vec<(Vec3A, Vec3A)> = (0..n / 20 + 1).map(|_| (u.place(5.0), u.direction())).collect();
    (0..n)
        .map(|k| {
            let (middle, axis) = clusters[k % clusters.len()];
            let at = middle + u.place(0.5);
            let intensity = if k % 17 == 5 { 0.0 } else { 10f32.powf(6.0 * u.single() - 3.0) };
            let towards = (axis + 0.7 * u.direction()).normalize();
            let (size, shine) = match k % 4 {
                0 => (Vec3A::ZERO, Shine::Everywhere),
                1 => (Vec3A::ZERO, Shine::Cone { axis: towards, angle: 0.1 + 1.2 * u.single() }),
                2 => (Vec3A::ZERO, Shine::Cosine { normal: towards }),
                _ => {
                    // A box around a patch.
                    let side = 0.3 * (Vec3A::ONE - towards * towards).max(Vec3A::ZERO).map(f32::sqrt);
                    (side, Shine::Cosine { normal: towards })
                }
            };
            TreeLight { min: at - size, max: at + size, intensity, shine }
        })
        .collect()
}

fn receivers(n: usize, seed: u64) -> Vec<Receiver> {
    let mut u = Numbers(key(seed, 3, 4));
    (0..n)
        .map(|k| match k % 5 {
            0 => Receiver::in_air(u.place(6.0)),
            _ => Receiver { position: u.place(6.0), normal: u.direction(), below: 0.0 },
        })
        .collect()
}

/// What a point of a light brings, shadows aside, in f64.
fn brings(l: &TreeLight, from: Vec3A, at: &Receiver) -> f64 {
    let d = from.as_dvec3() - at.position.as_dvec3();
    let wi = d.normalize();
    let shine = match l.shine {
        Shine::Everywhere => 1.0,
        Shine::Cone { axis, angle } => f64::from(u8::from(f64::from(angle).cos() < -wi.dot(axis.as_dvec3()))),
        Shine::Cosine { normal } => -wi.dot(normal.as_dvec3()),
    };
    let cos = if at.normal == Vec3A::ZERO { 1.0 } else { wi.dot(at.normal.as_dvec3()) };
    f64::from(l.intensity) * shine.max(0.0) * cos.max(0.0) / d.length_squared()
}

fn one_cut<'a>(tree: &'a LightTree, at: &Receiver, groups: u32) -> Cut<'a, FEW> {
    tree.cut(*at, groups, FallOff::Square, Effort::ONE)
}

#[test]
fn what_contributes_has_a_chance() {
    for (n, seed) in [(1, 1), (2, 2), (10, 3), (300, 4), (4000, 5)] {
        let lights = lights(n, seed);
        let tree = LightTree::new(&lights, &[n / 3, n - n / 3]);
        let published = Lightcuts::new(&lights);
        for at in receivers(40, seed) {
            let cut = one_cut(&tree, &at, 3);
            for (k, l) in lights.iter().enumerate() {
                let corners = [l.centre(), l.min, l.max];
                let most = corners.iter().map(|c| brings(l, *c, &at)).fold(0.0, f64::max);
                // Scattered on the way, everything that shines may arrive.
                let linear: Cut<'_, FEW> =
                    tree.cut(Receiver::in_air(at.position), 3, FallOff::Linear, Effort::ONE);
                let number = u32::try_from(k).expect("few");
                assert!(n > 300 || !l.shines() || 0.0 < linear.probability(number), "{n} {k} {l:?} {at:?}");
                if 1e-5 * f64::from(l.intensity) < most {
                    let k = u32::try_from(k).expect("few");
                    assert!(0.0 < cut.probability(k), "{n} {k} {l:?} {at:?}");
                    assert!(0.0 < published.probability(&at, k), "{n} {k} {l:?} {at:?}");
                }
            }
        }
    }
}

#[test]
fn returned_and_queried_probabilities_are_the_same() {
    let mut u = Numbers(9);
    for (n, seed) in [(1, 1), (2, 2), (40, 3), (3000, 4)] {
        let lights = lights(n, seed);
        let tree = LightTree::new(&lights, &[n / 2, n - n / 2]);
        let published = Lightcuts::new(&lights);
        for at in receivers(30, seed) {
            for groups in 1..4 {
                let cut = one_cut(&tree, &at, groups);
                for _ in 0..50 {
                    if let Some(p) = cut.one(u.next()) {
                        assert_eq!(p.chance, cut.probability(p.light), "{p:?}");
                        assert!(0.0 < p.chance && p.chance <= 1.0 + 1e-6);
                        let group = if (p.light as usize) < n / 2 { 1 } else { 2 };
                        assert_ne!(groups & group, 0, "only what is asked for");
                    }
                }
                let linear: Cut<'_, FEW> = tree.cut(at, groups, FallOff::Linear, Effort::ONE);
                if let Some(p) = linear.one(u.next()) {
                    assert_eq!(p.chance, linear.probability(p.light));
                }
            }
            for _ in 0..50 {
                if let Some(p) = published.one(&at, u.next()) {
                    assert_eq!(p.chance, published.probability(&at, p.light));
                }
            }
        }
    }
}

/// Lights of one estimate and how often each is chosen.
type Draw<'a> = &'a dyn Fn(&Receiver, &mut Numbers, &mut dyn FnMut(Pick));

/// Lights of much the same effect on the origin.
#[cfg(feature = "comparison")]
fn even_lights() -> Vec<TreeLight> {
    let mut u = Numbers(12);
    (0..200)
        .map(|_| {
            let at = u.direction() * (3.0 + u.single());
            TreeLight { min: at, max: at, intensity: 1.0 + u.single(), shine: Shine::Everywhere }
        })
        .collect()
}

/// For each light the sum of 1 / chance over samples is 1 on average. Gives the worst deviation in standard errors, of lights that are chosen often
/// enough to tell.
fn worst_deviation(n: usize, at: &Receiver, seed: u64, draw: Draw<'_>) -> f64 {
    const DRAWS: usize = 10_000;
    let mut u = Numbers(key(seed, 5, 6));
    let (mut sums, mut squares) = (vec![0.0f64; n], vec![0.0f64; n]);
    let mut once = vec![0.0f64; n];
    // The mean over every other light as well, which tells more than one.
    let mut odd = [0.0f64; 2];
    for _ in 0..DRAWS {
        let mut met = Vec::new();
        draw(at, &mut u, &mut |p| {
            once[p.light as usize] += 1.0 / f64::from(p.chance);
            met.push(p.light as usize);
        });
        let mut sum = 0.0;
        for &k in &met {
            let x = std::mem::take(&mut once[k]);
            sums[k] += x;
            squares[k] += x * x;
            sum += if k % 2 == 1 { x } else { 0.0 };
        }
        odd[0] += sum;
        odd[1] += sum * sum;
    }
    let draws = DRAWS as f64;
    let off = |sum: f64, square: f64, want: f64| {
        let mean = sum / draws;
        let variance = (square / draws - mean * mean).max(1e-12) / draws;
        (mean - want).abs() / (variance.sqrt() + 1e-5 * want)
    };
    let known = |k: &usize| 100.0 < sums[*k] * sums[*k] / squares[*k].max(1e-300);
    let each = (0..n).filter(known).map(|k| off(sums[k], squares[k], 1.0)).fold(0.0, f64::max);
    let all = (1..n).step_by(2).all(|k| known(&k));
    if all { each.max(off(odd[0], odd[1], (n / 2) as f64)) } else { each }
}

/// Over [`worst_deviation`] of some 10,000 lights in all: beyond it by chance once in 10,000 runs.
const LIMIT: f64 = 6.0;

#[test]
fn every_light_counts_once() {
    for (n, seed) in [(2, 1), (7, 2), (60, 3), (500, 4)] {
        let lights = lights(n, seed);
        let tree = LightTree::new(&lights, &[n]);
        let cuts = [Lightcuts::new(&lights), Lightcuts::over(BinaryTree::new(&lights), n)];
        for at in receivers(4, seed) {
            let one = |at: &Receiver, u: &mut Numbers, visit: &mut dyn FnMut(Pick)| {
                one_cut(&tree, at, 1).one(u.next()).into_iter().for_each(visit);
            };
            let worst = worst_deviation(n, &at, seed, &one);
            assert!(worst < LIMIT, "{n} lights, one: {worst}");
            for samples in [1, 2, 10, 100] {
                let few = |at: &Receiver, u: &mut Numbers, visit: &mut dyn FnMut(Pick)| {
                    one_cut(&tree, at, 1).many(samples, u.next(), visit);
                };
                let many = |at: &Receiver, u: &mut Numbers, visit: &mut dyn FnMut(Pick)| {
                    let cut: Cut<'_, MOST> = tree.cut(*at, 1, FallOff::Square, Effort::many(samples));
                    cut.many(samples, u.next(), visit);
                };
                for (name, draw) in [("few", &few as Draw<'_>), ("many", &many)] {
                    let worst = worst_deviation(n, &at, seed, draw);
                    assert!(worst < LIMIT, "{n} lights, {samples} samples, {name}: {worst}");
                }
                for cuts in &cuts {
                    let until = Until { samples, part: 0.001 };
                    let draw = |at: &Receiver, u: &mut Numbers, visit: &mut dyn FnMut(Pick)| {
                        published::cut(cuts, at, until, Rule::Right, &mut || u.next(), &mut |_| 0.0, visit);
                    };
                    let worst = worst_deviation(n, &at, seed, &draw);
                    assert!(worst < LIMIT, "{n} lights, {samples} samples, published: {worst}");
                }
            }
        }
    }
}

/// The test above finds what is wrong with each of the three.
#[cfg(feature = "comparison")]
#[test]
fn biased_ways_are_found_out() {
    let n = 60;
    let lights = lights(n, 3);
    let right = Lightcuts::new(&lights);
    let back = comparison::BackTracking(right.clone());
    let even = even_lights();
    let right_even = Lightcuts::new(&even);
    // Every other light is in shadow.
    #[expect(clippy::cast_possible_truncation, reason = "stored in f32")]
    let value = |k: u32, at: &Receiver| {
        let l = &even[k as usize];
        if k.is_multiple_of(2) { 0.0 } else { brings(l, l.centre(), at) as f32 }
    };
    let mut worst = [0.0f64; 3];
    for at in receivers(10, 3) {
        let dropped = |at: &Receiver, u: &mut Numbers, visit: &mut dyn FnMut(Pick)| {
            let until = Until { samples: 10, part: 0.0 };
            published::cut(&right, at, until, Rule::DropNull, &mut || u.next(), &mut |_| 0.0, visit);
        };
        let turned = |at: &Receiver, u: &mut Numbers, visit: &mut dyn FnMut(Pick)| {
            let until = Until { samples: 1, part: 0.0 };
            published::cut(&back, at, until, Rule::Right, &mut || u.next(), &mut |_| 0.0, visit);
        };
        worst[0] = worst[0].max(worst_deviation(n, &at, 1, &turned));
        worst[1] = worst[1].max(worst_deviation(n, &at, 1, &dropped));
    }
    let by = |rule: Rule| {
        let (right, value) = (&right_even, &value);
        move |at: &Receiver, u: &mut Numbers, visit: &mut dyn FnMut(Pick)| {
            let until = Until { samples: 1000, part: 0.0 };
            let until = if rule == Rule::Right { Until { samples: 40, ..until } } else { until };
            published::cut(right, at, until, rule, &mut || u.next(), &mut |k| value(k, at), visit);
        }
    };
    let at = Receiver::in_air(Vec3A::ZERO);
    worst[2] = worst_deviation(even.len(), &at, 1, &by(Rule::RunningEstimate));
    let fine = worst_deviation(even.len(), &at, 1, &by(Rule::Right));
    assert!(fine < LIMIT, "{fine}");
    assert!(
        worst.iter().all(|w| 3.0 * LIMIT < *w),
        "back-tracking, dropped nulls, running estimate: {worst:?}"
    );
}

/// A light beside two that face away, which together cannot be told from lit: what the wrong ways make of it in closed form.
#[cfg(feature = "comparison")]
#[test]
fn dead_branches_cost_samples() {
    let point = |at: Vec3A, intensity, shine| TreeLight { min: at, max: at, intensity, shine };
    let away = |x: f32| Shine::Cosine { normal: Vec3A::new(x, 1.0, 0.0).normalize() };
    let lights = [
        point(Vec3A::new(-3.0, 3.0, 0.0), 1.0, Shine::Everywhere),
        point(Vec3A::new(3.0, 3.0, 0.0), 1.0, away(-0.8)),
        point(Vec3A::new(3.0, 3.0, 2.0), 1.0, away(-0.8)),
    ];
    let at = Receiver { position: Vec3A::ZERO, normal: Vec3A::Y, below: 0.0 };
    let right = Lightcuts::new(&lights);
    let alive = f64::from(right.probability(&at, 0));
    assert!(0.05 < alive && alive < 0.95, "the dead branch is not seen from above: {alive}");
    assert_eq!(right.probability(&at, 1) + right.probability(&at, 2), 0.0);
    let mean = |samples, rule, back: bool| {
        let mut u = Numbers(4);
        let until = Until { samples, part: 0.0 };
        let mut sum = 0.0;
        for _ in 0..100_000 {
            let visit = &mut |p: Pick| sum += 1e-5 / f64::from(p.chance);
            if back {
                let back = comparison::BackTracking(right.clone());
                published::cut(&back, &at, until, rule, &mut || u.next(), &mut |_| 0.0, visit);
            } else {
                published::cut(&right, &at, until, rule, &mut || u.next(), &mut |_| 0.0, visit);
            }
        }
        sum
    };
    for (what, got, want) in [
        ("right, 1", mean(1, Rule::Right, false), 1.0),
        ("right, 2", mean(2, Rule::Right, false), 1.0),
        ("dropped", mean(2, Rule::DropNull, false), alive),
        ("turned back", mean(1, Rule::Right, true), 2.0 - alive),
    ] {
        assert!((got - want).abs() < 0.01, "{what}: {got} instead of {want}");
    }
}

/// Lights on a ring over a place: `sum of I x h / (r^2 + h^2)^(3/2)`.
#[test]
fn rings_have_their_closed_form() {
    let (radius, height, n) = (2.0f32, 1.5f32, 720u16);
    let ring: Vec<TreeLight> = (0..n)
        .map(|k| {
            let (sin, cos) = (f32::from(k) / f32::from(n) * 2.0 * PI).sin_cos();
            let at = Vec3A::new(radius * cos, height, radius * sin);
            let intensity = 1.0 + f32::from(k % 13);
            TreeLight { min: at, max: at, intensity, shine: Shine::Everywhere }
        })
        .collect();
    let all: f64 = ring.iter().map(|l| f64::from(l.intensity)).sum();
    let (r, h) = (f64::from(radius), f64::from(height));
    let want = all * h / (r * r + h * h).powf(1.5);
    let at = Receiver { position: Vec3A::ZERO, normal: Vec3A::Y, below: 0.0 };
    let tree = LightTree::new(&ring, &[ring.len()]);
    let published = Lightcuts::new(&ring);
    let mut u = Numbers(8);
    let light = |p: Pick| {
        let l = &ring[p.light as usize];
        brings(l, l.centre(), &at) / f64::from(p.chance)
    };
    for samples in [1, 2, 10, 100] {
        let draws = 4000;
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        for _ in 0..draws {
            let (mut a, mut b) = (0.0, 0.0);
            let cut: Cut<'_, MOST> = tree.cut(at, 1, FallOff::Square, Effort::many(samples));
            cut.many(samples, u.next(), |p| a += light(p));
            let until = Until { samples, part: 0.0 };
            let visit = &mut |p| b += light(p);
            published::cut(&published, &at, until, Rule::Right, &mut || u.next(), &mut |_| 0.0, visit);
            ours.push(a);
            theirs.push(b);
        }
        for (name, all) in [("ours", ours), ("published", theirs)] {
            let mean = all.iter().sum::<f64>() / f64::from(draws);
            let variance = all.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / f64::from(draws);
            let error = (variance / f64::from(draws)).sqrt() + 1e-5 * want;
            assert!((mean - want).abs() < 5.0 * error, "{name} {samples}: {mean} {want} {error}");
        }
    }
}

#[test]
fn a_few_lights_are_exact() {
    for n in [1, 2, 5, 8] {
        let lights = lights(n, 6);
        let tree = LightTree::new(&lights, &[n]);
        for at in receivers(10, 7) {
            let cut: Cut<'_, MOST> = tree.cut(at, 1, FallOff::Square, Effort::many(2 * n + 1));
            let mut met = vec![0; n];
            cut.many(2 * n + 1, 0.3, |p| {
                met[p.light as usize] += 1;
                assert!(1.0 - 1e-6 < p.chance, "{p:?}");
            });
            for (k, met) in met.iter().enumerate() {
                let number = u32::try_from(k).expect("few");
                assert_eq!(*met, usize::from(0.0 < cut.probability(number)), "{n} {k}");
            }
        }
    }
}

/// Lights and places at the edges: nothing panics, no number is not one, and what is left has its chance.
#[test]
fn hard_lights() {
    let point = |at: Vec3A, intensity| TreeLight { min: at, max: at, intensity, shine: Shine::Everywhere };
    let at = |position| Receiver { position, normal: Vec3A::Y, below: 0.0 };
    let check = |lights: &[TreeLight], places: &[Vec3A]| {
        let tree = LightTree::new(lights, &[lights.len()]);
        let published = Lightcuts::new(lights);
        for p in places {
            for at in [at(*p), Receiver::in_air(*p)] {
                let cut = one_cut(&tree, &at, 1);
                assert!(!cut.total().is_nan());
                for k in 0..64u16 {
                    let u = f64::from(k) / 64.0;
                    for pick in cut.one(u).into_iter().chain(published.one(&at, u)) {
                        assert!(0.0 < pick.chance && pick.chance <= 1.00001, "{pick:?}");
                        assert!(lights[pick.light as usize].shines());
                    }
                }
                cut.many(10, 0.5, |p| assert!(0.0 < p.chance && p.chance <= 1.0));
            }
        }
        tree
    };
    let up = Vec3A::Y;
    // None, one, and one that does not shine.
    assert!(check(&[], &[up]).is_empty());
    check(&[point(up, 1.0)], &[Vec3A::ZERO, up, 2.0 * up]);
    assert!(
        check(&[point(up, 0.0), point(up, f32::NAN), point(up, f32::INFINITY)], &[Vec3A::ZERO]).is_empty()
    );
    // Many in one place, seen from afar and from there.
    let tree = check(&vec![point(up, 2.0); 100_000], &[Vec3A::ZERO, up]);
    assert_eq!(tree.len(), 100_000);
    let cut = one_cut(&tree, &at(Vec3A::ZERO), 1);
    assert!((f64::from(cut.probability(77)) * 1e5 - 1.0).abs() < 1e-3);
    let cut = one_cut(&tree, &at(up), 1);
    assert!(
        (0..16u8).all(|k| cut.one(f64::from(k) / 16.0).is_none()),
        "on the lights there is no illuminance"
    );
    // The dim one is alone where the bright one does not reach.
    let far = [point(2.0 * up, 1e-6), point(-5.0 * up, 1e6)];
    let tree = check(&far, &[Vec3A::ZERO]);
    assert_eq!(one_cut(&tree, &at(Vec3A::ZERO), 1).probability(0), 1.0);
    let both = [point(2.0 * up, 1e-6), point(2.0 * up + Vec3A::X, 1e6)];
    let p = one_cut(&check(&both, &[Vec3A::ZERO]), &at(Vec3A::ZERO), 1).probability(0);
    assert!(0.5e-12 < p && p < 2e-12, "{p}");
    // Places ever farther apart make no chains that are too deep.
    let apart: Vec<TreeLight> =
        (0..120u16).map(|k| point(Vec3A::X * 2f32.powi(i32::from(k) - 60), 1.0)).collect();
    check(&apart, &[Vec3A::ZERO, Vec3A::X, Vec3A::X * 1e18]);
    // Places in every box.
    let mut u = Numbers(3);
    let wide: Vec<TreeLight> = (0..500)
        .map(|_| TreeLight { min: -Vec3A::ONE, max: Vec3A::ONE * (1.0 + u.single()), ..point(up, 1.0) })
        .collect();
    let tree = check(&wide, &[Vec3A::ZERO, Vec3A::ONE]);
    let cut = one_cut(&tree, &at(Vec3A::ZERO), 1);
    assert!((0..500).all(|k| 0.0 < cut.probability(k)));
    // Coordinates near the greatest numbers.
    check(
        &[point(Vec3A::splat(1e30), 1.0), point(Vec3A::splat(-1e30), 1.0)],
        &[Vec3A::ZERO, Vec3A::splat(1e30)],
    );
}

/// Every light is in one leaf, and nodes bound what they hold.
#[test]
fn trees_are_well_formed() {
    for n in [1, 2, 3, 100, 5000] {
        let lights = lights(n, 2);
        let shining = lights.iter().filter(|l| l.shines()).count();
        for tree in [BinaryTree::new(&lights), agglomerative::build(&lights)] {
            assert_eq!(tree.nodes.len(), 2 * shining - 1);
            assert_eq!(tree.leaves(n).iter().filter(|l| **l != u32::MAX).count(), shining);
            for (i, node) in tree.nodes.iter().enumerate().filter(|(_, n)| !n.is_leaf()) {
                let (a, b) = (&tree.nodes[i + 1], &tree.nodes[node.second as usize]);
                assert!(i + 1 < node.second as usize);
                assert_eq!(node.lights, a.lights + b.lights);
                for c in [a, b] {
                    assert!(node.min.cmple(c.min).all() && c.max.cmple(node.max).all());
                    let between = node.cone.axis.dot(c.cone.axis).clamp(-1.0, 1.0).acos();
                    assert!(PI <= node.cone.normals || between + c.cone.normals <= node.cone.normals + 2e-3);
                    assert!(c.cone.shine <= node.cone.shine);
                }
            }
        }
        let wide = LightTree::new(&lights, &[n]);
        assert_eq!(wide.len(), shining);
    }
}

#[test]
fn threads_make_no_difference() {
    let lights = lights(30_000, 5);
    let build = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let tree = LightTree::new(&lights, &[20_000, 10_000]);
            (format!("{tree:?}"), format!("{:?}", agglomerative::build(&lights)))
        })
    };
    assert!(build(1) == build(3));
}

/// Eight lanes at once give the bits of one at a time.
#[test]
fn lanes_make_no_difference() {
    let lights = lights(2000, 8);
    let tree = LightTree::new(&lights, &[2000]);
    let plain = tree.clone().without_lanes();
    for at in receivers(50, 9) {
        for k in 0..2000 {
            assert_eq!(one_cut(&tree, &at, 1).probability(k), one_cut(&plain, &at, 1).probability(k));
        }
    }
}

#[test]
fn the_nearest_light_is_found() {
    let lights = lights(3000, 4);
    let tree = LightTree::new(&lights, &[1000, 2000]);
    for at in receivers(50, 2) {
        let d = |l: &TreeLight| (l.centre() - at.position).length_squared();
        let want = lights[1000..].iter().filter(|l| l.shines()).map(d).fold(f32::INFINITY, f32::min);
        assert_eq!(tree.nearest(at.position, 2).map(|d| d.length_squared()), Some(want));
    }
    assert_eq!(LightTree::default().nearest(Vec3A::ZERO, 1), None);
}
