//! A window: flies through a bake, with a panel.

mod panel;

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Instant,
};

use anyhow::{Context, Result, bail};
use glam::Vec2;
use winit::{
    application::ApplicationHandler,
    dpi::{PhysicalPosition, PhysicalSize},
    event::{DeviceId, ElementState, MouseButton, MouseScrollDelta, WindowEvent},
    event_loop::{ActiveEventLoop, ControlFlow, EventLoop},
    keyboard::PhysicalKey,
    window::{Window, WindowId},
};

use crate::{
    args::Args,
    files::{bake::Bake, scene::Camera},
    gpu::{
        device::{self, Gpu, Shape},
        renderer::{self, Picture, Renderer, Shot},
        uploaded::Uploaded,
    },
    picture::{Shown, sides},
    view::{
        balls::Ball,
        camera::Pose,
        controls::{Action, Held, action},
        look::Look,
    },
};

/// Opens a window and shows the bakes until it is closed.
///
/// # Errors
///
/// Where there is no display or no adapter, and where a folder cannot be read.
pub(crate) fn run(args: &Args, folders: &[PathBuf]) -> Result<()> {
    let events = EventLoop::new().context(
        "there is no display to open a window on; `--screenshot FILE.png` and `--turntable FOLDER` need none",
    )?;
    let mut app = App { args, folders, running: None, failed: None };
    events.run_app(&mut app).context("the window was lost")?;
    app.failed.map_or(Ok(()), Err)
}

/// Before and after the window opens.
struct App<'a> {
    args: &'a Args,
    folders: &'a [PathBuf],
    running: Option<Running>,
    failed: Option<anyhow::Error>,
}

/// An open window.
struct Running {
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    renderer: Renderer,
    bakes: Vec<(Bake, Uploaded)>,
    scene: State,
    panel: panel::Panel,
    held: Held,
    drag: Option<PhysicalPosition<f64>>,
    cursor: PhysicalPosition<f64>,
    last: Instant,
    /// Whether nobody can see the window, and whether it has no pixels.
    hidden: bool,
    empty: bool,
    quit: bool,
}

/// What is looked at.
struct State {
    /// Which bake.
    bake: usize,
    /// Which one is right of the wiper, and whether there is a wiper.
    against: usize,
    wiper: bool,
    wipe: f32,
    look: Look,
    pose: Pose,
    camera: usize,
    balls: Vec<Ball>,
    seconds: f32,
    /// Whether the panel, the keys and times are shown.
    panel: bool,
    help: bool,
    times: bool,
    /// Seconds of the last frame, and of its stages where they are asked for.
    frame: f64,
    stages: Option<[f64; 4]>,
}

impl ApplicationHandler for App<'_> {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if self.running.is_some() {
            return;
        }
        match Running::new(self.args, self.folders, events) {
            Ok(running) => self.running = Some(running),
            Err(e) => self.stop(events, Some(e)),
        }
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(running) = &mut self.running else { return };
        let done = running.event(event);
        if running.quit || done.is_err() {
            self.stop(events, done.err());
        }
    }

    fn device_event(&mut self, _: &ActiveEventLoop, _: DeviceId, _: winit::event::DeviceEvent) {}

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        let Some(running) = &self.running else { return };
        // A picture in which nothing moves is drawn once.
        if running.moves() {
            running.window.request_redraw();
        }
        events.set_control_flow(ControlFlow::Wait);
    }
}

impl App<'_> {
    fn stop(&mut self, events: &ActiveEventLoop, failed: Option<anyhow::Error>) {
        self.failed = failed;
        // The surface goes before its window.
        self.running = None;
        events.exit();
    }
}

