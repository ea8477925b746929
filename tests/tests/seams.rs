//! Both sides of a seam look the same. Pairs of edges are found here anew, from `scene.glb` alone.

use glam::{DVec2, DVec3, Vec2};
use suite::{
    baked::{Baked, Page, Triangle},
    scenes::{
        closed::{Room, room},
        seams::{Smooth, corridor, surface},
    },
    tool,
};

/// Most degrees between the planes of two triangles that go on in each other: facets of the column make 7.5, those of
/// the sphere up to 11, corners 90.
const TURN: f64 = 15.0;

/// A point that two triangles share, at both its places on the page.
#[derive(Clone, Copy, Debug)]
struct Place {
    world: DVec3,
    uvs: [Vec2; 2],
}

/// Places along all seams, `per_texel` a texel.
fn places(baked: &Baked, per_texel: f64) -> Vec<Place> {
    let page = &baked.pages[0];
    let size = DVec2::new(page.width as f64, page.height as f64);
    let normal = |t: &Triangle| {
        let [a, b, c] = t.positions.map(|p| p.as_dvec3());
        (b - a).cross(c - a).normalize_or_zero()
    };
    let edges: Vec<(usize, [DVec3; 2], [DVec2; 2])> = baked
        .triangles
        .iter()
        .enumerate()
        .flat_map(|(i, t)| {
            [(0, 1), (1, 2), (2, 0)].map(|(a, b)| {
                let p = [a, b].map(|v: usize| t.positions[v].as_dvec3());
                (i, p, [a, b].map(|v: usize| t.uvs[v].as_dvec2()))
            })
        })
        .collect();
    let mut out = Vec::new();
    for (n, (i, [a0, a1], uv_a)) in edges.iter().enumerate() {
        for (j, [b0, b1], uv_b) in &edges[n + 1..] {
            let long = a0.distance(*a1);
            let near = 1e-5 * long;
            let along = (*a1 - *a0) / long;
            let s = [*b0, *b1].map(|p| (p - *a0).dot(along));
            let (from, to) = (s[0].min(s[1]).max(0.0), s[0].max(s[1]).min(long));
            let off = [*b0, *b1].map(|p| (p - *a0).reject_from(along).length());
            if i == j || to - from < 1e-3 * long || near < off[0] || near < off[1] {
                continue;
            }
            let (p, q) = (normal(&baked.triangles[*i]), normal(&baked.triangles[*j]));
            if p.dot(q) < TURN.to_radians().cos() {
                continue;
            }
            let at = |t: f64| {
                let on_a = uv_a[0].lerp(uv_a[1], t / long);
                [on_a, uv_b[0].lerp(uv_b[1], (t - s[0]) / (s[1] - s[0]))]
            };
            let apart = |[a, b]: [DVec2; 2]| ((a - b) * size).abs().max_element();
            if apart(at(from)) < 0.01 && apart(at(to)) < 0.01 {
                continue;
            }
            let texels = [0, 1].map(|side| ((at(from)[side] - at(to)[side]) * size).length());
            let count = (per_texel * texels[0].max(texels[1])).ceil().max(1.0);
            let mut k = 0.5;
            while k < count {
                let t = from + (to - from) * k / count;
                out.push(Place { world: *a0 + along * t, uvs: at(t).map(|uv| uv.as_vec2()) });
                k += 1.0;
            }
        }
    }
    out
}

/// Weights of what a filter reads along one axis: first texel of four and weights, for a point in texels.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Filter {
    Bilinear,
    /// The B-spline that engines use.
    Bicubic,
}

impl Filter {
    fn taps(self, point: f64) -> (f64, [f64; 4]) {
        let base = (point - 0.5).floor();
        let f = point - 0.5 - base;
        let g = 1.0 - f;
        let cubic = |x: f64| 2.0 / 3.0 - x * x + 0.5 * x * x * x;
        let w = match self {
            Self::Bilinear => [0.0, g, f, 0.0],
            Self::Bicubic => [g.powi(3) / 6.0, cubic(f), cubic(g), f.powi(3) / 6.0],
        };
        (base - 1.0, w)
    }

