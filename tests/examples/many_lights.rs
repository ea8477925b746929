//! Compares ways to choose among many lights on the scene of table 1 in \[SLC20\]:
//! `cargo run --release -p suite --example many_lights`.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use suite::divided::{Divided, Method};

fn main() {
    let size = std::env::args().nth(1).and_then(|a| a.parse().ok()).unwrap_or(96);
    let scene = Divided::new(size);
    println!("means {:?}", scene.means());
    if std::env::var("SCAN").is_ok() {
        let mut r = Vec::new();
        for n in [10, 100] {
            for m in [Method::Intensity, Method::Splitting, Method::Published, Method::Ours] {
                r.push(scene.runs(m, n, 3).0[0].all * 100.0);
            }
        }
        println!(
            "{:?} ratio {:.2} {:.2} | {:.2} {:.2} ours {:.2} {:.2}",
            r,
            r[0] / r[2],
            r[1] / r[2],
            r[4] / r[6],
            r[5] / r[6],
            r[3] / r[2],
            r[7] / r[6]
        );
        return;
    }
    for method in Method::ALL {
        for samples in [1, 10, 100] {
            let ([mean, dev], seconds) = scene.runs(method, samples, 10);
            println!(
                "{:28} {samples:4}: {:7.2} ({:.2}) above {:7.2} ({:.2}) below {:7.2} ({:.2}) %  {:.3} us",
                method.name(),
                100.0 * mean.all,
                100.0 * dev.all,
                100.0 * mean.above,
                100.0 * dev.above,
                100.0 * mean.below,
                100.0 * dev.below,
                1e6 * seconds / f64::from(size).powi(2)
            );
        }
    }
}
