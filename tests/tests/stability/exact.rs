//! What is the same to the bit in other units, at other brightness and with other threads; and what is the same but for rounding or noise.

use crate::Group;
use crate::whole::{bake, bake_in, sanity};
use std::sync::LazyLock;
use suite::baked::{Baked, NO_LIGHT};
use suite::scenes::closed::{Room, room};

/// Every rung of the ladder of media.
const RUNGS: [&str; 5] = ["off", "attenuate", "table", "bounded", "reference"];

/// A room with every kind of light in coloured haze, in a unit of length of `2^k` metres.
fn haze(r: Room, k: i32, rung: &str) -> Baked {
    let s = 2f64.powi(-k);
    let medium = format!(
        "{{ sigma_s = [{}, {}, {}], sigma_a = {}, g = 0.5 }}",
        0.25 * s,
        0.125 * s,
        0.5 * s,
        0.0625 * s
    );
    let density = (1.5 * s).to_string();
    let args = ["--samples", "4", "--texels-per-metre", &density, "--media", rung, "--grid-nodes", "200"];
    bake_in(&room(r), &medium, &args)
}

static BASES: [LazyLock<Baked>; 5] = [
    LazyLock::new(|| haze(Room::default(), 0, RUNGS[0])),
    LazyLock::new(|| haze(Room::default(), 0, RUNGS[1])),
    LazyLock::new(|| haze(Room::default(), 0, RUNGS[2])),
    LazyLock::new(|| haze(Room::default(), 0, RUNGS[3])),
    LazyLock::new(|| haze(Room::default(), 0, RUNGS[4])),
];

/// How many values of light are not those of `one` times a factor to the bit; infinite if they cannot be compared.
fn unlike(one: &Baked, other: &Baked, factor: f32) -> f64 {
    if one.pages.len() != other.pages.len()
        || one.pages.iter().all(|p| p.channels["R"].iter().all(|v| *v == 0.0))
    {
        return f64::INFINITY;
    }
    let mut n = 0;
    for (a, b) in one.pages.iter().zip(&other.pages) {
        if (a.width, a.height) != (b.width, b.height) || !a.channels.keys().eq(b.channels.keys()) {
            return f64::INFINITY;
        }
        for (name, values) in a.channels.iter().filter(|(name, _)| !NO_LIGHT.contains(&name.as_str())) {
            let pairs = values.iter().zip(&b.channels[name]);
            n += pairs.filter(|(a, b)| (*a * factor).to_bits() != b.to_bits()).count();
        }
    }
    n as f64 + sanity(other)
}

pub(crate) fn group() -> Group {
    let mut group = Group::new("exact");
    for (r, rung) in RUNGS.into_iter().enumerate() {
        for k in [-10, 3, 7] {
            group.add(format!("lengths times 2^{k}, {rung}, values that differ"), 0.0, move || {
                let s = 2f32.powi(k);
                let other = haze(Room { length: s, candela: s * s, ..Room::default() }, k, rung);
                unlike(&BASES[r], &other, 1.0)
            });
        }
        for k in [1, -20] {
            group.add(format!("light times 2^{k}, {rung}, values that differ"), 0.0, move || {
                let f = 2f32.powi(k);
                let other = haze(Room { radiance: f, candela: f, lux: f, ..Room::default() }, 0, rung);
                unlike(&BASES[r], &other, f)
            });
        }
    }
    for (r, rung) in THREADED.into_iter().enumerate() {
        for threads in ["2", "3", "8"] {
            group.add(format!("{threads} threads against 1, {rung}, files that differ"), 0.0, move || {
                let many = bake_threads(rung, threads);
                let one = &ON_ONE_THREAD[r];
                let same = |name: &String| one.files.get(name) == many.files.get(name);
                let names = one.files.keys().chain(many.files.keys());
                names.filter(|name| !same(name)).count() as f64
            });
        }
    }
    group.add("lengths times 2^-20 with rays of all kinds, values that differ", 0.0, || {
        let of = |k: i32| {
            let s = 2f32.powi(k);
            let density = (1.5 / s).to_string();
            let scene = room(Room { length: s, candela: s * s, ..Room::default() });
            bake(
                &scene,
                &["--samples", "4", "--texels-per-metre", &density, "--directional", "--split-direct"],
            )
        };
        unlike(&of(0), &of(-20), 1.0)
    });
    group
}

/// Rungs that take different ways through the solver.
const THREADED: [&str; 4] = ["off", "table", "bounded", "reference"];

static ON_ONE_THREAD: [LazyLock<Baked>; 4] = [
    LazyLock::new(|| bake_threads(THREADED[0], "1")),
    LazyLock::new(|| bake_threads(THREADED[1], "1")),
    LazyLock::new(|| bake_threads(THREADED[2], "1")),
    LazyLock::new(|| bake_threads(THREADED[3], "1")),
];

