//! A bake on the card.

use std::collections::HashMap;

use anyhow::{Context, Result, bail, ensure};
use bytemuck::{bytes_of, cast_slice};
use glam::{Mat4, Vec3};
use wgpu::{
    BindGroupEntry, BindingResource, BufferUsages, TextureFormat, TextureView, TextureViewDescriptor,
    TextureViewDimension,
};

use super::{
    device::{Gpu, Shape},
    lamps,
    pipelines::{DEPTH, Fixed, HALF, Layouts},
    uniforms::{LampUniform, MaterialUniform, MediumUniform, ViewUniform},
};
use crate::{
    files::{
        bake::Bake,
        ktx,
        material::{Alpha, Material, Picture, Wrap},
        page::{Page, Texels},
    },
    view::balls,
};

/// Everything of a bake that drawing needs.
#[derive(Debug)]
pub(crate) struct Uploaded {
    pub(super) view: wgpu::Buffer,
    pub(super) view_group: wgpu::BindGroup,
    pub(super) vertices: wgpu::Buffer,
    pub(super) indices: wgpu::Buffer,
    pub(super) materials: Vec<wgpu::BindGroup>,
    pub(super) pages: Vec<wgpu::BindGroup>,
    /// For what has no texels.
    pub(super) no_page: wgpu::BindGroup,
    /// Instances of probes as spheres.
    pub(super) probes: wgpu::Buffer,
    pub(super) probe_count: u32,
    pub(super) probe_offsets: [u32; 2],
    pub(super) has_grid: bool,
    pub(super) lamps: u32,
    pub(super) lamps_in_fog: bool,
    /// Distance of what is farthest from the middle of the scene, media included, metres.
    pub(super) radius: f32,
}

/// What a sphere is told: place and radius, albedo and which probe.
pub(super) type Sphere = [[f32; 4]; 2];

