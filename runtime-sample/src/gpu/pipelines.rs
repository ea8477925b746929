//! Layouts of bindings, shaders and pipelines.

use std::collections::HashMap;

use wgpu::{
    BindGroupLayout, BindGroupLayoutEntry, BindingType, BufferBindingType, SamplerBindingType, ShaderStages,
    StorageTextureAccess, TextureFormat, TextureSampleType, TextureViewDimension, VertexAttribute,
    VertexFormat,
};

use super::device::Gpu;
use crate::files::scene::Vertex;

/// Format of what shadow maps and pictures are sorted by.
pub(super) const DEPTH: TextureFormat = TextureFormat::Depth32Float;

/// Format of fog, and of pictures where 32-bit floats are not wanted.
pub(super) const HALF: TextureFormat = TextureFormat::Rgba16Float;

/// Format of single froxels: optical depths of thin haze and of thick smoke.
pub(super) const FROXELS: TextureFormat = TextureFormat::Rgba32Float;

/// What is bound together.
#[derive(Debug)]
pub(super) struct Layouts {
    /// Group 0: `shaders/view.wgsl`.
    pub(super) view: BindGroupLayout,
    /// Froxels that are written, and that are read one by one.
    pub(super) froxels_out: BindGroupLayout,
    pub(super) froxels_in: BindGroupLayout,
    /// Their sums that are written, and that are looked up.
    pub(super) fog_out: BindGroupLayout,
    pub(super) fog_in: BindGroupLayout,
    pub(super) material: BindGroupLayout,
    pub(super) page: BindGroupLayout,
    /// One matrix.
    pub(super) matrix: BindGroupLayout,
    /// A picture before tone mapping.
    pub(super) picture: BindGroupLayout,
    /// The same of four samples a pixel.
    pub(super) samples: BindGroupLayout,
}

/// All pipelines of pictures of one format.
#[derive(Debug)]
pub(super) struct Pipelines {
    surfaces: Surfaces,
    pub(super) ball: wgpu::RenderPipeline,
    pub(super) sky: wgpu::RenderPipeline,
    pub(super) tone: wgpu::RenderPipeline,
}

/// Pipelines of surfaces, made when they are first needed: one for each combination of what surfaces call for.
#[derive(Debug)]
struct Surfaces {
    layout: wgpu::PipelineLayout,
    module: wgpu::ShaderModule,
    picture: TextureFormat,
    samples: u32,
    made: HashMap<Surface, wgpu::RenderPipeline>,
}

/// What a surface calls for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Surface {
    pub(super) pass: Pass,
    /// 0 probes, 1 a lightmap, 2 one that knows directions.
    pub(super) light: u32,
    /// [`crate::view::look::Mode::number`].
    pub(super) shown: u32,
    pub(super) foggy: bool,
    pub(super) added: bool,
    pub(super) glows: bool,
    pub(super) passes: bool,
    pub(super) metals_black: bool,
    pub(super) cut: bool,
    pub(super) double_sided: bool,
}

/// How a surface comes into the picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Pass {
    /// In place of what is behind it.
    Opaque,
    /// Multiplies what is behind it.
    Dim,
    /// Adds to what is behind it.
    Add,
}

/// Pipelines that no picture's format matters to.
#[derive(Debug)]
pub(super) struct Fixed {
    pub(super) scatter: wgpu::ComputePipeline,
    pub(super) accumulate: wgpu::ComputePipeline,
    pub(super) shadow: wgpu::RenderPipeline,
}

const DRAWN: ShaderStages = ShaderStages::VERTEX_FRAGMENT.union(ShaderStages::COMPUTE);

fn entry(binding: u32, visibility: ShaderStages, ty: BindingType) -> BindGroupLayoutEntry {
    BindGroupLayoutEntry { binding, visibility, ty, count: None }
}

fn buffer(ty: BufferBindingType) -> BindingType {
    BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None }
}

fn texture(view_dimension: TextureViewDimension, filterable: bool) -> BindingType {
    let sample_type = TextureSampleType::Float { filterable };
    BindingType::Texture { sample_type, view_dimension, multisampled: false }
}

const UNIFORM: BufferBindingType = BufferBindingType::Uniform;
const STORAGE: BufferBindingType = BufferBindingType::Storage { read_only: true };
const FILTERS: BindingType = BindingType::Sampler(SamplerBindingType::Filtering);

