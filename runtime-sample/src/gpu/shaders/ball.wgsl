// Spheres: moving objects that are lit by probes, and probes themselves.

struct In {
    // Of the unit sphere.
    @location(0) normal: vec3f,
    // w: radius.
    @location(1) place: vec4f,
    // w: 0 lit where it is; from 1 on the probe of this number less 1 alone.
    @location(2) albedo: vec4f,
}

struct Out {
    @builtin(position) clip: vec4f,
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) @interpolate(flat) albedo: vec4f,
}

@vertex
fn vertex(in: In) -> Out {
    let p = in.place.xyz + in.place.w * in.normal;
    return Out(view.clip_from_world * vec4f(p, 1.0), p, in.normal, in.albedo);
}

@fragment
fn fragment(in: Out) -> @location(0) vec4f {
    let n = normalize(in.normal);
    var light = view.mean_light.rgb;
    if 1.0 <= in.albedo.w {
        light = irradiance(u32(in.albedo.w) - 1u, n);
    } else {
        if view.mean_light.w == 1.0 { light = probes(in.position + n * (0.01 * view.probe_origin.w), n); }
        if view.switches.y == 0u { light += added(in.position, n); }
    }
    let own = in.albedo.rgb * light * view.tone.x;
    // Among figures there is no light to be seen.
    if 2u <= view.switches.y && view.switches.y <= 4u && in.albedo.w < 1.0 { return vec4f(vec3f(0.5), 0.0); }
    if view.switches.y != 0u { return vec4f(own, 1.0); }
    let f = fog(in.clip.xy, max(dot(in.position - view.eye.xyz, view.forward.xyz), 0.0));
    return vec4f(own * f.passes + f.light, 1.0);
}