impl Uploaded {
    /// Uploads a bake and draws its shadow maps.
    ///
    /// # Errors
    ///
    /// Where it is beyond what the adapter takes.
    pub(super) fn new(gpu: &Gpu, layouts: &Layouts, fixed: &Fixed, bake: &Bake) -> Result<Self> {
        for (n, p) in bake.pages.iter().enumerate() {
            let most = gpu.device.limits().max_texture_dimension_2d;
            ensure!(
                p.width.max(p.height) <= most,
                "page {n} of {} has {} x {} texels, this adapter takes {most}: bake with --max-size {most}",
                bake.label,
                p.width,
                p.height
            );
        }
        let scene = &bake.scene;
        let limits = gpu.device.limits();
        let most = limits.max_buffer_size.min(limits.max_storage_buffer_binding_size);
        let probes = ProbeArrays::new(bake)?;
        let larger = [
            ("vertices", size_of_val(&scene.vertices[..])),
            ("indices", size_of_val(&scene.indices[..])),
            ("probes", probes.words.len().max(size_of_val(&probes.light[..]))),
        ];
        for (what, bytes) in larger {
            let fits = u64::try_from(bytes).is_ok_and(|b| b <= most);
            ensure!(fits, "the {what} of {} have {bytes} bytes, this adapter takes {most}", bake.label);
        }
        let vertices = gpu.buffer("vertices", cast_slice(&scene.vertices), BufferUsages::VERTEX);
        let indices = gpu.buffer("indices", cast_slice(&scene.indices), BufferUsages::INDEX);
        let mut textures = Textures::new(gpu);
        let materials: Vec<_> =
            scene.materials.iter().map(|m| textures.material(gpu, layouts, m, &scene.pictures)).collect();

        let lamps_in_fog = !bake.media.all.is_empty() && bake.grid.as_ref().is_some_and(|g| g.without_lamps);
        let needed = |l: &crate::files::bake::Lamp| lamps_in_fog || !l.baked;
        let plan = lamps::Plan::new(bake, needed);
        let dark = bake.lamps.iter().zip(&plan.shadows).filter(|(l, s)| needed(l) && s.is_none()).count();
        if 0 < dark {
            crate::say(&format!(
                "{}: no room for the shadow maps of {dark} lamps, which stay dark",
                bake.label
            ));
        }
        let shadows = shadow_maps(gpu, layouts, fixed, bake, &plan, (&vertices, &indices, &materials));
        let lamps: Vec<_> =
            bake.lamps.iter().zip(&plan.shadows).map(|(l, s)| LampUniform::new(l, *s, bake)).collect();
        let media: Vec<_> = bake.media.all.iter().map(|m| MediumUniform::new(m, bake)).collect();

        let grid = bake.grid.as_ref();
        let grid_view = match grid {
            Some(g) => {
                let size = [g.size[0], g.size[1], g.slices * crate::files::volume::BLOCKS];
                gpu.texture("light grid", Shape::Volume(size), HALF, &g.bytes)
            }
            None => gpu.texture("light grid", Shape::Volume([1; 3]), HALF, &[0; 8]),
        };
        let (bytes, size) = &bake.media.atlas;
        let none = [0; 2];
        let bytes = if bytes.is_empty() { &none[..] } else { bytes };
        let densities =
            gpu.texture("densities", Shape::Volume(size.map(|n| n.max(1))), TextureFormat::R16Float, bytes);
        let widest = limits.max_texture_dimension_2d;
        if let Some(s) = bake.sky.as_ref().filter(|s| widest < s.width.max(s.height)) {
            bail!(
                "sky.exr of {} has {} x {} texels, this adapter takes {widest}",
                bake.label,
                s.width,
                s.height
            );
        }
        let sky = match &bake.sky {
            Some(s) => gpu.texture("sky", Shape::Flat([s.width, s.height]), HALF, cast_slice(&s.texels)),
            None => gpu.texture("sky", Shape::Flat([1; 2]), HALF, &[0; 8]),
        };
        let view_size = size_of::<ViewUniform>() as u64;
        let view = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("view"),
            size: view_size,
            usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let storage = |label, bytes: &[u8]| gpu.buffer(label, bytes, BufferUsages::STORAGE);
        let nearer = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            label: Some("nearer"),
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            compare: Some(wgpu::CompareFunction::GreaterEqual),
            ..Default::default()
        });
        let linear = clamped(gpu);
        let buffers = [
            storage("lamps", cast_slice(&lamps)),
            storage("media", cast_slice(&media)),
            storage("matrices", cast_slice(&plan.clip_from_world)),
            storage("probes", &probes.words),
            storage("light of probes", cast_slice(&probes.light)),
        ];
        let view_group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("view"),
            layout: &layouts.view,
            entries: &[
                at(0, view.as_entire_binding()),
                at(1, buffers[0].as_entire_binding()),
                at(2, buffers[1].as_entire_binding()),
                at(3, BindingResource::TextureView(&whole(&grid_view))),
                at(4, BindingResource::TextureView(&whole(&densities))),
                at(5, BindingResource::Sampler(&linear)),
                at(6, BindingResource::TextureView(&shadows)),
                at(7, BindingResource::Sampler(&nearer)),
                at(8, buffers[2].as_entire_binding()),
                at(9, buffers[3].as_entire_binding()),
                at(10, buffers[4].as_entire_binding()),
                at(11, BindingResource::TextureView(&whole(&sky))),
            ],
        });
        let pages = bake.pages.iter().map(|p| page(gpu, layouts, p)).collect::<Result<_>>()?;
        let count = |n: usize| u32::try_from(n).context("there are too many of them");
        Ok(Self {
            view,
            view_group,
            vertices,
            indices,
            materials,
            pages,
            no_page: no_page(gpu, layouts),
            probes: gpu.buffer("probe spheres", cast_slice(&probes.spheres), BufferUsages::VERTEX),
            probe_count: count(probes.spheres.len())?,
            probe_offsets: probes.offsets,
            has_grid: grid.is_some(),
            lamps: count(lamps.len())?,
            lamps_in_fog,
            radius: radius(bake),
        })
    }
}