impl Layouts {
    pub(super) fn new(gpu: &Gpu) -> Self {
        use TextureViewDimension::{D2, D2Array, D3};
        let layout = |label, entries: &[BindGroupLayoutEntry]| {
            gpu.device
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        let fragment = ShaderStages::FRAGMENT;
        let out = |binding, format| {
            let ty = BindingType::StorageTexture {
                access: StorageTextureAccess::WriteOnly,
                format,
                view_dimension: D3,
            };
            entry(binding, ShaderStages::COMPUTE, ty)
        };
        let depth = BindingType::Texture {
            sample_type: TextureSampleType::Depth,
            view_dimension: D2Array,
            multisampled: false,
        };
        let four = BindingType::Texture {
            sample_type: TextureSampleType::Float { filterable: false },
            view_dimension: D2,
            multisampled: true,
        };
        Self {
            view: layout(
                "view",
                &[
                    entry(0, DRAWN, buffer(UNIFORM)),
                    entry(1, DRAWN, buffer(STORAGE)),
                    entry(2, DRAWN, buffer(STORAGE)),
                    entry(3, DRAWN, texture(D3, true)),
                    entry(4, DRAWN, texture(D3, true)),
                    entry(5, DRAWN, FILTERS),
                    entry(6, DRAWN, depth),
                    entry(7, DRAWN, BindingType::Sampler(SamplerBindingType::Comparison)),
                    entry(8, DRAWN, buffer(STORAGE)),
                    entry(9, DRAWN, buffer(STORAGE)),
                    entry(10, DRAWN, buffer(STORAGE)),
                    entry(11, DRAWN, texture(D2, true)),
                ],
            ),
            froxels_out: layout("froxels out", &[out(0, FROXELS), out(1, FROXELS)]),
            froxels_in: layout(
                "froxels in",
                &[entry(0, DRAWN, texture(D3, false)), entry(1, DRAWN, texture(D3, false))],
            ),
            fog_out: layout("fog out", &[out(0, HALF), out(1, HALF)]),
            fog_in: layout(
                "fog in",
                &[entry(0, DRAWN, texture(D3, true)), entry(1, DRAWN, texture(D3, true))],
            ),
            material: layout(
                "material",
                &[
                    entry(0, fragment, buffer(UNIFORM)),
                    entry(1, fragment, texture(D2, true)),
                    entry(2, fragment, texture(D2, true)),
                    entry(3, fragment, texture(D2, true)),
                    entry(4, fragment, texture(D2, true)),
                    entry(5, fragment, texture(D2, true)),
                    entry(6, fragment, FILTERS),
                    entry(7, fragment, FILTERS),
                    entry(8, fragment, FILTERS),
                    entry(9, fragment, FILTERS),
                    entry(10, fragment, FILTERS),
                ],
            ),
            page: layout(
                "page",
                &[
                    entry(0, fragment, texture(D2, true)),
                    entry(1, fragment, texture(D2Array, true)),
                    entry(2, fragment, texture(D2, false)),
                ],
            ),
            matrix: layout("matrix", &[entry(0, ShaderStages::VERTEX, buffer(UNIFORM))]),
            picture: layout("picture", &[entry(0, fragment, texture(D2, false))]),
            samples: layout("samples", &[entry(0, fragment, four)]),
        }
    }
}

/// Buffers of vertices: corners of the scene.
const CORNERS: [VertexAttribute; 9] = {
    const fn at(shader_location: u32, offset: u64, format: VertexFormat) -> VertexAttribute {
        VertexAttribute { format, offset, shader_location }
    }
    [
        at(0, 0, VertexFormat::Float32x3),
        at(1, 12, VertexFormat::Float32x3),
        at(2, 24, VertexFormat::Float32x2),
        at(3, 32, VertexFormat::Float32x2),
        at(4, 40, VertexFormat::Float32x2),
        at(5, 48, VertexFormat::Float32x2),
        at(6, 56, VertexFormat::Float32x2),
        at(7, 64, VertexFormat::Float32x2),
        at(8, 72, VertexFormat::Unorm16x4),
    ]
};

const _: () = assert!(size_of::<Vertex>() == 80);

fn corners() -> wgpu::VertexBufferLayout<'static> {
    wgpu::VertexBufferLayout {
        array_stride: 80,
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes: &CORNERS,
    }
}

const SPHERE: [VertexAttribute; 1] =
    [VertexAttribute { format: VertexFormat::Float32x3, offset: 0, shader_location: 0 }];
const SPHERES: [VertexAttribute; 2] = [
    VertexAttribute { format: VertexFormat::Float32x4, offset: 0, shader_location: 1 },
    VertexAttribute { format: VertexFormat::Float32x4, offset: 16, shader_location: 2 },
];

const VIEW: &str = include_str!("shaders/view.wgsl");
const FOGGED: &str = include_str!("shaders/fogged.wgsl");