    /// Calls `f(x, y, weight)` for every texel that is read at texture coordinates; those beyond the edge are clamped.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the page")]
    fn read(self, page: &Page, uv: Vec2, mut f: impl FnMut(usize, usize, f64)) {
        let (x, wx) = self.taps(f64::from(uv.x) * page.width as f64);
        let (y, wy) = self.taps(f64::from(uv.y) * page.height as f64);
        for (j, wy) in (0..4).zip(wy) {
            for (i, wx) in (0..4).zip(wx) {
                let clamp = |v: f64, n: usize| v.clamp(0.0, n as f64 - 1.0) as usize;
                f(clamp(x + f64::from(i), page.width), clamp(y + f64::from(j), page.height), wx * wy);
            }
        }
    }

    fn light(self, page: &Page, uv: Vec2) -> DVec3 {
        let mut sum = DVec3::ZERO;
        self.read(page, uv, |x, y, w| sum += w * page.rgb("", x, y).as_dvec3());
        sum
    }
}

/// Mean standard error of the covered texels that a bilinear filter reads.
fn noise(page: &Page, uv: Vec2) -> DVec3 {
    let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
    Filter::Bilinear.read(page, uv, |x, y, w| {
        if page.get("A", x, y).is_some_and(|a| 0.0 < a) {
            sum += w * page.rgb("stderr.", x, y).as_dvec3();
            weight += w;
        }
    });
    sum / weight
}

/// Steps over all places in units of the standard error there: the greatest of any channel, with its place, and the
/// root of the mean square.
fn steps(baked: &Baked, places: &[Place], filter: Filter) -> (f64, DVec3, f64) {
    let page = &baked.pages[0];
    let (mut most, mut at, mut sum) = (0.0, DVec3::ZERO, 0.0);
    for place in places {
        let [a, b] = place.uvs.map(|uv| filter.light(page, uv));
        let noise = 0.5 * (noise(page, place.uvs[0]) + noise(page, place.uvs[1]));
        let step = ((a - b).abs() / noise).max_element();
        sum += step * step;
        if most < step {
            (most, at) = (step, place.world);
        }
    }
    (most, at, (sum / places.len() as f64).sqrt())
}

fn bake(scene: &[u8], density: &str, seams: &str) -> Baked {
    // Steps count in standard errors, which are those of before denoising.
    let gathered = ["--quality", "medium", "--denoise", "off"];
    tool::baked(scene, &[&gathered[..], &["--texels-per-metre", density, "--seams", seams]].concat())
}

#[track_caller]
#[expect(clippy::print_stdout, reason = "README states these figures")]
fn no_seam_shows(what: &str, scene: &[u8], density: &str, least_places: usize) {
    let (off, on) = (bake(scene, density, "off"), bake(scene, density, "on"));
    assert_eq!(on.pages.len(), 1, "{what}");
    assert!(off.manifest.seams.is_none());
    let seams = on.manifest.seams.expect("figures of seams");
    let places = places(&on, 5.0);
    assert!(least_places < places.len(), "{what}: {} places", places.len());
    for (filter, most) in [(Filter::Bilinear, 0.6), (Filter::Bicubic, 1.2)] {
        let (before, _, rms_before) = steps(&off, &places, filter);
        let (after, at, rms_after) = steps(&on, &places, filter);
        let text = format!(
            "{what}, {filter:?}: {} places, greatest step {before:.2} before, {after:.2} after at {at:.2}, root mean \
             square {rms_before:.3} and {rms_after:.3} standard errors; manifest {seams:?}",
            places.len()
        );
        println!("{text}");
        assert!(1.0 < before, "{text}");
        assert!(after < most, "{text}");
    }
}

#[test]
fn on_a_column() {
    no_seam_shows("column", &surface(Smooth::Column, 1.0), "12", 100);
}

#[test]
fn on_a_sphere() {
    no_seam_shows("sphere", &surface(Smooth::Sphere, 1.0), "12", 500);
}

#[test]
fn between_the_pieces_of_a_bent_corridor() {
    no_seam_shows("corridor", &corridor(1.0), "12", 500);
}