pub(super) fn at(binding: u32, resource: BindingResource<'_>) -> BindGroupEntry<'_> {
    BindGroupEntry { binding, resource }
}

pub(super) fn whole(texture: &wgpu::Texture) -> TextureView {
    texture.create_view(&TextureViewDescriptor::default())
}

fn clamped(gpu: &Gpu) -> wgpu::Sampler {
    gpu.device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("linear"),
        mag_filter: wgpu::FilterMode::Linear,
        min_filter: wgpu::FilterMode::Linear,
        ..Default::default()
    })
}

/// How far surfaces and media that end reach from the middle.
fn radius(bake: &Bake) -> f32 {
    let mut radius = bake.scene.radius;
    for m in &bake.media.all {
        let world_from_cube = m.cube.or(m.density.as_ref().map(|d| d.cube)).map(|c| c.inverse());
        let corner = |i: u8| Vec3::new(f32::from(i & 1), f32::from(i >> 1 & 1), f32::from(i >> 2));
        for p in world_from_cube.iter().flat_map(|w| (0..8).map(|i| w.transform_point3(corner(i)))) {
            let far = (p.as_dvec3() - bake.scene.origin).length();
            #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
            let far = far as f32;
            radius = radius.max(if far.is_finite() { far } else { 0.0 });
        }
    }
    radius
}

/// Probes as `tables::probes` says they are laid out, for shaders.
struct ProbeArrays {
    /// Index, bricks, occlusions.
    words: Vec<u8>,
    /// Where bricks and occlusions begin.
    offsets: [u32; 2],
    /// Nine coefficients of each probe; higher bands give no irradiance.
    light: Vec<[[f32; 3]; 9]>,
    spheres: Vec<Sphere>,
}

/// Radius of probes that are shown, in smallest cells.
const PROBE_RADIUS: f32 = 0.08;

/// Valid probes see fewer backs of surfaces than this leaves.
const VALID: f32 = 0.75;

impl ProbeArrays {
    fn new(bake: &Bake) -> Result<Self> {
        let mut arrays =
            Self { words: vec![0xff; 4], offsets: [0; 2], light: Vec::new(), spheres: Vec::new() };
        let Some(v) = &bake.probes else { return Ok(arrays) };
        // The file's arrays between its header and its probes are those that shaders read.
        let [index, bricks, occlusions] = [v.index.len(), 193 * v.bricks.len(), 64 * v.occlusions.len()];
        let bytes = v.to_bytes();
        let end = 4 * (16 + index + bricks + occlusions);
        arrays.words = bytes.get(64..end).context("probes are not as their numbers say")?.to_vec();
        let offset = |n: usize| u32::try_from(n).context("there are too many probes");
        arrays.offsets = [offset(index)?, offset(index + bricks)?];
        for (i, p) in v.probes.iter().enumerate() {
            let c = p.light.expand();
            arrays.light.push(std::array::from_fn(|k| c[k]));
            let at = (Vec3::from(p.position).as_dvec3() - bake.scene.origin).as_vec3();
            // Those in walls hold the light of others and are red.
            let albedo = if p.validity < VALID { Vec3::new(1.0, 0.1, 0.1) } else { Vec3::ONE };
            let place = at.extend(PROBE_RADIUS * v.lattice.spacing).to_array();
            arrays.spheres.push([place, albedo.extend(1.0 + i as f32).to_array()]);
        }
        Ok(arrays)
    }
}

