//! Pictures without a window.

use std::{path::Path, time::Instant};

use anyhow::{Context, Result, bail, ensure};
use glam::Vec2;
use image::{Rgb, RgbImage};
use wgpu::TextureFormat;

use crate::{
    files::bake::Bake,
    gpu::{
        device::{Gpu, Shape},
        renderer::{self, Picture, Renderer, Shot, Side, Stage},
        uploaded::{Uploaded, coded},
    },
    view::{balls::Ball, camera::Pose, look::Look},
};

/// Draws pictures off screen.
#[derive(Debug)]
pub(crate) struct Studio {
    renderer: Renderer,
    size: [u32; 2],
    out: wgpu::Texture,
    read: wgpu::Buffer,
    /// Pictures whose mean is taken, each shifted by a part of a pixel.
    frames: u32,
}

/// What a picture shows.
#[derive(Debug)]
pub(crate) struct Shown<'a> {
    /// Left and right of the wiper, or one alone.
    pub(crate) bakes: Vec<(&'a Bake, &'a Uploaded)>,
    /// Where the right one begins, 0 to 1.
    pub(crate) wipe: f32,
    pub(crate) look: &'a Look,
    pub(crate) balls: &'a [Ball],
    pub(crate) seconds: f32,
}

/// Pixels as they came from the card: linear, after the tone curve or before it.
#[derive(Debug)]
pub(crate) struct Floats {
    size: [u32; 2],
    pixels: Vec<[f32; 3]>,
}

/// Bytes a pixel has.
const PIXEL: u32 = 16;

impl Studio {
    /// For pictures of a size, each the mean of `frames`; `wide` asks for 32-bit floats before tone mapping.
    ///
    /// # Errors
    ///
    /// If the pictures are larger than the adapter takes.
    pub(crate) fn new(gpu: Gpu, size: [u32; 2], frames: u32, wide: bool) -> Result<Self> {
        let bytes = u64::from(row(size)) * u64::from(size[1]);
        let limits = gpu.device.limits();
        ensure!(
            size[0].max(size[1]) <= limits.max_texture_dimension_2d && bytes <= limits.max_buffer_size,
            "{} x {} pixels are more than this adapter takes",
            size[0],
            size[1]
        );
        let renderer = Renderer::new(gpu, 1, TextureFormat::Rgba32Float, wide);
        let out = renderer.gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("out"),
            size: Shape::Flat(size).extent(),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: TextureFormat::Rgba32Float,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let read = renderer.gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read"),
            size: bytes,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        Ok(Self { renderer, size, out, read, frames })
    }

    /// What draws.
    pub(crate) fn renderer(&self) -> &Renderer {
        &self.renderer
    }

    /// Draws a picture; before the tone curve if `radiance`, nits then.
    ///
    /// # Errors
    ///
    /// If the device is lost.
    pub(crate) fn picture(&mut self, shown: &Shown<'_>, pose: &Pose, radiance: bool) -> Result<Floats> {
        let [w, h] = self.size;
        let mut sum = vec![[0.0f64; 3]; w as usize * h as usize];
        for frame in 0..self.frames {
            let shot = self.shot(frame, radiance);
            self.frame(shown, pose, shot, true);
            let bytes = self.renderer.gpu.read(&self.read)?;
            for (y, line) in bytes.chunks_exact(row(self.size) as usize).enumerate() {
                let pixels: &[[f32; 4]] = bytemuck::cast_slice(&line[..(w * PIXEL) as usize]);
                for (sum, p) in sum[y * w as usize..].iter_mut().zip(pixels) {
                    for c in 0..3 {
                        sum[c] += f64::from(p[c]);
                    }
                }
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
        let mean = |v: [f64; 3]| v.map(|v| (v / f64::from(self.frames)) as f32);
        Ok(Floats { size: self.size, pixels: sum.into_iter().map(mean).collect() })
    }

    fn shot(&self, frame: u32, radiance: bool) -> Shot {
        // The R_d sequences of Roberts: even over pixels, and over froxels, for any number of frames.
        let at = |step: f32| (0.5 + step * frame as f32).fract() - 0.5;
        let shift = |x: f32, y: f32| if self.frames == 1 { Vec2::ZERO } else { Vec2::new(at(x), at(y)) };
        Shot {
            size: self.size,
            froxels: renderer::froxels(self.size),
            shift: shift(0.754_877_7, 0.569_840_3),
            depth: (0.5 + frame as f32 * 0.819_172_5).fract(),
            froxel_shift: shift(0.671_043_6, 0.549_700_5),
            encode: false,
            radiance,
        }
    }

    /// One frame, which is copied to where it can be read if it is to be kept.
    fn frame(&mut self, shown: &Shown<'_>, pose: &Pose, shot: Shot, keep: bool) {
        let picture = Picture { sides: sides(shown, self.size[0]), pose, shot, seconds: shown.seconds };
        let mut encoder = self.renderer.gpu.device.create_command_encoder(&Default::default());
        self.renderer.draw(&mut encoder, &picture, &self.out.create_view(&Default::default()));
        if keep {
            let layout = wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(row(self.size)),
                rows_per_image: None,
            };
            encoder.copy_texture_to_buffer(
                self.out.as_image_copy(),
                wgpu::TexelCopyBufferInfo { buffer: &self.read, layout },
                Shape::Flat(self.size).extent(),
            );
        }
        self.renderer.gpu.queue.submit([encoder.finish()]);
    }

    /// What frames take, drawn one after the other as a game does, and what their stages take each by itself: a table.
    ///
    /// # Errors
    ///
    /// If the device is lost.
    pub(crate) fn timings(&mut self, shown: &Shown<'_>, pose: &Pose, frames: u32) -> Result<String> {
        let shot = self.shot(0, false);
        // Shaders and volumes are made by the first frame.
        self.frame(shown, pose, shot, false);
        self.renderer.gpu.wait()?;
        let (mut stages, mut walls) = (Vec::new(), Vec::new());
        for _ in 0..frames {
            let start = Instant::now();
            self.frame(shown, pose, shot, false);
            self.renderer.gpu.wait()?;
            walls.push(start.elapsed().as_secs_f64());
            let picture = Picture { sides: sides(shown, self.size[0]), pose, shot, seconds: shown.seconds };
            stages.push(self.renderer.timed(&picture, &self.out.create_view(&Default::default()))?);
        }
        let median = |mut v: Vec<f64>| {
            v.sort_by(f64::total_cmp);
            v[v.len() / 2]
        };
        let wall = median(walls);
        let ([w, h], [x, y, z]) = (self.size, shot.froxels);
        let name = &self.renderer.gpu.name;
        let mut text =
            format!("{name}, {w} x {h} pixels, {x} x {y} x {z} froxels, median of {frames} frames\n");
        for (i, stage) in Stage::ALL.iter().enumerate() {
            let ms = 1e3 * median(stages.iter().map(|s| s[i]).collect());
            text += &format!("  {:<16}{ms:9.2} ms {:5.1} %\n", stage.name(), 1e-1 * ms / wall);
        }
        text += &format!("  {:<16}{:9.2} ms, {:.2} frames/s", "frame", 1e3 * wall, 1.0 / wall);
        Ok(text)
    }
}

/// Bytes from row to row: a multiple of what copies want.
fn row(size: [u32; 2]) -> u32 {
    (size[0] * PIXEL).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT)
}