fn bake_threads(rung: &str, threads: &str) -> Baked {
    let medium = "{ sigma_s = [0.25, 0.125, 0.5], g = 0.5 }";
    let args = ["--samples", "1", "--texels-per-metre", "1", "--media", rung, "--grid-nodes", "64"];
    let more = ["--denoise", "draft", "--probes", "l2", "--probe-count", "64", "--threads", threads];
    // Media as `table` sees them have no single direction.
    let directional: &[&str] = if rung == "table" { &[] } else { &["--directional"] };
    let all = [&args, &more[..], directional].concat();
    suite::tool::baked_in(&room(Room::default()), medium, &all)
}

/// Greatest difference of texels over their greatest value.
fn apart(a: &Baked, b: &Baked) -> f64 {
    let (a, b) = (&a.pages[0].channels, &b.pages[0].channels);
    let mut worst = 0.0f64;
    for c in ["R", "G", "B"] {
        let most = a[c].iter().copied().fold(0.0f32, f32::max);
        worst = a[c]
            .iter()
            .zip(&b[c])
            .map(|(x, y)| f64::from((x - y).abs() / most))
            .fold(worst, |w, d| if d.is_nan() || w < d { d } else { w });
    }
    worst
}

/// Means of nodes: greatest difference in joint standard errors.
fn errors_apart(a: &Baked, b: &Baked) -> f64 {
    let (a, b) = (a.node_means(), b.node_means());
    let mut worst = 0.0f64;
    for (node, [mean, error]) in &a {
        let [other, its] = b[node];
        for c in 0..3 {
            // Partly covered texels weigh otherwise in a mirrored map.
            let slack = 5e-3 * mean[c];
            let off = ((mean[c] - other[c]).abs() - slack).max(0.0) / error[c].hypot(its[c]);
            worst = if off.is_nan() { f64::INFINITY } else { worst.max(off) };
        }
    }
    worst
}

pub(crate) fn rounding() -> Group {
    let mut group = Group::new("rounding");
    let absorbing = |rung: &str, samples: &str| {
        let args =
            ["--samples", samples, "--texels-per-metre", "1.5", "--media", rung, "--irradiance-cache", "off"];
        bake_in(&room(Room::default()), "{ sigma_a = [0.1, 0.3, 1] }", &args)
    };
    for rung in ["table", "bounded"] {
        group.add(format!("{rung} without scattering is attenuate"), 1e-5, move || {
            apart(&absorbing("attenuate", "4"), &absorbing(rung, "4"))
        });
    }
    group.add("reference without scattering is attenuate, standard errors", 5.0, move || {
        errors_apart(&absorbing("attenuate", "64"), &absorbing("reference", "64"))
    });
    for rung in RUNGS {
        group.add(format!("a mirrored room, {rung}, standard errors"), 5.0, move || {
            let of = |mirrored| {
                let args = ["--samples", "48", "--texels-per-metre", "2", "--media", rung];
                bake_in(&room(Room { mirrored, ..Room::default() }), "{ sigma_s = 0.1, g = 0.3 }", &args)
            };
            errors_apart(&of(false), &of(true))
        });
    }
    let thin = |rung: &str, samples: &str| {
        let args = ["--samples", samples, "--texels-per-metre", "1.5", "--media", rung, "--grid-nodes", "64"];
        let medium = "{ sigma_s = 1e-12, box = { min = [-9, -9, -9], max = [9, 9, 9] } }";
        bake_in(&room(Room::default()), medium, &args)
    };
    group.add("a medium of 1e-12 per metre is none, attenuate", 1e-5, move || {
        apart(&thin("off", "4"), &thin("attenuate", "4"))
    });
    // These ask for light in other ways, with other random numbers.
    for rung in ["table", "bounded", "reference"] {
        group.add(format!("a medium of 1e-12 per metre is none, {rung}, standard errors"), 5.0, move || {
            errors_apart(&thin("off", "32"), &thin(rung, "32"))
        });
    }
    for rung in ["attenuate", "table", "bounded", "reference"] {
        group.add(format!("a medium of 1e6 per metre is finite, {rung}"), 0.0, move || {
            let args = ["--samples", "2", "--texels-per-metre", "1", "--media", rung, "--grid-nodes", "64"];
            sanity(&bake_in(&room(Room::default()), "{ sigma_s = 1e6, sigma_a = 1, g = 0.5 }", &args))
        });
    }
    for rung in ["table", "bounded", "reference"] {
        for g in ["0.99999994", "-0.99999994", "0.99", "-0.99"] {
            group.add(format!("g {g} is finite, {rung}"), 0.0, move || {
                let args =
                    ["--samples", "4", "--texels-per-metre", "1", "--media", rung, "--grid-nodes", "64"];
                sanity(&bake_in(&room(Room::default()), &format!("{{ sigma_s = 0.3, g = {g} }}"), &args))
            });
        }
    }
    group.add("a medium's face in the plane of a floor, and far below it", 1e-5, || {
        let of = |low: &str| {
            let medium =
                format!("{{ sigma_a = 0.5, box = {{ min = [-2, {low}, -1.5], max = [2, 3, 1.5] }} }}");
            let args = ["--samples", "4", "--texels-per-metre", "1.5", "--media", "attenuate"];
            bake_in(&room(Room::default()), &medium, &args)
        };
        apart(&of("-7"), &of("0"))
    });
    group
}