/// Draws what each lamp sees.
fn shadow_maps(
    gpu: &Gpu,
    layouts: &Layouts,
    fixed: &Fixed,
    bake: &Bake,
    plan: &lamps::Plan,
    (vertices, indices, materials): (&wgpu::Buffer, &wgpu::Buffer, &[wgpu::BindGroup]),
) -> TextureView {
    let side = plan.side();
    let layers = u32::try_from(plan.clip_from_world.len()).unwrap_or(0).max(1);
    let texture = gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some("shadows"),
        size: Shape::Layers([side, side, layers]).extent(),
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: DEPTH,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::RENDER_ATTACHMENT,
        view_formats: &[],
    });
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    for (layer, matrix) in (0..).zip(&plan.clip_from_world) {
        let buffer = gpu.buffer("matrix", bytes_of::<Mat4>(matrix), BufferUsages::UNIFORM);
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("matrix"),
            layout: &layouts.matrix,
            entries: &[at(0, buffer.as_entire_binding())],
        });
        let view = texture.create_view(&TextureViewDescriptor {
            dimension: Some(TextureViewDimension::D2),
            base_array_layer: layer,
            array_layer_count: Some(1),
            ..Default::default()
        });
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow"),
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &view,
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            ..Default::default()
        });
        pass.set_pipeline(&fixed.shadow);
        pass.set_bind_group(0, &group, &[]);
        pass.set_vertex_buffer(0, vertices.slice(..));
        pass.set_index_buffer(indices.slice(..), wgpu::IndexFormat::Uint32);
        for part in bake.scene.parts.iter().filter(|p| p.shadow && !bake.scene.materials[p.material].passes())
        {
            pass.set_bind_group(1, &materials[part.material], &[]);
            pass.draw_indexed(part.indices.clone(), 0, 0..1);
        }
    }
    gpu.queue.submit([encoder.finish()]);
    texture.create_view(&TextureViewDescriptor {
        dimension: Some(TextureViewDimension::D2Array),
        ..Default::default()
    })
}

fn page(gpu: &Gpu, layouts: &Layouts, page: &Page) -> Result<wgpu::BindGroup> {
    let size = [page.width, page.height];
    let light = match &page.light {
        Texels::Texture(ktx::Image { format: ktx2::Format::BC6H_UFLOAT_BLOCK, bytes, .. }) => {
            // Blocks at the edge are whole.
            ensure!(
                size.iter().all(|n| n % 4 == 0),
                "{} x {} texels are no whole blocks: bake again",
                size[0],
                size[1]
            );
            gpu.texture("light", Shape::Flat(size), TextureFormat::Bc6hRgbUfloat, bytes)
        }
        Texels::Texture(image) => gpu.texture("light", Shape::Flat(size), HALF, &image.bytes),
        Texels::Floats(texels) if gpu.floats => {
            gpu.texture("light", Shape::Flat(size), TextureFormat::Rgba32Float, cast_slice(texels))
        }
        Texels::Floats(texels) => {
            let most = half::f16::MAX.to_f32();
            let halves: Vec<_> = texels.iter().map(|t| t.map(|v| half::f16::from_f32(v.min(most)))).collect();
            gpu.texture("light", Shape::Flat(size), HALF, cast_slice(&halves))
        }
    };
    let directions = match &page.directions {
        Some(d) => gpu.texture("directions", Shape::Layers([size[0], size[1], 3]), HALF, &d.bytes),
        None => gpu.texture("directions", Shape::Flat([1; 2]), HALF, &[0; 8]),
    };
    let figures = gpu.texture("figures", Shape::Flat(size), HALF, cast_slice(&page.figures));
    Ok(page_group(gpu, layouts, [&light, &directions, &figures]))
}

fn no_page(gpu: &Gpu, layouts: &Layouts) -> wgpu::BindGroup {
    let none = gpu.texture("no light", Shape::Flat([1; 2]), HALF, &[0; 8]);
    page_group(gpu, layouts, [&none; 3])
}

fn page_group(
    gpu: &Gpu,
    layouts: &Layouts,
    [light, directions, figures]: [&wgpu::Texture; 3],
) -> wgpu::BindGroup {
    let layers =
        TextureViewDescriptor { dimension: Some(TextureViewDimension::D2Array), ..Default::default() };
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("page"),
        layout: &layouts.page,
        entries: &[
            at(0, BindingResource::TextureView(&whole(light))),
            at(1, BindingResource::TextureView(&directions.create_view(&layers))),
            at(2, BindingResource::TextureView(&whole(figures))),
        ],
    })
}