fn shader(gpu: &Gpu, label: &str, parts: &[&str]) -> wgpu::ShaderModule {
    let source = wgpu::ShaderSource::Wgsl(parts.concat().into());
    gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source })
}

fn layout(gpu: &Gpu, label: &str, groups: &[&BindGroupLayout]) -> wgpu::PipelineLayout {
    let groups: Vec<_> = groups.iter().copied().map(Some).collect();
    layout_of(gpu, label, &groups)
}

/// With groups that are not used.
fn layout_of(gpu: &Gpu, label: &str, groups: &[Option<&BindGroupLayout>]) -> wgpu::PipelineLayout {
    gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(label),
        bind_group_layouts: groups,
        immediate_size: 0,
    })
}

/// What differs between pipelines that draw.
struct Drawing<'a> {
    label: &'a str,
    layout: &'a wgpu::PipelineLayout,
    module: &'a wgpu::ShaderModule,
    fragment: &'a str,
    constants: &'a [(&'a str, f64)],
    buffers: &'a [Option<wgpu::VertexBufferLayout<'a>>],
    target: Option<wgpu::ColorTargetState>,
    depth: Option<wgpu::DepthStencilState>,
    double_sided: bool,
    samples: u32,
}

fn pipeline(gpu: &Gpu, d: &Drawing<'_>) -> wgpu::RenderPipeline {
    let targets = d.target.clone().map(Some);
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(d.label),
        layout: Some(d.layout),
        vertex: wgpu::VertexState {
            module: d.module,
            entry_point: Some("vertex"),
            compilation_options: Default::default(),
            buffers: d.buffers,
        },
        primitive: wgpu::PrimitiveState {
            cull_mode: (!d.double_sided).then_some(wgpu::Face::Back),
            ..Default::default()
        },
        depth_stencil: d.depth.clone(),
        multisample: wgpu::MultisampleState { count: d.samples, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module: d.module,
            entry_point: Some(d.fragment),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: d.constants,
                ..Default::default()
            },
            targets: targets.as_slice(),
        }),
        multiview_mask: None,
        cache: None,
    })
}

fn depth(write: bool, compare: wgpu::CompareFunction) -> Option<wgpu::DepthStencilState> {
    Some(wgpu::DepthStencilState {
        format: DEPTH,
        depth_write_enabled: Some(write),
        depth_compare: Some(compare),
        stencil: wgpu::StencilState::default(),
        bias: wgpu::DepthBiasState::default(),
    })
}

impl Pipelines {
    /// For pictures of a format with one or four samples a pixel, shown in another.
    pub(super) fn new(
        gpu: &Gpu,
        l: &Layouts,
        picture: TextureFormat,
        samples: u32,
        shown: TextureFormat,
    ) -> Self {
        use wgpu::CompareFunction::GreaterEqual;
        let ball = shader(gpu, "ball", &[VIEW, FOGGED, include_str!("shaders/ball.wgsl")]);
        let sky = shader(gpu, "sky", &[VIEW, FOGGED, include_str!("shaders/sky.wgsl")]);
        let from = if samples == 1 {
            include_str!("shaders/tone_one.wgsl")
        } else {
            include_str!("shaders/tone_four.wgsl")
        };
        let tone = shader(gpu, "tone", &[VIEW, include_str!("shaders/tone.wgsl"), from]);
        let of_air = layout(gpu, "air", &[&l.view, &l.fog_in]);
        let of_tone = layout(gpu, "tone", &[&l.view, if samples == 1 { &l.picture } else { &l.samples }]);
        let spheres = [
            Some(wgpu::VertexBufferLayout {
                array_stride: 12,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &SPHERE,
            }),
            Some(wgpu::VertexBufferLayout {
                array_stride: 32,
                step_mode: wgpu::VertexStepMode::Instance,
                attributes: &SPHERES,
            }),
        ];
        let ball = Drawing {
            label: "ball",
            layout: &of_air,
            module: &ball,
            fragment: "fragment",
            constants: &[],
            buffers: &spheres,
            target: Some(picture.into()),
            depth: depth(true, GreaterEqual),
            double_sided: false,
            samples,
        };
        let sky = Drawing {
            label: "sky",
            module: &sky,
            buffers: &[],
            depth: depth(false, GreaterEqual),
            ..ball_like(&ball)
        };
        let tone = Drawing {
            label: "tone",
            layout: &of_tone,
            module: &tone,
            fragment: "fragment",
            constants: &[],
            buffers: &[],
            target: Some(shown.into()),
            depth: None,
            double_sided: false,
            samples: 1,
        };
        Self {
            surfaces: Surfaces {
                layout: layout(gpu, "surfaces", &[&l.view, &l.fog_in, &l.material, &l.page]),
                module: shader(gpu, "surface", &[VIEW, FOGGED, include_str!("shaders/surface.wgsl")]),
                picture,
                samples,
                made: HashMap::new(),
            },
            ball: pipeline(gpu, &ball),
            sky: pipeline(gpu, &sky),
            tone: pipeline(gpu, &tone),
        }
    }
}

