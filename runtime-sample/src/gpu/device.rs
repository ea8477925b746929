//! The adapter and what it can do.

use anyhow::{Context, Result};
use wgpu::util::DeviceExt;

/// An open device.
#[derive(Debug)]
pub(crate) struct Gpu {
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    /// Name of the adapter and its interface.
    pub(crate) name: String,
    /// Whether textures in blocks (BC6H) are drawn as they are.
    pub(crate) blocks: bool,
    /// Whether textures of 32-bit floats can be filtered.
    pub(crate) floats: bool,
    /// Whether pictures of 32-bit floats can be blended.
    pub(crate) wide_pictures: bool,
    /// Whether the processor draws.
    pub(crate) software: bool,
    /// Texels along one axis of a volume, at most.
    pub(crate) most_slices: u32,
}

/// What to do where no adapter is found.
const NO_ADAPTER: &str = "no graphics adapter: drawing needs a driver for Vulkan, Metal or Direct3D 12; the software driver of Mesa will do \
     (Debian, Ubuntu: `apt install mesa-vulkan-drivers`)";

/// The way to adapters; `display` is where windows will be opened.
pub(crate) fn instance(display: Option<Box<dyn wgpu::wgt::WgpuHasDisplayHandle>>) -> wgpu::Instance {
    let none = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    wgpu::Instance::new(match display {
        Some(display) => none.with_display_handle(display),
        None => none,
    })
}

impl Gpu {
    /// Opens the fastest adapter, or one that is software; it can show pictures on `surface`.
    ///
    /// # Errors
    ///
    /// If there is none.
    pub(crate) fn open(
        instance: &wgpu::Instance,
        surface: Option<&wgpu::Surface<'_>>,
        software: bool,
    ) -> Result<(Self, wgpu::Adapter)> {
        let options = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            force_fallback_adapter: software,
            compatible_surface: surface,
            ..Default::default()
        };
        let adapter = pollster::block_on(instance.request_adapter(&options)).context(NO_ADAPTER)?;
        let has = adapter.features();
        let wanted = has
            & (wgpu::Features::TEXTURE_COMPRESSION_BC
                | wgpu::Features::FLOAT32_FILTERABLE
                | wgpu::Features::FLOAT32_BLENDABLE);
        let descriptor = wgpu::DeviceDescriptor {
            label: None,
            required_features: wanted,
            // As large textures and buffers as there can be: bakes differ.
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let opened = pollster::block_on(adapter.request_device(&descriptor));
        let (device, queue) = opened.context("the graphics adapter cannot be opened")?;
        let info = adapter.get_info();
        let gpu = Self {
            name: format!("{} ({})", info.name, info.backend),
            // A processor would unpack a block for every look at it: 445 ms a frame of the default hall, 36 ms with what is unpacked before.
            blocks: wanted.contains(wgpu::Features::TEXTURE_COMPRESSION_BC)
                && info.device_type != wgpu::DeviceType::Cpu,
            floats: wanted.contains(wgpu::Features::FLOAT32_FILTERABLE),
            wide_pictures: wanted.contains(wgpu::Features::FLOAT32_BLENDABLE),
            software: info.device_type == wgpu::DeviceType::Cpu,
            most_slices: adapter.limits().max_texture_dimension_3d,
            device,
            queue,
        };
        Ok((gpu, adapter))
    }

    /// A buffer of these bytes; never empty, which bindings do not allow.
    pub(crate) fn buffer(&self, label: &str, bytes: &[u8], usage: wgpu::BufferUsages) -> wgpu::Buffer {
        let contents = if bytes.is_empty() { &[0; 256] } else { bytes };
        self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some(label),
            contents,
            usage,
        })
    }

    /// A texture of one level with these texels.
    pub(crate) fn texture(
        &self,
        label: &str,
        shape: Shape,
        format: wgpu::TextureFormat,
        bytes: &[u8],
    ) -> wgpu::Texture {
        let size = shape.extent();
        let descriptor = wgpu::TextureDescriptor {
            label: Some(label),
            size,
            mip_level_count: 1,
            sample_count: 1,
            dimension: shape.dimension(),
            format,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        };
        let order = wgpu::util::TextureDataOrder::LayerMajor;
        self.device.create_texture_with_data(&self.queue, &descriptor, order, bytes)
    }

    /// Waits until all that was handed over is done.
    ///
    /// # Errors
    ///
    /// If the device is lost.
    pub(crate) fn wait(&self) -> Result<()> {
        self.device.poll(wgpu::PollType::wait_indefinitely()).context("the graphics adapter was lost")?;
        Ok(())
    }

    /// The bytes of a buffer that can be mapped.
    ///
    /// # Errors
    ///
    /// If the device is lost.
    pub(crate) fn read(&self, buffer: &wgpu::Buffer) -> Result<Vec<u8>> {
        let (send, receive) = std::sync::mpsc::channel();
        buffer.map_async(wgpu::MapMode::Read, .., move |mapped| {
            // Nobody listens any more only when this function has failed already.
            let _ = send.send(mapped);
        });
        self.wait()?;
        receive.recv().context("the graphics adapter was lost")?.context("the picture cannot be read")?;
        let bytes = buffer.get_mapped_range(..).context("the picture cannot be read")?.to_vec();
        buffer.unmap();
        Ok(bytes)
    }
}

/// Sizes of textures.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape {
    /// Width and height.
    Flat([u32; 2]),
    /// Width, height and layers.
    Layers([u32; 3]),
    /// Width, height and depth.
    Volume([u32; 3]),
}

impl Shape {
    /// As wgpu has it.
    pub(crate) fn extent(self) -> wgpu::Extent3d {
        let [width, height, depth_or_array_layers] = match self {
            Self::Flat([w, h]) => [w, h, 1],
            Self::Layers(s) | Self::Volume(s) => s,
        };
        wgpu::Extent3d { width, height, depth_or_array_layers }
    }

    /// As wgpu has it.
    pub(crate) fn dimension(self) -> wgpu::TextureDimension {
        match self {
            Self::Volume(_) => wgpu::TextureDimension::D3,
            _ => wgpu::TextureDimension::D2,
        }
    }
}