/// Textures and samplers of materials, each once.
struct Textures {
    /// By image and whether it is encoded as sRGB.
    views: HashMap<(usize, bool), TextureView>,
    samplers: HashMap<(Wrap, Wrap, bool), wgpu::Sampler>,
    white: TextureView,
}

impl Textures {
    fn new(gpu: &Gpu) -> Self {
        let white = gpu.texture("white", Shape::Flat([1; 2]), TextureFormat::Rgba8Unorm, &[255; 4]);
        Self { views: HashMap::new(), samplers: HashMap::new(), white: whole(&white) }
    }

    fn material(
        &mut self,
        gpu: &Gpu,
        layouts: &Layouts,
        m: &Material,
        pictures: &[Option<Picture>],
    ) -> wgpu::BindGroup {
        // Base colour and emission are encoded as sRGB, the others are numbers.
        let encoded = [true, true, false, false, false];
        let views: [TextureView; 5] = std::array::from_fn(|i| {
            let picture = m.maps[i].and_then(|map| Some((map.image, pictures.get(map.image)?.as_ref()?)));
            let Some((image, picture)) = picture else { return self.white.clone() };
            self.views
                .entry((image, encoded[i]))
                .or_insert_with(|| mipmapped(gpu, picture, encoded[i]))
                .clone()
        });
        let samplers: [wgpu::Sampler; 5] = std::array::from_fn(|i| {
            let map = m.maps[i];
            let key = map.map_or((Wrap::Repeat, Wrap::Repeat, false), |m| (m.wrap[0], m.wrap[1], m.nearest));
            self.samplers.entry(key).or_insert_with(|| sampler(gpu, key)).clone()
        });
        let bits = [m.alpha == Alpha::Blend, m.unlit];
        let bits: u8 = bits.iter().enumerate().map(|(i, b)| u8::from(*b) << i).sum();
        let uniform = MaterialUniform {
            base: m.base.to_array(),
            glow: m.emission.extend(m.cutoff()).to_array(),
            other: [m.transmission, m.metal, m.bumps, f32::from(bits)],
        };
        let uniform = gpu.buffer("material", bytes_of(&uniform), BufferUsages::UNIFORM);
        let mut entries = vec![at(0, uniform.as_entire_binding())];
        entries.extend((1..).zip(&views).map(|(i, v)| at(i, BindingResource::TextureView(v))));
        entries.extend((6..).zip(&samplers).map(|(i, s)| at(i, BindingResource::Sampler(s))));
        let layout = &layouts.material;
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("material"),
            layout,
            entries: &entries,
        })
    }
}

fn sampler(gpu: &Gpu, (u, v, nearest): (Wrap, Wrap, bool)) -> wgpu::Sampler {
    let mode = |w| match w {
        Wrap::Repeat => wgpu::AddressMode::Repeat,
        Wrap::Mirror => wgpu::AddressMode::MirrorRepeat,
        Wrap::Clamp => wgpu::AddressMode::ClampToEdge,
    };
    let filter = if nearest { wgpu::FilterMode::Nearest } else { wgpu::FilterMode::Linear };
    gpu.device.create_sampler(&wgpu::SamplerDescriptor {
        label: Some("textures"),
        address_mode_u: mode(u),
        address_mode_v: mode(v),
        mag_filter: filter,
        min_filter: filter,
        mipmap_filter: wgpu::MipmapFilterMode::Linear,
        // A processor takes as many looks one after the other.
        anisotropy_clamp: if nearest || gpu.software { 1 } else { 8 },
        ..Default::default()
    })
}

