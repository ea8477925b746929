//! The panel beside the picture.

use winit::{event::WindowEvent, window::Window};

use super::State;
use crate::{
    files::bake::Bake,
    gpu::{device::Gpu, renderer::Stage},
    view::{camera::Pose, controls::HELP, look::Mode},
};

/// What draws the panel.
pub(super) struct Panel {
    context: egui::Context,
    input: egui_winit::State,
    renderer: egui_wgpu::Renderer,
    redraw: bool,
}

impl Panel {
    pub(super) fn new(gpu: &Gpu, window: &Window, format: wgpu::TextureFormat) -> Self {
        let context = egui::Context::default();
        context.set_theme(egui::Theme::Dark);
        let most = usize::try_from(gpu.device.limits().max_texture_dimension_2d).ok();
        let scale = {
            #[expect(clippy::cast_possible_truncation, reason = "a small number")]
            let scale = window.scale_factor() as f32;
            scale
        };
        let input =
            egui_winit::State::new(context.clone(), egui::ViewportId::ROOT, window, Some(scale), None, most);
        let renderer = egui_wgpu::Renderer::new(&gpu.device, format, egui_wgpu::RendererOptions::default());
        Self { context, input, renderer, redraw: true }
    }

    /// Whether the panel took an event for itself.
    pub(super) fn event(&mut self, window: &Window, event: &WindowEvent) -> bool {
        let response = self.input.on_window_event(window, event);
        self.redraw |= response.repaint;
        // Keys are the window's unless something is written.
        match event {
            WindowEvent::KeyboardInput { .. } => self.context.text_edit_focused(),
            _ => response.consumed,
        }
    }

    /// Whether something of it moves.
    pub(super) fn wants_redraw(&self) -> bool {
        self.redraw
    }

    /// Draws over the picture; what has to be handed over before.
    #[expect(clippy::too_many_arguments, reason = "a frame is all of this")]
    pub(super) fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        window: &Window,
        view: &wgpu::TextureView,
        size: [u32; 2],
        state: &mut State,
        bakes: &[&Bake],
    ) -> Vec<wgpu::CommandBuffer> {
        let input = self.input.take_egui_input(window);
        let mut output = self.context.run_ui(input, |ui| {
            if state.panel {
                contents(ui.ctx(), state, bakes);
            }
            if state.help {
                keys(ui.ctx());
            }
            if state.wiper {
                line(ui.ctx(), state.wipe);
            }
        });
        self.input.handle_platform_output(window, output.platform_output);
        self.redraw = output.viewport_output.values().any(|v| v.repaint_delay.is_zero());
        for (id, deltas) in &output.textures_delta.set {
            for delta in deltas {
                self.renderer.update_texture(&gpu.device, &gpu.queue, *id, delta);
            }
        }
        let scale = output.pixels_per_point;
        let shapes = self.context.tessellate(output.shapes, scale);
        let screen = egui_wgpu::ScreenDescriptor { size_in_pixels: size, pixels_per_point: scale };
        let more = self.renderer.update_buffers(&gpu.device, &gpu.queue, encoder, &shapes, &screen);
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("panel"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
            })],
            ..Default::default()
        });
        self.renderer.render(&mut pass.forget_lifetime(), &shapes, &screen);
        for id in &output.textures_delta.free {
            self.renderer.free_texture(id);
        }
        output.textures_delta.clear();
        more
    }
}

/// Between both sides of the wiper.
fn line(context: &egui::Context, wipe: f32) {
    let screen = context.content_rect();
    let x = screen.left() + wipe * screen.width();
    let layer = egui::LayerId::new(egui::Order::Background, egui::Id::unique("wiper"));
    context.layer_painter(layer).vline(x, screen.y_range(), egui::Stroke::new(1.5, egui::Color32::WHITE));
}

