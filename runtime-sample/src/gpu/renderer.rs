//! The passes of a frame: light in froxels, sums of it to the eye, surfaces, tone mapping.

use std::{ops::Range, time::Instant};

use anyhow::Result;
use bytemuck::{bytes_of, cast_slice};
use glam::Vec3;
use wgpu::{BindingResource, BufferUsages, TextureFormat, TextureUsages};

use super::{
    device::{Gpu, Shape},
    pipelines::{DEPTH, FROXELS, Fixed, HALF, Layouts, Pass, Pipelines, Surface},
    uniforms::ViewUniform,
    uploaded::{Sphere, SphereMesh, Uploaded, at, whole},
};
use crate::{
    files::{bake::Bake, scene::Part},
    view::{
        balls::Ball,
        camera::Pose,
        look::{Look, Mode},
    },
};

pub(crate) use super::uniforms::Shot;

/// What draws.
#[derive(Debug)]
pub(crate) struct Renderer {
    pub(crate) gpu: Gpu,
    layouts: Layouts,
    fixed: Fixed,
    pipelines: Pipelines,
    /// Format of pictures before tone mapping, and samples a pixel.
    picture: TextureFormat,
    samples: u32,
    targets: Option<Targets>,
    /// Of the left and the right side of a wiper.
    fog: [Option<Fog>; 2],
    ball: SphereMesh,
    probe: SphereMesh,
}

/// Stages of a frame. What each leaves stays until it runs again, so that they can be run one by one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stage {
    /// What scatters towards the eye in each froxel.
    LightInFog,
    /// Its sums from the eye on.
    FogToTheEye,
    /// All that is solid, and what light passes.
    Surfaces,
    /// The tone curve.
    ToneMapping,
}

impl Stage {
    /// In their order.
    pub(crate) const ALL: [Self; 4] =
        [Self::LightInFog, Self::FogToTheEye, Self::Surfaces, Self::ToneMapping];

    /// For people.
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::LightInFog => "light in fog",
            Self::FogToTheEye => "fog to the eye",
            Self::Surfaces => "surfaces",
            Self::ToneMapping => "tone mapping",
        }
    }
}

/// A bake, or a part of the picture that shows one.
#[derive(Debug)]
pub(crate) struct Side<'a> {
    pub(crate) on_card: &'a Uploaded,
    pub(crate) bake: &'a Bake,
    pub(crate) look: &'a Look,
    pub(crate) balls: &'a [Ball],
    /// Which columns of the picture.
    pub(crate) columns: Range<u32>,
}

/// A picture that is to be drawn.
#[derive(Debug)]
pub(crate) struct Picture<'a> {
    /// One, or both sides of a wiper.
    pub(crate) sides: Vec<Side<'a>>,
    pub(crate) pose: &'a Pose,
    pub(crate) shot: Shot,
    /// How long spheres have moved.
    pub(crate) seconds: f32,
}

/// Pictures on their way.
#[derive(Debug)]
struct Targets {
    size: [u32; 2],
    color: wgpu::TextureView,
    depth: wgpu::TextureView,
    /// For tone mapping.
    group: wgpu::BindGroup,
}

/// Volumes of froxels.
#[derive(Debug)]
struct Fog {
    froxels: [u32; 3],
    scatter_out: wgpu::BindGroup,
    scatter_in: wgpu::BindGroup,
    sums_out: wgpu::BindGroup,
    sums_in: wgpu::BindGroup,
}

/// Pixels a froxel is wide and high.
const FROXEL: u32 = 8;

/// Slices of froxels.
const SLICES: u32 = 64;

/// Froxels of a picture.
pub(crate) fn froxels(size: [u32; 2]) -> [u32; 3] {
    let [x, y] = size.map(|n| n.div_ceil(FROXEL).max(1));
    [x, y, SLICES]
}

impl Renderer {
    /// Draws pictures of one or four samples a pixel that are shown in a format; `wide` asks for 32-bit floats before that.
    pub(crate) fn new(gpu: Gpu, samples: u32, shown: TextureFormat, wide: bool) -> Self {
        let layouts = Layouts::new(&gpu);
        let fixed = Fixed::new(&gpu, &layouts);
        let picture = if wide && gpu.wide_pictures { TextureFormat::Rgba32Float } else { HALF };
        let pipelines = Pipelines::new(&gpu, &layouts, picture, samples, shown);
        let (ball, probe) = (SphereMesh::new(&gpu, 24), SphereMesh::new(&gpu, 6));
        Self {
            gpu,
            layouts,
            fixed,
            pipelines,
            picture,
            samples,
            targets: None,
            fog: [None, None],
            ball,
            probe,
        }
    }