#[test]
fn figures_of_error_are_those_of_the_light_before() {
    let (off, on) = (bake(&corridor(1.0), "8", "off"), bake(&corridor(1.0), "8", "on"));
    assert_eq!(off.manifest.error, on.manifest.error);
    assert_eq!(off.manifest.pages[0].mean_luminance, on.manifest.pages[0].mean_luminance);
    for c in ["A", "stderr.R", "stderr.G", "stderr.B"] {
        assert_eq!(off.pages[0].channels[c], on.pages[0].channels[c], "{c}");
    }
    assert_ne!(off.pages[0].channels["R"], on.pages[0].channels["R"]);
    let seams = on.manifest.seams.expect("figures of seams");
    // The stated change is that of the files, and far below the noise of the mean.
    let mean = |b: &Baked| {
        let page = &b.pages[0];
        let light = ["R", "G", "B"].map(|c| &page.channels[c]);
        let covered = page.channels["A"].iter().enumerate().filter(|(_, a)| 0.0 < **a);
        let luminance = |i: usize| {
            let [r, g, b] = light.map(|l| f64::from(l[i]));
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        covered.map(|(i, _)| luminance(i)).sum::<f64>()
    };
    let change = mean(&on) / mean(&off) - 1.0;
    assert!((change - seams.mean_change).abs() < 1e-9, "{change} {seams:?}");
    let texels = on.manifest.pages[0].covered_texels as f64;
    let noise = on.manifest.error.relative.expect("light") / texels.sqrt();
    assert!(change.abs() < noise, "{change} with a noise of {noise}");
    assert!(seams.after.bilinear.rms_noise < 0.3 * seams.before.bilinear.rms_noise, "{seams:?}");
}

/// Values of all pages but coverage.
fn values(baked: &Baked) -> Vec<&Vec<f32>> {
    baked.pages.iter().flat_map(|p| p.channels.values()).collect()
}

#[test]
fn another_unit_of_length_changes_no_bit() {
    let bake = |length: f32| {
        let density = (8.0 / length).to_string();
        let args = ["--samples", "16", "--texels-per-metre", &density, "--split-direct"];
        [corridor(length), surface(Smooth::Sphere, length)].map(|scene| tool::baked(&scene, &args))
    };
    let one = bake(1.0);
    for length in [0.125, 32.0] {
        for (a, b) in one.iter().zip(&bake(length)) {
            assert_eq!(values(a), values(b), "lengths times {length}");
            let (a, b) = (a.manifest.seams.expect("figures"), b.manifest.seams.expect("figures"));
            assert!(10 < a.pairs && a.pairs == b.pairs && a.after == b.after);
        }
    }
}

#[test]
fn seams_between_pages_are_stitched_and_threads_change_no_byte() {
    let scene = room(Room::default());
    let bake = |threads: &str, seams: &str| {
        let args = ["--samples", "16", "--texels-per-metre", "12", "--max-size", "64", "--threads", threads];
        tool::baked(&scene, &[&args[..], &["--seams", seams]].concat())
    };
    let one = bake("1", "on");
    assert!(2 < one.pages.len());
    let seams = one.manifest.seams.expect("figures of seams");
    assert!(seams.after.bilinear.max_noise < seams.before.bilinear.max_noise, "{seams:?}");
    assert_eq!(one.files, bake("2", "on").files);
    let corridor = corridor(1.0);
    let bake = |threads: &str| {
        let args = ["--samples", "16", "--texels-per-metre", "12", "--max-size", "64", "--threads", threads];
        tool::baked(&corridor, &args)
    };
    let many = bake("1");
    assert!(2 < many.pages.len());
    let crossing = many.manifest.seams.expect("figures of seams");
    assert!(
        crossing.after.bilinear.max_noise < 1.0 && 1.0 < crossing.before.bilinear.max_noise,
        "{crossing:?}"
    );
    assert_eq!(many.files, bake("2").files);
}

#[test]
fn layers_still_add_up() {
    let scene = corridor(1.0);
    let args = ["--samples", "64", "--texels-per-metre", "8", "--split-direct"];
    let baked = tool::baked(&scene, &args);
    let page = &baked.pages[0];
    for c in ["R", "G", "B"] {
        let parts =
            page.channels[&format!("direct.{c}")].iter().zip(&page.channels[&format!("indirect.{c}")]);
        for (i, (whole, (direct, indirect))) in page.channels[c].iter().zip(parts).enumerate() {
            assert!(0.0 <= *whole && 0.0 <= *direct && 0.0 <= *indirect);
            // The iteration ends at a thousandth, and light is cut off at zero.
            let off = (whole - direct - indirect).abs();
            assert!(off <= 0.02 * whole, "{c} at {i}: {whole} of {direct} and {indirect}");
        }
    }
}