/// A picture with all of its smaller versions.
fn mipmapped(gpu: &Gpu, picture: &Picture, encoded: bool) -> TextureView {
    let most = gpu.device.limits().max_texture_dimension_2d;
    let mut size = [picture.width, picture.height];
    let mut levels = vec![picture.texels.clone()];
    let mut bytes = Vec::new();
    let mut first = 0;
    while size != [1, 1] {
        let smaller = halved(levels.last().map_or(&[][..], |l| l), size, encoded);
        size = size.map(|n| (n / 2).max(1));
        levels.push(smaller);
    }
    // What the adapter does not take is left out.
    let mut size = [picture.width, picture.height];
    while most < size[0].max(size[1]) {
        (size, first) = (size.map(|n| (n / 2).max(1)), first + 1);
    }
    levels[first..].iter().for_each(|l| bytes.extend_from_slice(l));
    let format = if encoded { TextureFormat::Rgba8UnormSrgb } else { TextureFormat::Rgba8Unorm };
    let descriptor = wgpu::TextureDescriptor {
        label: Some("picture"),
        size: Shape::Flat(size).extent(),
        mip_level_count: u32::try_from(levels.len() - first).unwrap_or(1),
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    };
    let order = wgpu::util::TextureDataOrder::LayerMajor;
    use wgpu::util::DeviceExt;
    whole(&gpu.device.create_texture_with_data(&gpu.queue, &descriptor, order, &bytes))
}

/// The mean of each four texels, of what they encode.
fn halved(texels: &[u8], [w, h]: [u32; 2], encoded: bool) -> Vec<u8> {
    let (w, h) = (w as usize, h as usize);
    let curve: [f32; 256] = std::array::from_fn(|i| decoded(i as f32 / 255.0, encoded));
    let mut out = Vec::with_capacity((w / 2).max(1) * (h / 2).max(1) * 4);
    for y in 0..(h / 2).max(1) {
        for x in 0..(w / 2).max(1) {
            for c in 0..4 {
                let at = |i: usize, j: usize| {
                    usize::from(texels[4 * ((2 * y + j).min(h - 1) * w + (2 * x + i).min(w - 1)) + c])
                };
                let four = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
                // Alpha is a number.
                let mean = if c < 3 {
                    coded(0.25 * four.iter().map(|i| curve[*i]).sum::<f32>(), encoded)
                } else {
                    four.iter().sum::<usize>() as f32 / 1020.0
                };
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "between 0 and 255"
                )]
                out.push((mean * 255.0).round() as u8);
            }
        }
    }
    out
}

/// IEC 61966-2-1, if the number is encoded.
fn decoded(v: f32, encoded: bool) -> f32 {
    match encoded {
        false => v,
        true if v <= 0.04045 => v / 12.92,
        true => ((v + 0.055) / 1.055).powf(2.4),
    }
}

/// The other way.
pub(crate) fn coded(v: f32, encoded: bool) -> f32 {
    match encoded {
        false => v,
        true if v <= 0.003_130_8 => v * 12.92,
        true => 1.055 * v.powf(1.0 / 2.4) - 0.055,
    }
}

/// The unit sphere.
#[derive(Debug)]
pub(super) struct SphereMesh {
    pub(super) vertices: wgpu::Buffer,
    pub(super) indices: wgpu::Buffer,
    pub(super) count: u32,
}

impl SphereMesh {
    pub(super) fn new(gpu: &Gpu, rings: u32) -> Self {
        let (corners, triangles) = balls::sphere(rings);
        Self {
            vertices: gpu.buffer("sphere", cast_slice(&corners), BufferUsages::VERTEX),
            indices: gpu.buffer("sphere", cast_slice(&triangles), BufferUsages::INDEX),
            count: u32::try_from(triangles.len()).unwrap_or(0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smaller_pictures_keep_the_light() {
        // Black and white: the mean of the light is half, whose code is 188; as numbers it is 128.
        let texels = [[0, 0, 0, 255], [255; 4], [255; 4], [0, 0, 0, 0]].concat();
        assert_eq!(halved(&texels, [2, 2], true), [188, 188, 188, 191]);
        assert_eq!(halved(&texels, [2, 2], false)[0], 128);
        assert_eq!(halved(&texels[..8], [2, 1], false), [128, 128, 128, 255]);
        assert_eq!(halved(&[7; 60], [5, 3], true), [7; 8]);
    }

    #[test]
    fn codes_are_turned_back() {
        for i in 0..=255u8 {
            let v = f32::from(i) / 255.0;
            assert!((coded(decoded(v, true), true) - v).abs() < 1e-5);
        }
    }
}