impl Surfaces {
    fn pipeline(&self, gpu: &Gpu, s: Surface) -> wgpu::RenderPipeline {
        use wgpu::BlendFactor::{One, Src, Zero};
        let (fragment, blend) = match s.pass {
            Pass::Opaque => ("opaque", None),
            Pass::Dim => ("dim", Some((Zero, Src))),
            Pass::Add => ("add", Some((One, One))),
        };
        let component = |src_factor, dst_factor| wgpu::BlendComponent {
            src_factor,
            dst_factor,
            operation: wgpu::BlendOperation::Add,
        };
        let blend = blend
            .map(|(from, to)| wgpu::BlendState { color: component(from, to), alpha: component(Zero, One) });
        let flag = f64::from;
        let constants = [
            ("LIGHT", flag(s.light)),
            ("SHOWN", flag(s.shown)),
            ("FOGGY", flag(u32::from(s.foggy))),
            ("ADDED", flag(u32::from(s.added))),
            ("GLOWS", flag(u32::from(s.glows))),
            ("PASSES", flag(u32::from(s.passes))),
            ("METALS_BLACK", flag(u32::from(s.metals_black))),
            ("CUT", flag(u32::from(s.cut))),
        ];
        let drawing = Drawing {
            label: "surface",
            layout: &self.layout,
            module: &self.module,
            fragment,
            constants: &constants,
            buffers: &[Some(corners())],
            target: Some(wgpu::ColorTargetState {
                format: self.picture,
                blend,
                write_mask: wgpu::ColorWrites::ALL,
            }),
            depth: depth(s.pass == Pass::Opaque, wgpu::CompareFunction::GreaterEqual),
            double_sided: s.double_sided,
            samples: self.samples,
        };
        pipeline(gpu, &drawing)
    }
}

impl Pipelines {
    /// Makes what is missing.
    pub(super) fn prepare(&mut self, gpu: &Gpu, surfaces: impl Iterator<Item = Surface>) {
        for s in surfaces {
            if !self.surfaces.made.contains_key(&s) {
                let made = self.surfaces.pipeline(gpu, s);
                self.surfaces.made.insert(s, made);
            }
        }
    }

    /// One that was prepared.
    pub(super) fn surface(&self, s: &Surface) -> Option<&wgpu::RenderPipeline> {
        self.surfaces.made.get(s)
    }
}

/// The same once more.
fn ball_like<'a>(d: &Drawing<'a>) -> Drawing<'a> {
    Drawing { target: d.target.clone(), depth: d.depth.clone(), ..*d }
}

impl Fixed {
    pub(super) fn new(gpu: &Gpu, l: &Layouts) -> Self {
        let fog = shader(gpu, "fog", &[VIEW, include_str!("shaders/fog.wgsl")]);
        let compute = |label, groups: &[Option<&BindGroupLayout>]| {
            gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(label),
                layout: Some(&layout_of(gpu, label, groups)),
                module: &fog,
                entry_point: Some(label),
                compilation_options: Default::default(),
                cache: None,
            })
        };
        let shadow = shader(gpu, "shadow", &[include_str!("shaders/shadow.wgsl")]);
        let mut state = depth(true, wgpu::CompareFunction::GreaterEqual);
        if let Some(s) = &mut state {
            // A texel of the map is wider than what it shadows; in units of the last digit and of the surface's slope.
            s.bias = wgpu::DepthBiasState { constant: -4, slope_scale: -2.0, clamp: 0.0 };
        }
        let drawn = Drawing {
            label: "shadow",
            layout: &layout(gpu, "shadow", &[&l.matrix, &l.material]),
            module: &shadow,
            fragment: "fragment",
            constants: &[],
            buffers: &[Some(corners())],
            target: None,
            depth: state,
            double_sided: true,
            samples: 1,
        };
        Self {
            scatter: compute("scatter", &[Some(&l.view), Some(&l.froxels_out)]),
            accumulate: compute("accumulate", &[Some(&l.view), None, Some(&l.froxels_in), Some(&l.fog_out)]),
            shadow: pipeline(gpu, &drawn),
        }
    }
}