    /// Uploads a bake.
    ///
    /// # Errors
    ///
    /// Where it is beyond what the adapter takes.
    pub(crate) fn upload(&self, bake: &Bake) -> Result<Uploaded> {
        Uploaded::new(&self.gpu, &self.layouts, &self.fixed, bake)
    }

    /// Tells the card about a picture and makes what it lacks.
    fn prepare(&mut self, sides: &[Side<'_>], pose: &Pose, shot: &Shot) {
        for (i, side) in sides.iter().enumerate().take(2) {
            let uniform = ViewUniform::new(side.on_card, side.bake, pose, side.look, shot);
            self.gpu.queue.write_buffer(&side.on_card.view, 0, bytes_of(&uniform));
            let wanted = side.bake.scene.parts.iter().flat_map(|p| {
                let passes = side.bake.scene.materials[p.material].passes();
                let how = if passes { &[Pass::Dim, Pass::Add][..] } else { &[Pass::Opaque] };
                how.iter().map(|how| side.surface(p, *how))
            });
            self.pipelines.prepare(&self.gpu, wanted);
            // Something has to be bound where there is no fog.
            let froxels = if side.foggy() { shot.froxels } else { [1; 3] };
            if self.fog[i].as_ref().is_none_or(|f| f.froxels != froxels) {
                self.fog[i] = Some(Fog::new(&self.gpu, &self.layouts, froxels));
            }
        }
        if self.targets.as_ref().is_none_or(|t| t.size != shot.size) {
            self.targets = Some(self.targets_of(shot.size));
        }
    }

    /// Puts the passes of a picture into `encoder`.
    pub(crate) fn draw(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        picture: &Picture<'_>,
        out: &wgpu::TextureView,
    ) {
        self.prepare(&picture.sides, picture.pose, &picture.shot);
        for stage in Stage::ALL {
            self.stage(stage, encoder, picture, out);
        }
    }

    /// Draws a picture stage by stage, each by itself; seconds that they took.
    ///
    /// # Errors
    ///
    /// If the device is lost.
    pub(crate) fn timed(&mut self, picture: &Picture<'_>, out: &wgpu::TextureView) -> Result<[f64; 4]> {
        self.prepare(&picture.sides, picture.pose, &picture.shot);
        let mut seconds = [0.0; 4];
        for (stage, seconds) in Stage::ALL.into_iter().zip(&mut seconds) {
            // On processors time stamps of compute passes tell when they were handed over, so that clocks are asked.
            let start = Instant::now();
            let mut encoder = self.gpu.device.create_command_encoder(&Default::default());
            self.stage(stage, &mut encoder, picture, out);
            self.gpu.queue.submit([encoder.finish()]);
            self.gpu.wait()?;
            *seconds = start.elapsed().as_secs_f64();
        }
        Ok(seconds)
    }

    fn stage(
        &self,
        stage: Stage,
        encoder: &mut wgpu::CommandEncoder,
        picture: &Picture<'_>,
        out: &wgpu::TextureView,
    ) {
        let fog = |encoder: &mut wgpu::CommandEncoder| {
            for (side, fog) in picture.sides.iter().zip(&self.fog).filter(|(s, _)| s.foggy()) {
                if let Some(fog) = fog {
                    self.fog(stage, encoder, side.on_card, fog);
                }
            }
        };
        match stage {
            Stage::LightInFog | Stage::FogToTheEye => fog(encoder),
            Stage::Surfaces => self.surfaces(encoder, picture),
            Stage::ToneMapping => self.tone_map(encoder, picture, out),
        }
    }

    fn surfaces(&self, encoder: &mut wgpu::CommandEncoder, picture: &Picture<'_>) {
        let Some(targets) = &self.targets else { return };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("surfaces"),
            color_attachments: &[Some(attachment(&targets.color))],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &targets.depth,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Discard,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        for (i, side) in picture.sides.iter().enumerate().take(2) {
            if cut(&mut pass, side, picture.shot.size) {
                self.side(&mut pass, side, i, picture);
            }
        }
    }

    fn tone_map(&self, encoder: &mut wgpu::CommandEncoder, picture: &Picture<'_>, out: &wgpu::TextureView) {
        let Some(targets) = &self.targets else { return };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("tone"),
            color_attachments: &[Some(attachment(out))],
            ..Default::default()
        });
        pass.set_pipeline(&self.pipelines.tone);
        pass.set_bind_group(1, &targets.group, &[]);
        for side in picture.sides.iter().take(2) {
            if cut(&mut pass, side, picture.shot.size) {
                pass.set_bind_group(0, &side.on_card.view_group, &[]);
                pass.draw(0..3, 0..1);
            }
        }
    }

    fn fog(&self, stage: Stage, encoder: &mut wgpu::CommandEncoder, on_card: &Uploaded, fog: &Fog) {
        let [x, y, z] = fog.froxels;
        let mut pass = encoder.begin_compute_pass(&Default::default());
        let light = stage == Stage::LightInFog;
        pass.set_pipeline(if light { &self.fixed.scatter } else { &self.fixed.accumulate });
        pass.set_bind_group(0, &on_card.view_group, &[]);
        if light {
            pass.set_bind_group(1, &fog.scatter_out, &[]);
        } else {
            pass.set_bind_group(2, &fog.scatter_in, &[]);
            pass.set_bind_group(3, &fog.sums_out, &[]);
        }
        pass.dispatch_workgroups(x.div_ceil(8), y.div_ceil(8), if light { z } else { 1 });
    }

    fn side(&self, pass: &mut wgpu::RenderPass<'_>, side: &Side<'_>, i: usize, picture: &Picture<'_>) {
        let Some(fog) = &self.fog[i] else { return };
        let (on_card, scene) = (side.on_card, &side.bake.scene);
        pass.set_bind_group(0, &on_card.view_group, &[]);
        pass.set_bind_group(1, &fog.sums_in, &[]);
        pass.set_vertex_buffer(0, on_card.vertices.slice(..));
        pass.set_index_buffer(on_card.indices.slice(..), wgpu::IndexFormat::Uint32);
        let part = |pass: &mut wgpu::RenderPass<'_>, how: Pass, p: &Part| {
            let Some(pipeline) = self.pipelines.surface(&side.surface(p, how)) else { return };
            pass.set_pipeline(pipeline);
            pass.set_bind_group(2, &on_card.materials[p.material], &[]);
            pass.set_bind_group(3, p.page.map_or(&on_card.no_page, |n| &on_card.pages[n]), &[]);
            pass.draw_indexed(p.indices.clone(), 0, 0..1);
        };
        let eye = (picture.pose.eye - scene.origin).as_vec3();
        let (mut through, mut solid): (Vec<_>, Vec<_>) =
            scene.parts.iter().partition(|p| scene.materials[p.material].passes());
        // From near to far, so that little is shaded in vain.
        solid.sort_by(|a, b| a.centre.distance(eye).total_cmp(&b.centre.distance(eye)));
        for p in solid {
            part(pass, Pass::Opaque, p);
        }
        pass.set_pipeline(&self.pipelines.ball);
        if side.look.balls && !side.balls.is_empty() {
            let spheres: Vec<Sphere> = side.balls.iter().map(|b| sphere(b, picture.seconds)).collect();
            let buffer = self.gpu.buffer("balls", cast_slice(&spheres), BufferUsages::VERTEX);
            spheres_of(pass, &self.ball, &buffer, u32::try_from(spheres.len()).unwrap_or(0));
        }
        if side.look.probes && 0 < on_card.probe_count {
            spheres_of(pass, &self.probe, &on_card.probes, on_card.probe_count);
        }
        pass.set_pipeline(&self.pipelines.sky);
        pass.draw(0..3, 0..1);
        // From far to near.
        through.sort_by(|a, b| b.centre.distance(eye).total_cmp(&a.centre.distance(eye)));
        if !through.is_empty() {
            pass.set_vertex_buffer(0, on_card.vertices.slice(..));
            pass.set_index_buffer(on_card.indices.slice(..), wgpu::IndexFormat::Uint32);
        }
        for p in through {
            part(pass, Pass::Dim, p);
            part(pass, Pass::Add, p);
        }
    }

    fn targets_of(&self, size: [u32; 2]) -> Targets {
        let texture = |format, usage| {
            let texture = self.gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("picture"),
                size: Shape::Flat(size).extent(),
                mip_level_count: 1,
                sample_count: self.samples,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage,
                view_formats: &[],
            });
            whole(&texture)
        };
        let color = texture(self.picture, TextureUsages::RENDER_ATTACHMENT | TextureUsages::TEXTURE_BINDING);
        let layout = if self.samples == 1 { &self.layouts.picture } else { &self.layouts.samples };
        let group = self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout,
            entries: &[at(0, BindingResource::TextureView(&color))],
        });
        Targets { size, depth: texture(DEPTH, TextureUsages::RENDER_ATTACHMENT), color, group }
    }
}

