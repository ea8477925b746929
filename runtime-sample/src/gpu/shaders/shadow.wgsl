// Depth as a lamp sees it.

struct Material {
    base: vec4f,
    glow: vec4f,
    other: vec4f,
}

@group(0) @binding(0) var<uniform> clip_from_world: mat4x4f;
@group(1) @binding(0) var<uniform> material: Material;
@group(1) @binding(1) var base_map: texture_2d<f32>;
@group(1) @binding(6) var base_sampler: sampler;

struct Out {
    @builtin(position) clip: vec4f,
    @location(0) base: vec2f,
    @location(1) alpha: f32,
}

@vertex
fn vertex(@location(0) position: vec3f, @location(3) base: vec2f, @location(8) tint: vec4f) -> Out {
    return Out(clip_from_world * vec4f(position, 1.0), base, tint.a);
}

@fragment
fn fragment(in: Out) {
    let alpha = material.base.a * in.alpha * textureSample(base_map, base_sampler, in.base).a;
    if alpha < material.glow.w { discard; }
}
