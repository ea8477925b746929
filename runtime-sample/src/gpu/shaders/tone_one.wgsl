
@group(1) @binding(0) var picture: texture_2d<f32>;

@fragment
fn fragment(@builtin(position) at: vec4f) -> @location(0) vec4f {
    return vec4f(finished(linear_of(textureLoad(picture, vec2u(at.xy), 0))), 1.0);
}