impl Side<'_> {
    /// Whether there is fog to be seen.
    fn foggy(&self) -> bool {
        self.look.fog && !self.bake.media.all.is_empty() && self.look.mode == Mode::Lit
    }

    /// What a part calls for.
    fn surface(&self, part: &Part, pass: Pass) -> Surface {
        let m = &self.bake.scene.materials[part.material];
        let page = part.page.map(|n| &self.bake.pages[n]);
        let directions = self.look.normals && m.maps[NORMALS].is_some();
        Surface {
            pass,
            light: page.map_or(0, |p| if directions && p.directions.is_some() { 2 } else { 1 }),
            shown: self.look.mode.number(),
            foggy: self.foggy(),
            added: self.bake.lamps.iter().any(|l| !l.baked),
            glows: m.emission != Vec3::ZERO,
            passes: 0.0 < m.transmission,
            metals_black: self.bake.metals_black() && 0.0 < m.metal,
            cut: 0.0 < m.cutoff(),
            double_sided: m.double_sided,
        }
    }
}

/// Which of a material's maps has normals.
const NORMALS: usize = 4;

/// A picture that begins black.
fn attachment(view: &wgpu::TextureView) -> wgpu::RenderPassColorAttachment<'_> {
    wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations { load: wgpu::LoadOp::Clear(wgpu::Color::BLACK), store: wgpu::StoreOp::Store },
    }
}