fn contents(context: &egui::Context, s: &mut State, bakes: &[&Bake]) {
    egui::Window::new("Bake")
        .default_pos([8.0, 8.0])
        .default_width(260.0)
        .resizable(false)
        .vscroll(true)
        .show(context, |ui| {
            ui.spacing_mut().slider_width = 150.0;
            for (i, bake) in bakes.iter().enumerate() {
                ui.radio_value(&mut s.bake, i, &bake.label);
            }
            if 1 < bakes.len() {
                ui.checkbox(&mut s.wiper, "wiper");
                if s.wiper {
                    let label = &bakes[s.against].label;
                    egui::ComboBox::from_label("right of it").selected_text(label).show_ui(ui, |ui| {
                        for (i, bake) in bakes.iter().enumerate() {
                            ui.selectable_value(&mut s.against, i, &bake.label);
                        }
                    });
                    ui.add(egui::Slider::new(&mut s.wipe, 0.0..=1.0).text("place"));
                }
            }
            about(ui, bakes[s.bake]);
            ui.separator();
            let cameras = super::cameras(bakes[s.bake]);
            let current = &cameras[s.camera % cameras.len()].name;
            egui::ComboBox::from_label("camera").selected_text(current).show_ui(ui, |ui| {
                for (i, camera) in cameras.iter().enumerate() {
                    if ui.selectable_label(s.camera % cameras.len() == i, &camera.name).clicked() {
                        s.camera = i;
                        s.pose = Pose::new(camera, bakes[s.bake]);
                    }
                }
            });
            egui::ComboBox::from_label("show").selected_text(s.look.mode.name()).show_ui(ui, |ui| {
                for mode in Mode::ALL {
                    ui.selectable_value(&mut s.look.mode, mode, mode.name());
                }
            });
            if s.look.mode == Mode::Error {
                ui.label("blue 1 %, green 10 %, red 100 % of the light");
            }
            if s.look.mode == Mode::Filled {
                ui.label("red: filled from others, blue: gutter");
            }
            ui.add(egui::Slider::new(&mut s.look.stops, -12.0..=12.0).text("stops"));
            ui.checkbox(&mut s.look.fog, "fog");
            ui.checkbox(&mut s.look.normals, "normal maps");
            ui.checkbox(&mut s.look.balls, "moving spheres");
            ui.checkbox(&mut s.look.probes, "probes");
            ui.checkbox(&mut s.times, "times of stages");
            if s.times {
                times(ui, s);
            }
            ui.separator();
            ui.checkbox(&mut s.help, "keys");
        });
}

/// Keys and what they do, on the right.
fn keys(context: &egui::Context) {
    let corner = context.content_rect().right_top() + egui::vec2(-8.0, 8.0);
    let window = egui::Window::new("Keys")
        .default_pos(corner)
        .pivot(egui::Align2::RIGHT_TOP)
        .resizable(false)
        .vscroll(true);
    window.show(context, |ui| {
        egui::Grid::new("keys").num_columns(2).spacing([8.0, 1.0]).show(ui, |ui| {
            for (key, what) in HELP {
                ui.strong(key);
                ui.label(what);
                ui.end_row();
            }
        });
    });
}

fn about(ui: &mut egui::Ui, bake: &Bake) {
    let m = &bake.manifest;
    let media = m.settings.get("media").and_then(serde_json::Value::as_str).unwrap_or("none");
    ui.label(format!(
        "media {media}, {} lamps, {} probes",
        bake.lamps.len(),
        bake.probes.as_ref().map_or(0, |p| p.probes.len())
    ));
    if let Some(error) = m.error.relative {
        ui.label(format!("standard error {:.2} % of the mean", 100.0 * error));
    }
}

fn times(ui: &mut egui::Ui, s: &State) {
    ui.label(format!("frame {:.1} ms, {:.1} frames/s", 1e3 * s.frame, 1.0 / s.frame.max(1e-6)));
    for (stage, seconds) in Stage::ALL.iter().zip(s.stages.unwrap_or_default()) {
        ui.label(format!("{}: {:.2} ms", stage.name(), 1e3 * seconds));
    }
}