impl Running {
    fn new(args: &Args, folders: &[PathBuf], events: &ActiveEventLoop) -> Result<Self> {
        let [w, h] = args.size;
        let attributes = Window::default_attributes()
            .with_title(format!("{} - runtime-sample", args.dir.display()))
            .with_inner_size(PhysicalSize::new(w, h));
        let window = Arc::new(events.create_window(attributes).context("the window cannot be opened")?);
        let instance = device::instance(Some(Box::new(events.owned_display_handle())));
        let surface =
            instance.create_surface(window.clone()).context("nothing can be drawn in the window")?;
        let (gpu, adapter) = Gpu::open(&instance, Some(&surface), args.software)?;
        let size = window.inner_size();
        let mut config = surface
            .get_default_config(&adapter, size.width.max(1), size.height.max(1))
            .context("the graphics adapter cannot draw in the window")?;
        // The tone curve encodes by itself, and pictures are read back as bytes.
        let bytes = [wgpu::TextureFormat::Rgba8Unorm, wgpu::TextureFormat::Bgra8Unorm];
        let formats = surface.get_capabilities(&adapter).formats;
        config.format = formats.iter().find(|f| bytes.contains(f)).copied().unwrap_or(config.format);
        config.present_mode = wgpu::PresentMode::AutoVsync;
        surface.configure(&gpu.device, &config);
        let loaded = crate::opened(args, folders, &gpu)?;
        // Four samples a pixel cost a processor as many times as much.
        let samples = if gpu.software { 1 } else { 4 };
        let panel = panel::Panel::new(&gpu, &window, config.format);
        let renderer = Renderer::new(gpu, samples, config.format, false);
        let scene = State::new(args, &loaded)?;
        let mut bakes = Vec::new();
        for bake in loaded {
            let on_card = renderer.upload(&bake)?;
            bakes.push((bake, on_card));
        }
        crate::say(&format!(
            "a window of {} x {} pixels on {}; H lists the keys",
            config.width, config.height, renderer.gpu.name
        ));
        Ok(Self {
            window,
            surface,
            config,
            renderer,
            bakes,
            scene,
            panel,
            held: Held::default(),
            drag: None,
            cursor: PhysicalPosition::default(),
            last: Instant::now(),
            hidden: false,
            empty: false,
            quit: false,
        })
    }

    fn moves(&self) -> bool {
        !self.hidden && !self.empty && self.wants_more()
    }

    fn wants_more(&self) -> bool {
        self.held.moves() || (self.scene.look.balls && !self.scene.balls.is_empty()) || self.scene.times
    }

    fn event(&mut self, event: WindowEvent) -> Result<()> {
        let taken = self.panel.event(&self.window, &event);
        match event {
            WindowEvent::CloseRequested => self.quit = true,
            WindowEvent::Resized(size) => {
                (self.config.width, self.config.height) = (size.width.max(1), size.height.max(1));
                self.empty = size.width == 0 || size.height == 0;
                self.surface.configure(&self.renderer.gpu.device, &self.config);
                self.window.request_redraw();
            }
            WindowEvent::RedrawRequested => return self.frame(),
            WindowEvent::Focused(false) => {
                self.held.clear();
                self.drag = None;
            }
            WindowEvent::Occluded(hidden) => {
                self.hidden = hidden;
                self.window.request_redraw();
            }
            WindowEvent::KeyboardInput { event, is_synthetic, .. } => {
                if let PhysicalKey::Code(key) = event.physical_key {
                    // What is let go is let go, whoever listens.
                    let down = event.state == ElementState::Pressed && !taken;
                    self.held.set(key, down);
                    // Keys that were down before the window was asked: on X11 some of these are told once more.
                    let again = event.repeat || is_synthetic;
                    if let Some(action) =
                        action(key).filter(|a| down && (!again || matches!(a, Action::Wipe(_))))
                    {
                        self.act(action)?;
                    }
                    self.window.request_redraw();
                }
            }
            WindowEvent::MouseInput { state, button: MouseButton::Left, .. } => {
                self.drag = (state == ElementState::Pressed && !taken).then_some(self.cursor);
            }
            WindowEvent::CursorMoved { position, .. } => {
                self.cursor = position;
                if let Some(from) = self.drag.as_mut().map(|d| std::mem::replace(d, position)) {
                    let by = |a: f64, b: f64| {
                        #[expect(clippy::cast_possible_truncation, reason = "pixels")]
                        let pixels = (b - a) as f32;
                        0.004 * pixels
                    };
                    self.scene.pose.turn(by(from.x, position.x), by(from.y, position.y));
                    self.window.request_redraw();
                }
            }
            WindowEvent::MouseWheel { delta, .. } if !taken => {
                let lines = match delta {
                    MouseScrollDelta::LineDelta(_, y) => y,
                    #[expect(clippy::cast_possible_truncation, reason = "pixels")]
                    MouseScrollDelta::PixelDelta(p) => p.y as f32 / 40.0,
                };
                self.held.speed = (self.held.speed + 0.25 * lines).clamp(-6.0, 6.0);
            }
            _ => {}
        }
        if self.panel.wants_redraw() {
            self.window.request_redraw();
        }
        Ok(())
    }

