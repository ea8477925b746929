// A triangle behind everything.

struct Out {
    @builtin(position) position: vec4f,
    @location(0) at: vec2f,
}

@vertex
fn vertex(@builtin(vertex_index) i: u32) -> Out {
    let at = vec2f(select(-1.0, 3.0, i == 1u), select(-1.0, 3.0, i == 2u));
    return Out(vec4f(at, 0.0, 1.0), at);
}

@fragment
fn fragment(in: Out) -> @location(0) vec4f {
    if view.switches.y != 0u { return vec4f(0.06, 0.06, 0.07, 0.0); }
    let aside = view.right.xyz * in.at.x + view.up.xyz * in.at.y;
    let d = normalize(view.forward.xyz + (1.0 - view.eye.w) * aside);
    let f = fog(in.position.xy, -1.0);
    return vec4f(sky(d) * view.tone.x * f.passes + f.light, 1.0);
}