/// Cuts what is drawn to a side's columns; whether there are any.
fn cut(pass: &mut wgpu::RenderPass<'_>, side: &Side<'_>, size: [u32; 2]) -> bool {
    let columns = side.columns.start.min(size[0])..side.columns.end.min(size[0]);
    if !columns.is_empty() {
        pass.set_scissor_rect(columns.start, 0, columns.end - columns.start, size[1]);
    }
    !columns.is_empty()
}

fn sphere(ball: &Ball, seconds: f32) -> Sphere {
    [ball.at(seconds).extend(ball.radius).to_array(), ball.albedo.max(Vec3::ZERO).extend(0.0).to_array()]
}

fn spheres_of(pass: &mut wgpu::RenderPass<'_>, mesh: &SphereMesh, instances: &wgpu::Buffer, count: u32) {
    pass.set_vertex_buffer(0, mesh.vertices.slice(..));
    pass.set_vertex_buffer(1, instances.slice(..));
    pass.set_index_buffer(mesh.indices.slice(..), wgpu::IndexFormat::Uint32);
    pass.draw_indexed(0..mesh.count, 0, 0..count);
}

impl Fog {
    fn new(gpu: &Gpu, layouts: &Layouts, froxels: [u32; 3]) -> Self {
        let volume = |slices, format| {
            let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("fog"),
                size: Shape::Volume([froxels[0], froxels[1], slices]).extent(),
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D3,
                format,
                usage: TextureUsages::STORAGE_BINDING | TextureUsages::TEXTURE_BINDING,
                view_formats: &[],
            });
            whole(&texture)
        };
        let pair = |slices, format| [volume(slices, format), volume(slices, format)];
        let (scattered, sums) = (pair(froxels[2], FROXELS), pair(froxels[2] + 2, HALF));
        let group = |layout, views: &[wgpu::TextureView; 2]| {
            gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("fog"),
                layout,
                entries: &[
                    at(0, BindingResource::TextureView(&views[0])),
                    at(1, BindingResource::TextureView(&views[1])),
                ],
            })
        };
        Self {
            froxels,
            scatter_out: group(&layouts.froxels_out, &scattered),
            scatter_in: group(&layouts.froxels_in, &scattered),
            sums_out: group(&layouts.fog_out, &sums),
            sums_in: group(&layouts.fog_in, &sums),
        }
    }
}