    fn act(&mut self, action: Action) -> Result<()> {
        let n = self.bakes.len();
        let s = &mut self.scene;
        match action {
            Action::Show(mode) => s.look.mode = mode,
            Action::Fog => s.look.fog ^= true,
            Action::Normals => s.look.normals ^= true,
            Action::Balls => s.look.balls ^= true,
            Action::Probes => s.look.probes ^= true,
            Action::Expose(stops) => s.look.stops = (s.look.stops + stops).clamp(-12.0, 12.0),
            Action::NextBake => s.bake = (s.bake + 1) % n,
            Action::PreviousBake => s.bake = (s.bake + n - 1) % n,
            Action::Wiper => {
                s.wiper = !s.wiper && 1 < n;
                if s.against == s.bake {
                    s.against = (s.bake + 1) % n;
                }
            }
            Action::Wipe(by) => s.wipe = (s.wipe + by).clamp(0.0, 1.0),
            Action::Camera => {
                s.camera += 1;
                s.pose = pose_of(&self.bakes[s.bake].0, s.camera);
            }
            Action::Home => {
                s.camera = 0;
                s.pose = pose_of(&self.bakes[s.bake].0, 0);
            }
            Action::Panel => s.panel ^= true,
            Action::Help => s.help ^= true,
            Action::Times => s.times ^= true,
            // A picture that cannot be written is no reason to close the window.
            Action::Screenshot => match self.screenshot() {
                Ok(path) => crate::say(&format!("{} written", path.display())),
                Err(e) => crate::say(&format!("no picture: {e:#}")),
            },
            Action::Quit => self.quit = true,
        }
        Ok(())
    }

    /// Moves on and draws.
    fn frame(&mut self) -> Result<()> {
        let step = self.last.elapsed().as_secs_f64();
        self.last = Instant::now();
        // Not farther than in a tenth of a second, however long the last picture took.
        #[expect(clippy::cast_possible_truncation, reason = "a part of a second")]
        let time = step.min(0.1) as f32;
        let s = &mut self.scene;
        s.seconds += time;
        let [yaw, pitch] = self.held.turn().map(|v| v * time);
        if yaw != 0.0 || pitch != 0.0 {
            s.pose.turn(yaw, pitch);
        }
        s.pose.fly(self.held.way() * (s.pose.focus * time));

        let frame = match self.surface.get_current_texture() {
            wgpu::CurrentSurfaceTexture::Success(t) => t,
            wgpu::CurrentSurfaceTexture::Suboptimal(t) => t,
            wgpu::CurrentSurfaceTexture::Outdated | wgpu::CurrentSurfaceTexture::Lost => {
                self.surface.configure(&self.renderer.gpu.device, &self.config);
                if !self.empty {
                    self.window.request_redraw();
                }
                return Ok(());
            }
            wgpu::CurrentSurfaceTexture::Timeout | wgpu::CurrentSurfaceTexture::Occluded => return Ok(()),
            wgpu::CurrentSurfaceTexture::Validation => {
                bail!("the graphics adapter refused to draw in the window")
            }
        };
        let start = Instant::now();
        let view = frame.texture.create_view(&Default::default());
        let mut encoder = self.renderer.gpu.device.create_command_encoder(&Default::default());
        if self.scene.times {
            let picture = picture(&self.scene, &self.bakes, &self.config);
            self.scene.stages = Some(self.renderer.timed(&picture, &view)?);
        } else {
            self.renderer.draw(&mut encoder, &picture(&self.scene, &self.bakes, &self.config), &view);
        }
        let labels: Vec<&Bake> = self.bakes.iter().map(|(b, _)| b).collect();
        let size = [self.config.width, self.config.height];
        let more = self.panel.draw(
            &self.renderer.gpu,
            &mut encoder,
            &self.window,
            &view,
            size,
            &mut self.scene,
            &labels,
        );
        self.renderer.gpu.queue.submit(more.into_iter().chain([encoder.finish()]));
        self.window.pre_present_notify();
        self.renderer.gpu.queue.present(frame);
        if self.scene.times {
            self.renderer.gpu.wait()?;
        }
        self.scene.frame = start.elapsed().as_secs_f64();
        if self.panel.wants_redraw() {
            self.window.request_redraw();
        }
        Ok(())
    }

