//! Compares ways to choose among many lights: the table of \[SLC20\] on a scene of its kind, and what an estimate costs from 10 to 1,000,000 lights.
//! `cargo run --release -p suite --example many_lights -- data/many-lights.png`.
//!
//! The second scene is a floor of 60 x 60 m with 100 posts on it and point lights scattered over 5 m of air above, of intensities over two orders of magnitude,
//! with one sum of intensities. Times are those of one thread, rays included.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use bake::geom::{Ray, ray::offset_distance};
use bake::light::Direct;
use bake::light::tree::published::{Lightcuts, Rule, Until, cut};
use bake::light::tree::{Cut, Effort, FallOff, LightTree, MOST, Pick, Receiver, Shine, TreeLight};
use bake::plan::{MediaMode, Tracing};
use bake::sample::sequence::{key, mix64};
use bake::scene::config::Config;
use bake::scene::document::Document;
use bake::scene::gltf::{LightUnits, LoadOptions, load};
use glam::Vec3A;
use image::{ImageFormat, RgbImage};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;
use std::error::Error;
use std::time::Instant;
use suite::divided::{Divided, Method};
use suite::gltf::{Glb, Material, Node};
use suite::shape::{NO_BOTTOM, Shape};

const SIZE: (u32, u32) = (1500, 640);

/// Places on the floor.
const RECEIVERS: u64 = 96;

/// Samples of an estimate where they are fixed.
const SAMPLES: usize = 10;

/// Error that estimates go to where that is fixed, root mean square of the relative one.
const ERROR: f64 = 0.1;

/// Most lights that are all asked.
const BEARABLE: usize = 1_000_000;

