// What fog leaves of light on its way to the eye, and what it adds.

@group(1) @binding(0) var fog_light: texture_3d<f32>;
@group(1) @binding(1) var fog_passing: texture_3d<f32>;

struct Fog {
    light: vec3f,
    passes: vec3f,
}

// Up to a distance ahead; everything where it is negative.
fn fog(pixel: vec2f, ahead: f32) -> Fog {
    if !on(FOG) { return Fog(vec3f(0.0), vec3f(1.0)); }
    let slices = f32(view.froxels.z);
    var k = slices + 1.0;
    if 0.0 <= ahead {
        let first = view.slices.x;
        k = select(1.0 + log(ahead / first) / view.slices.y, ahead / first, ahead < first);
        k = min(k, slices);
    }
    let shift = vec2f(view.right.w, view.up.w) / vec2f(view.froxels.xy);
    let at = vec3f(pixel * view.size.zw - shift, (k + 0.5) / (slices + 2.0));
    return Fog(textureSampleLevel(fog_light, linear, at, 0.0).rgb, textureSampleLevel(fog_passing, linear, at, 0.0).rgb);
}