    /// Writes what the window shows, without the panel.
    fn screenshot(&mut self) -> Result<PathBuf> {
        let size = [self.config.width, self.config.height];
        let texture = self.renderer.gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("screenshot"),
            size: Shape::Flat(size).extent(),
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: self.config.format,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
            view_formats: &[],
        });
        let row = (4 * size[0]).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let read = self.renderer.gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("screenshot"),
            size: u64::from(row) * u64::from(size[1]),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let mut encoder = self.renderer.gpu.device.create_command_encoder(&Default::default());
        let shown = picture(&self.scene, &self.bakes, &self.config);
        self.renderer.draw(&mut encoder, &shown, &texture.create_view(&Default::default()));
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
        let info = wgpu::TexelCopyBufferInfo { buffer: &read, layout };
        encoder.copy_texture_to_buffer(texture.as_image_copy(), info, Shape::Flat(size).extent());
        self.renderer.gpu.queue.submit([encoder.finish()]);
        let bytes = self.renderer.gpu.read(&read)?;
        let blue_first = matches!(
            self.config.format,
            wgpu::TextureFormat::Bgra8Unorm | wgpu::TextureFormat::Bgra8UnormSrgb
        );
        let picture = image::RgbImage::from_fn(size[0], size[1], |x, y| {
            let at = y as usize * row as usize + 4 * x as usize;
            let [a, b, c] = [bytes[at], bytes[at + 1], bytes[at + 2]];
            image::Rgb(if blue_first { [c, b, a] } else { [a, b, c] })
        });
        let path = free_name(&self.bakes[self.scene.bake].0.label)?;
        picture.save(&path).with_context(|| format!("{}: cannot write", path.display()))?;
        Ok(path)
    }
}

/// What the window shows.
fn picture<'a>(
    s: &'a State,
    bakes: &'a [(Bake, Uploaded)],
    config: &wgpu::SurfaceConfiguration,
) -> Picture<'a> {
    let size = [config.width, config.height];
    let shot = Shot {
        size,
        froxels: renderer::froxels(size),
        shift: Vec2::ZERO,
        depth: 0.5,
        froxel_shift: Vec2::ZERO,
        encode: !config.format.is_srgb(),
        radiance: false,
    };
    let of = |i: usize| {
        let (bake, on_card) = &bakes[i];
        (bake, on_card)
    };
    // A bake beside itself is one picture.
    let two = s.wiper && s.against != s.bake;
    let bakes = if two { vec![of(s.bake), of(s.against)] } else { vec![of(s.bake)] };
    let shown = Shown { bakes, wipe: s.wipe, look: &s.look, balls: &s.balls, seconds: s.seconds };
    Picture { sides: sides(&shown, size[0]), pose: &s.pose, shot, seconds: s.seconds }
}

/// The first name of a picture that no file has.
fn free_name(label: &str) -> Result<PathBuf> {
    let name = |n: u32| PathBuf::from(format!("{label}-{n:03}.png"));
    (0..1000).map(name).find(|p| !Path::exists(p)).context("there are a thousand pictures already")
}

/// The camera of the preview, and the others of the scene.
fn cameras(bake: &Bake) -> Vec<Camera> {
    let preview = bake.camera();
    let other = |c: &&Camera| !c.world_from_camera.abs_diff_eq(preview.world_from_camera, 1e-5);
    let others: Vec<_> = bake.scene.cameras.iter().filter(other).cloned().collect();
    [vec![preview], others].concat()
}

/// That of one of them; after the last the first comes again.
fn pose_of(bake: &Bake, number: usize) -> Pose {
    let all = cameras(bake);
    Pose::new(&all[number % all.len()], bake)
}

impl State {
    fn new(args: &Args, bakes: &[Bake]) -> Result<Self> {
        let chosen = crate::chosen(args, bakes)?;
        let first = chosen.first().context("there is no bake")?;
        let pose = Pose::new(&first.camera_named(args.camera.as_deref())?, first);
        let number = |of: &Bake| bakes.iter().position(|b| std::ptr::eq(b, of)).unwrap_or(0);
        Ok(Self {
            bake: number(first),
            against: chosen.get(1).map_or((number(first) + 1) % bakes.len(), |b| number(b)),
            wiper: 1 < chosen.len(),
            wipe: args.wipe.clamp(0.0, 1.0),
            look: crate::look(args, first),
            balls: crate::balls_of(args, first, &pose),
            pose,
            camera: 0,
            seconds: args.time,
            panel: true,
            help: true,
            times: false,
            frame: 0.0,
            stages: None,
        })
    }
}