/// Which bake fills which columns.
pub(crate) fn sides<'a>(shown: &Shown<'a>, width: u32) -> Vec<Side<'a>> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within the picture")]
    let middle = (shown.wipe.clamp(0.0, 1.0) * width as f32).round() as u32;
    let side = |(bake, on_card): (&'a Bake, &'a Uploaded), columns| Side {
        on_card,
        bake,
        look: shown.look,
        balls: shown.balls,
        columns,
    };
    match shown.bakes[..] {
        [left, right, ..] => vec![side(left, 0..middle), side(right, middle..width)],
        [one] => vec![side(one, 0..width)],
        [] => Vec::new(),
    }
}

impl Floats {
    /// Writes a PNG of a picture after the tone curve, or an EXR in nits of one before it.
    ///
    /// # Errors
    ///
    /// If the file cannot be written.
    pub(crate) fn save(&self, path: &Path) -> Result<()> {
        let failed = || format!("{}: cannot write this file; is its folder there?", path.display());
        let at = |x: usize, y: usize| self.pixels[y * self.size[0] as usize + x];
        // Beside its place first, so that an older picture is replaced as a whole or not at all.
        let mut name = path.as_os_str().to_owned();
        name.push(".part");
        let part = Path::new(&name);
        let written = match kind(path)? {
            Kind::Exr => {
                let (w, h) = (self.size[0] as usize, self.size[1] as usize);
                exr::prelude::write_rgb_file(part, w, h, |x, y| {
                    let [r, g, b] = at(x, y);
                    (r, g, b)
                })
                .with_context(failed)
            }
            Kind::Png => self.image().save_with_format(part, image::ImageFormat::Png).with_context(failed),
        };
        let done = written.and_then(|()| std::fs::rename(part, path).with_context(failed));
        if done.is_err() {
            // It may not be there at all.
            let _ = std::fs::remove_file(part);
        }
        done
    }

    /// Encoded as sRGB.
    pub(crate) fn image(&self) -> RgbImage {
        RgbImage::from_fn(self.size[0], self.size[1], |x, y| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to 0 to 255"
            )]
            let code = |v: f32| (coded(v.clamp(0.0, 1.0), true) * 255.0).round() as u8;
            Rgb(self.pixels[y as usize * self.size[0] as usize + x as usize].map(code))
        })
    }
}

/// Files of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// After the tone curve.
    Png,
    /// Radiance in nits.
    Exr,
}

/// Which kind a name asks for.
///
/// # Errors
///
/// If it is neither.
pub(crate) fn kind(path: &Path) -> Result<Kind> {
    let end = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    match end.as_str() {
        "png" => Ok(Kind::Png),
        "exr" => Ok(Kind::Exr),
        _ => bail!("{}: a picture is a .png, or an .exr with the radiance in nits", path.display()),
    }
}