/// Name, and microseconds by number of lights: at fixed samples and at fixed error.
type Curve = (&'static str, [Vec<(f64, f64)>; 2]);

fn main() -> Result<(), Box<dyn Error>> {
    let file = std::env::args().nth(1).ok_or("name a PNG")?;
    table();
    let scene = Posts::new()?;
    let mut curves: [Curve; 3] =
        ["every light", "published", "ours"].map(|name| (name, [Vec::new(), Vec::new()]));
    for n in [10, 30, 100, 300, 1000, 3000, 10_000, 30_000, 100_000, 300_000, 1_000_000] {
        scene.measure(n, &mut curves);
    }
    register_font("sans-serif", FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT)
        .map_err(|_| "the font is damaged")?;
    let mut rgb = vec![0; (SIZE.0 * SIZE.1 * 3) as usize];
    {
        let area = BitMapBackend::with_buffer(&mut rgb, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let titles = [format!("{SAMPLES} samples"), format!("error of {:.0} %", 100.0 * ERROR)];
        for ((k, title), place) in titles.iter().enumerate().zip(area.split_evenly((1, 2))) {
            draw(&place, title, &curves, k)?;
        }
        area.present()?;
    }
    RgbImage::from_raw(SIZE.0, SIZE.1, rgb).ok_or("no picture")?.save_with_format(file, ImageFormat::Png)?;
    Ok(())
}

/// Table 1 of the paper, and ours in the time that the published method takes.
fn table() {
    let scene = Divided::new(64);
    let [above, below] = scene.means();
    println!(
        "mean above {above:.4}, below {below:.4}; errors in % of the mean, (deviation over 10 pictures)"
    );
    let mut seconds = [0.0; 2];
    for method in Method::ALL {
        for (k, samples) in [1, 10, 100].into_iter().enumerate() {
            let ([mean, dev], time) = scene.runs(method, samples, 10);
            let p = |x: f64| 100.0 * x;
            println!(
                "{:28} {samples:4}: {:7.2} ({:5.2})  above {:7.2} ({:5.2})  below {:6.2} ({:5.2})  {:7.2} us a pixel",
                method.name(),
                p(mean.all),
                p(dev.all),
                p(mean.above),
                p(dev.above),
                p(mean.below),
                p(dev.below),
                1e6 * time / 4096.0
            );
            if method == Method::Published && 0 < k {
                seconds[k - 1] = time;
            }
        }
    }
    for (samples, wanted) in [10, 100].into_iter().zip(seconds) {
        // As many samples as take no longer.
        let more = (samples..40 * samples).step_by(samples / 10);
        let fits = |n: usize| (0..3).all(|seed| scene.draw(Method::Ours, n, seed).1 <= wanted);
        let n = more.take_while(|&n| fits(n)).last().unwrap_or(samples);
        let ([mean, _], time) = scene.runs(Method::Ours, n, 10);
        println!(
            "ours with {n} samples in {:.0} % of the time of {samples} published ones: {:.2} %",
            100.0 * time / wanted,
            100.0 * mean.all
        );
    }
}

/// A floor with posts.
struct Posts {
    tracing: Tracing,
    places: Vec<Receiver>,
}

struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        (mix64(self.0) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn single(&mut self) -> f32 {
        (mix64(self.next().to_bits()) >> 40) as f32 / 16_777_216.0
    }
}

impl Posts {
    fn new() -> Result<Self, Box<dyn Error>> {
        let mut glb = Glb::new();
        let grey = glb.material(&Material::matte("grey", [0.5; 3]));
        let mut shape = Shape::default();
        shape.cuboid([-30.0, -0.1, -30.0], [30.0, 0.0, 30.0], NO_BOTTOM);
        for k in 0..100u8 {
            let [x, z] = [f32::from(k % 10) * 6.0 - 27.0, f32::from(k / 10) * 6.0 - 27.0];
            shape.cuboid([x - 0.4, 0.0, z - 0.4], [x + 0.4, 4.0, z + 0.4], NO_BOTTOM);
        }
        let mesh = glb.mesh("posts", &[(&shape, grey)]);
        glb.node(Node::new("posts").mesh(mesh));
        let document = Document::from_bytes("posts.glb", &glb.finish(), None)?;
        let options = LoadOptions { light_units: LightUnits::Gltf, ..LoadOptions::default() };
        let (scene, _) = load(&document, &Config::default(), &options);
        let tracing = Tracing::new(&scene, MediaMode::Off, Direct::Auto)?;
        let mut u = Numbers(1);
        let places = (0..RECEIVERS)
            .map(|_| {
                let position = Vec3A::new(56.0 * u.single() - 28.0, 0.0, 56.0 * u.single() - 28.0);
                Receiver { position, normal: Vec3A::Y, below: 0.0 }
            })
            .collect();
        Ok(Self { tracing, places })
    }

    fn brings(&self, at: &Receiver, l: &TreeLight) -> f64 {
        let d = l.min - at.position;
        let distance = d.length();
        let wi = d / distance;
        let offset = offset_distance(30.0);
        let ray =
            Ray { origin: at.position + at.normal * offset, direction: wi, t_max: distance - 4.0 * offset };
        if wi.y <= 0.0 || self.tracing.bvh.occluded(&ray, |_| true) {
            return 0.0;
        }
        f64::from(l.intensity * wi.y / (distance * distance))
    }

    fn measure(&self, n: usize, curves: &mut [Curve; 3]) {
        let mut u = Numbers(2);
        let lights: Vec<TreeLight> = (0..n)
            .map(|_| {
                let at =
                    Vec3A::new(60.0 * u.single() - 30.0, 0.5 + 4.5 * u.single(), 60.0 * u.single() - 30.0);
                let intensity = 100f32.powf(u.single()) / n as f32;
                TreeLight { min: at, max: at, intensity, shine: Shine::Everywhere }
            })
            .collect();
        let start = Instant::now();
        let tree = LightTree::new(&lights, &[n]);
        let built = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let published = Lightcuts::new(&lights);
        let their = start.elapsed().as_secs_f64();
        println!("{n} lights: tree in {built:.3} s, published in {their:.3} s");
        let light = |at: &Receiver, p: Pick| self.brings(at, &lights[p.light as usize]) / f64::from(p.chance);
        let ours = |samples: usize, seed: u64| {
            let mut u = Numbers(key(seed, 1, 1));
            let each = self.places.iter().map(|at| {
                let mut sum = 0.0;
                let cut: Cut<'_, MOST> = tree.cut(*at, 1, FallOff::Square, Effort::many(samples));
                cut.many(samples, u.next(), |p| sum += light(at, p));
                sum
            });
            each.collect::<Vec<f64>>()
        };
        let theirs = |samples: usize, seed: u64| {
            let mut u = Numbers(key(seed, 1, 1));
            let until = Until { samples, part: 0.0 };
            let each = self.places.iter().map(|at| {
                let mut sum = 0.0;
                let visit = &mut |p| sum += light(at, p);
                cut(&published, at, until, Rule::Right, &mut || u.next(), &mut |_| 0.0, visit);
                sum
            });
            each.collect::<Vec<f64>>()
        };
        let start = Instant::now();
        let truth: Vec<f64> =
            self.places.iter().map(|at| lights.iter().map(|l| self.brings(at, l)).sum()).collect();
        let all = 1e6 * start.elapsed().as_secs_f64() / RECEIVERS as f64;
        if n <= BEARABLE {
            for curve in &mut curves[0].1 {
                curve.push((n as f64, all));
            }
        }
        let mean = truth.iter().sum::<f64>() / truth.len() as f64;
        for (k, draw) in [(1, &theirs as &dyn Fn(usize, u64) -> Vec<f64>), (2, &ours)] {
            // Repeated until the clock can tell.
            let time = |samples: usize| {
                let start = Instant::now();
                let mut runs = 0;
                while start.elapsed().as_secs_f64() < 0.05 {
                    draw(samples, runs);
                    runs += 1;
                }
                1e6 * start.elapsed().as_secs_f64() / runs as f64 / RECEIVERS as f64
            };
            let error = |samples: usize| {
                let squares =
                    |seed| draw(samples, seed).iter().zip(&truth).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
                ((0..16).map(squares).sum::<f64>() / 16.0 / RECEIVERS as f64).sqrt() / mean
            };
            curves[k].1[0].push((n as f64, time(SAMPLES)));
            let enough = (0..40).map(|k| 2f64.powf(0.25 * f64::from(k)).round()).find(|&s| {
                #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "few")]
                let samples = s as usize;
                error(samples) <= ERROR
            });
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "few")]
            if let Some(samples) = enough.map(|s| s as usize) {
                let us = time(samples);
                println!(
                    "  {}: {SAMPLES} samples {:.2} us, {:.1} %; {samples} to {:.0} % in {us:.2} us",
                    curves[k].0,
                    time(SAMPLES),
                    100.0 * error(SAMPLES),
                    100.0 * ERROR
                );
                curves[k].1[1].push((n as f64, us));
            }
        }
        println!("  every light: {all:.1} us");
    }
}

fn draw(
    place: &DrawingArea<BitMapBackend<'_>, Shift>,
    title: &str,
    curves: &[Curve],
    k: usize,
) -> Result<(), Box<dyn Error>> {
    let mut chart = ChartBuilder::on(place)
        .margin(16)
        .margin_right(44)
        .caption(title, ("sans-serif", 26))
        .x_label_area_size(48)
        .y_label_area_size(78)
        .build_cartesian_2d((10f64..1e6).log_scale(), (0.5f64..1e6).log_scale())?;
    chart
        .configure_mesh()
        .x_desc("lights")
        .y_desc("microseconds an estimate")
        .label_style(("sans-serif", 18))
        .light_line_style(WHITE)
        .draw()?;
    for ((name, points), colour) in
        curves.iter().zip([RGBColor(90, 90, 90), RGBColor(200, 90, 20), RGBColor(20, 90, 190)])
    {
        chart
            .draw_series(LineSeries::new(points[k].clone(), colour.stroke_width(3)).point_size(4))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], colour.stroke_width(3)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE)
        .border_style(RGBColor(200, 200, 200))
        .label_font(("sans-serif", 20))
        .draw()?;
    Ok(())
}
