// The curve of preview.png: exposed light x becomes x (1 + x / 144) / (1 + x), then sRGB (IEC 61966-2-1).

fn curve(light: vec3f) -> vec3f {
    let x = clamp(light, vec3f(0.0), vec3f(12.0));
    return x * (1.0 + x / 144.0) / (1.0 + x);
}

fn encoded(y: vec3f) -> vec3f {
    return select(1.055 * pow(y, vec3f(1.0 / 2.4)) - 0.055, 12.92 * y, y <= vec3f(0.0031308));
}

@vertex
fn vertex(@builtin(vertex_index) i: u32) -> @builtin(position) vec4f {
    return vec4f(select(-1.0, 3.0, i == 1u), select(-1.0, 3.0, i == 2u), 0.0, 1.0);
}

// Figures (alpha 0) are shown as they are; radiance has no curve, where it is asked for.
fn linear_of(c: vec4f) -> vec3f {
    if view.tone.w == 1.0 { return c.rgb * select(1.0, view.tone.y, 0.5 < c.a); }
    return select(clamp(c.rgb, vec3f(0.0), vec3f(1.0)), curve(c.rgb * view.tone.y), 0.5 < c.a);
}

fn finished(y: vec3f) -> vec3f {
    return select(y, encoded(y), view.tone.z == 1.0);
}
