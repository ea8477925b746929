
@group(1) @binding(0) var picture: texture_multisampled_2d<f32>;

// Edges are smooth where samples are mixed after the curve.
@fragment
fn fragment(@builtin(position) at: vec4f) -> @location(0) vec4f {
    var sum = vec3f(0.0);
    for (var i = 0; i < 4; i++) { sum += linear_of(textureLoad(picture, vec2u(at.xy), i)); }
    return vec4f(finished(sum / 4.0), 1.0);
}
