//! What textures of a lightmap page take: time, size and error beside its EXR.
//!
//! `cargo run --release -p suite --example textures -- FILE.exr [RADIUS]` measures a page of a bake, for instance of
//! `bake run --texels-per-metre 54 --max-size 2048 --denoise off`. With a radius the page is smoothed first, as a denoiser leaves it: three means over squares within the
//! covered texels. Times are the least of three runs, wall and processor; all include reading back and comparing, but that of the plain EXR.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use bake::output::ktx::{Contents, Format, Packing, Shape, Texture};
use bake::output::page::Page;
use bake::output::{exr, texture};
use bake::plan::settings::TextureFormat;
use std::error::Error;
use std::fs::{self, File};
use std::io::{Cursor, Read};
use std::path::Path;
use std::time::Instant;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let file = args.next().ok_or("name the EXR of a page")?;
    let mut page = read(Path::new(&file))?;
    if let Some(radius) = args.next() {
        smooth(&mut page, radius.parse()?);
    }
    println!("{} x {} texels, {} threads", page.width, page.height, std::thread::available_parallelism()?);
    let dir = tempfile::tempdir()?;
    let path = |name: &str| dir.path().join(name);
    let (plain, ()) = least(|| plain_exr(&path("plain.exr"), &page))?;
    report("EXR, not read back", plain, plain, fs::metadata(path("plain.exr"))?.len());
    let rgb = || Ok(exr::write_rgb(&path("rgb.exr"), page.width, page.height, &page.radiance)?);
    report(
        "EXR of red, green and blue alone, not read back",
        least(rgb)?.0,
        plain,
        fs::metadata(path("rgb.exr"))?.len(),
    );
    let (whole, ()) = least(|| exr::write_page(&path("a.exr"), &page).map_err(Into::into))?;
    report("EXR", whole, plain, fs::metadata(path("a.exr"))?.len());
    for format in [TextureFormat::Bc6h, TextureFormat::Rgba16f] {
        let to = path(format.name());
        let (time, figures) = least(|| Ok(texture::write_page(&to, &page, 2, format)?))?;
        report(format.name(), time, plain, figures.bytes);
        report("  and EXR", [0, 1].map(|i| time[i] + whole[i]), plain, 0);
        println!(
            "  error {:.5} of the mean, {:.5} in logarithms, {} clamped",
            figures.relative_rmse.unwrap_or_default(),
            figures.log_rmse.unwrap_or_default(),
            figures.overflows
        );
        levels(&to, &page, format)?;
    }
    Ok(())
}

/// Packs the same blocks at other levels.
fn levels(file: &Path, page: &Page, format: TextureFormat) -> Result<(), Box<dyn Error>> {
    let mut data = Vec::new();
    Contents::open(File::open(file)?)?.read_to_end(&mut data)?;
    let format = match format {
        TextureFormat::Bc6h => Format::Bc6hUfloat,
        TextureFormat::Rgba16f => Format::Rgba16f,
    };
    let shape = Shape::Flat([u32::try_from(page.width)?, u32::try_from(page.height)?]);
    for level in [1, 3, 6, 9, 13, 19] {
        let texture = Texture { format, shape, packing: Packing::Zstd(level), texts: &[] };
        let mut out = Cursor::new(Vec::new());
        let begun = Instant::now();
        texture.write(&mut out, |to| to.write_all(&data))?;
        let part = out.get_ref().len() as f64 / data.len() as f64;
        println!(
            "  level {level}: {part:.3} of {} bytes, {:.2} s",
            data.len(),
            begun.elapsed().as_secs_f64()
        );
    }
    Ok(())
}

fn report(what: &str, [wall, cpu]: [f64; 2], plain: [f64; 2], bytes: u64) {
    let (wall_ratio, cpu_ratio) = (wall / plain[0], cpu / plain[1]);
    println!("{what}: {wall:.2} s ({wall_ratio:.2}), processor {cpu:.2} s ({cpu_ratio:.2}), {bytes} bytes");
}

/// Wall and processor seconds of the fastest of three runs, each.
fn least<T>(mut work: impl FnMut() -> Result<T, Box<dyn Error>>) -> Result<([f64; 2], T), Box<dyn Error>> {
    let mut best = [f64::INFINITY; 2];
    let mut last = None;
    for _ in 0..3 {
        let (begun, cpu) = (Instant::now(), processor()?);
        last = Some(work()?);
        best = [best[0].min(begun.elapsed().as_secs_f64()), best[1].min(processor()? - cpu)];
    }
    Ok((best, last.ok_or("there were runs")?))
}

/// Processor seconds of this process so far, in steps of a hundredth.
fn processor() -> Result<f64, Box<dyn Error>> {
    let text = fs::read_to_string("/proc/self/stat")?;
    let fields: Vec<&str> = text.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    Ok((fields[11].parse::<f64>()? + fields[12].parse::<f64>()?) / 100.0)
}

fn read(path: &Path) -> Result<Page, Box<dyn Error>> {
    let file = exr::read(path)?;
    let mut page = Page::new(file.width, file.height);
    let rgb = |prefix: &str| -> Option<Vec<[f32; 3]>> {
        let [r, g, b] = file.rgb(prefix)?;
        Some((0..r.values.len()).map(|i| [r.values[i], g.values[i], b.values[i]]).collect())
    };
    page.radiance = rgb("").ok_or("no colours")?;
    page.std_err = rgb("stderr").ok_or("no standard errors")?;
    page.coverage.clone_from(&file.channel("A").ok_or("no coverage")?.values);
    Ok(page)
}

/// The channels of a page as zip EXR by the library's own means.
fn plain_exr(path: &Path, page: &Page) -> Result<(), Box<dyn Error>> {
    use ::exr::prelude::*;
    let channel = |name: &str, values: Vec<f32>| AnyChannel::new(name, FlatSamples::F32(values));
    let mut list = vec![channel("A", page.coverage.clone())];
    for (prefix, layer) in [("", &page.radiance), ("stderr.", &page.std_err)] {
        for (c, name) in ["R", "G", "B"].into_iter().enumerate() {
            list.push(channel(&format!("{prefix}{name}"), layer.iter().map(|v| v[c]).collect()));
        }
    }
    let encoding = Encoding { compression: Compression::ZIP16, ..Encoding::default() };
    let channels = AnyChannels::sort(list.into_iter().collect());
    let layer = Layer::new((page.width, page.height), LayerAttributes::default(), encoding, channels);
    Ok(Image::from_layer(layer).write().to_file(path)?)
}

/// Three means over squares of covered texels.
fn smooth(page: &mut Page, radius: usize) {
    for _ in 0..3 {
        let from = page.radiance.clone();
        let near = |i: usize, n: usize| i.saturating_sub(radius)..(i + radius + 1).min(n);
        for i in (0..from.len()).filter(|i| 0.0 < page.coverage[*i]) {
            let (mut sum, mut n) = ([0.0f32; 3], 0.0f32);
            for y in near(i / page.width, page.height) {
                for x in near(i % page.width, page.width) {
                    let j = y * page.width + x;
                    if 0.0 < page.coverage[j] {
                        sum.iter_mut().zip(from[j]).for_each(|(s, v)| *s += v);
                        n += 1.0;
                    }
                }
            }
            page.radiance[i] = sum.map(|s| s / n);
        }
    }
}
