// Surfaces: albedo times E / pi, plus emission; and what passes them.

// What is known when the pipeline is made, so that nothing runs that a surface does not call for.
// Light: 0 of probes, 1 of a lightmap, 2 of one that knows directions.
override LIGHT: u32;
// What is shown: see `Mode`.
override SHOWN: u32;
override FOGGY: bool;
// Whether there are lamps that lightmaps lack.
override ADDED: bool;
override GLOWS: bool;
override PASSES: bool;
override METALS_BLACK: bool;
// Whether alpha cuts holes; without them depth is known before a pixel is shaded.
override CUT: bool;

struct Material {
    base: vec4f,
    // w: alpha below which nothing is there.
    glow: vec4f,
    // Transmission, metal, strength of normals; bits: 1 alpha blends, 2 not lit.
    other: vec4f,
}

@group(2) @binding(0) var<uniform> material: Material;
@group(2) @binding(1) var base_map: texture_2d<f32>;
@group(2) @binding(2) var glow_map: texture_2d<f32>;
@group(2) @binding(3) var pass_map: texture_2d<f32>;
@group(2) @binding(4) var metal_map: texture_2d<f32>;
@group(2) @binding(5) var normal_map: texture_2d<f32>;
@group(2) @binding(6) var base_sampler: sampler;
@group(2) @binding(7) var glow_sampler: sampler;
@group(2) @binding(8) var pass_sampler: sampler;
@group(2) @binding(9) var metal_sampler: sampler;
@group(2) @binding(10) var normal_sampler: sampler;

@group(3) @binding(0) var light_map: texture_2d<f32>;
@group(3) @binding(1) var direction_map: texture_2d_array<f32>;
@group(3) @binding(2) var figure_map: texture_2d<f32>;

struct In {
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) light: vec2f,
    @location(3) base: vec2f,
    @location(4) glow: vec2f,
    @location(5) pass_: vec2f,
    @location(6) metal: vec2f,
    @location(7) bumps: vec2f,
    @location(8) tint: vec4f,
}

struct Out {
    @builtin(position) clip: vec4f,
    @location(0) position: vec3f,
    @location(1) normal: vec3f,
    @location(2) light: vec2f,
    @location(3) base: vec2f,
    @location(4) glow: vec2f,
    @location(5) pass_: vec2f,
    @location(6) metal: vec2f,
    @location(7) bumps: vec2f,
    @location(8) tint: vec4f,
}

@vertex
fn vertex(in: In) -> Out {
    return Out(view.clip_from_world * vec4f(in.position, 1.0), in.position, in.normal, in.light, in.base, in.glow, in.pass_, in.metal, in.bumps, in.tint);
}

// The normal of the normal map, from how position and coordinates change from pixel to pixel: no tangents are needed.
fn bumped(n: vec3f, p: vec3f, uv: vec2f) -> vec3f {
    let px = dpdx(p);
    let py = dpdy(p);
    let ux = dpdx(uv);
    let uy = dpdy(uv);
    let texel = textureSample(normal_map, normal_sampler, uv).xyz * 2.0 - 1.0;
    let a = cross(py, n);
    let b = cross(n, px);
    // Gradients of u and v, times how large the pixel is; v grows downwards in glTF and the map's second axis upwards.
    let turn = select(-1.0, 1.0, 0.0 < dot(px, a));
    let t = turn * (a * ux.x + b * uy.x);
    let s = -turn * (a * ux.y + b * uy.y);
    let most = max(dot(t, t), dot(s, s));
    if !(0.0 < most) { return n; }
    let scale = inverseSqrt(most) * material.other.z;
    let m = t * (texel.x * scale) + s * (texel.y * scale) + n * texel.z;
    return select(n, normalize(m), 0.0 < dot(m, m));
}

// From blue for a part of 1 % by green and yellow for a tenth to red for all of it, on a logarithmic scale.
fn heat(part: f32) -> vec3f {
    let x = clamp(log(max(part, 1e-6) / 0.01) / log(100.0), 0.0, 1.0) * 4.0;
    let cold = mix(vec3f(0.02, 0.05, 0.4), vec3f(0.0, 0.35, 0.6), clamp(x, 0.0, 1.0));
    let middle = mix(cold, vec3f(0.05, 0.5, 0.1), clamp(x - 1.0, 0.0, 1.0));
    let warm = mix(middle, vec3f(0.9, 0.75, 0.05), clamp(x - 2.0, 0.0, 1.0));
    return mix(warm, vec3f(0.8, 0.02, 0.02), clamp(x - 3.0, 0.0, 1.0));
}

struct Shaded {
    // What the surface sends to the eye, times how much of it is there.
    own: vec3f,
    // What it leaves of light behind it.
    passes: vec3f,
    // Tone mapped where it is 1.
    tone: f32,
}

fn shade(in: Out, front: bool) -> Shaded {
    // Textures are read by all pixels alike, as their derivatives want it.
    let base = textureSample(base_map, base_sampler, in.base);
    var glow = vec3f(0.0);
    if GLOWS { glow = material.glow.rgb * textureSample(glow_map, glow_sampler, in.glow).rgb; }
    var passing = 0.0;
    if PASSES { passing = material.other.x * textureSample(pass_map, pass_sampler, in.pass_).r; }
    var metal = 0.0;
    if METALS_BLACK { metal = material.other.y * textureSample(metal_map, metal_sampler, in.metal).b; }
    let n = normalize(in.normal);
    var m = n;
    if LIGHT == 2u { m = bumped(n, in.position, in.bumps); }
    let size = vec2f(textureDimensions(light_map));
    let at = in.light * size;
    let wide = fwidth(at);

    let albedo_ = clamp(material.base * base * in.tint, vec4f(0.0), vec4f(1.0));
    if CUT && albedo_.a < material.glow.w { discard; }
    let bits = u32(material.other.w);
    let alpha = select(1.0, albedo_.a, (bits & 1u) != 0u);
    let albedo = albedo_.rgb * (1.0 - metal);

    let towards = select(-1.0, 1.0, front);
    var light = view.mean_light.rgb;
    if LIGHT == 0u || SHOWN == 5u {
        let step = 0.01 * view.probe_origin.w;
        if view.mean_light.w == 1.0 { light = probes(in.position + n * (towards * step), m * towards); }
    } else {
        light = textureSampleLevel(light_map, linear, in.light, 0.0).rgb;
    }
    if LIGHT == 2u && SHOWN != 5u {
        let turn = m - n;
        light += textureSampleLevel(direction_map, linear, in.light, 0, 0.0).rgb * turn.x
            + textureSampleLevel(direction_map, linear, in.light, 1, 0.0).rgb * turn.y
            + textureSampleLevel(direction_map, linear, in.light, 2, 0.0).rgb * turn.z;
        light = max(light, vec3f(0.0));
    }
    if ADDED && SHOWN == 0u { light += added(in.position, m * towards); }

    let tint = albedo_.rgb;
    if SHOWN == 0u {
        var own = albedo * light * (1.0 - passing) + glow;
        // What is not lit shows its colour as the tone curve would leave middle grey.
        if (bits & 2u) != 0u { own = albedo_.rgb * (0.18 / (view.tone.x * view.tone.y)); }
        return Shaded(own * view.tone.x * alpha, 1.0 - alpha + alpha * passing * tint, 1.0);
    }
    let there = alpha * (1.0 - passing);
    let rest = vec3f(1.0 - there);
    if SHOWN == 1u || SHOWN == 5u { return Shaded(light * view.tone.x * there, rest, 1.0); }
    if LIGHT == 0u { return Shaded(vec3f(0.02) * there, rest, 0.0); }
    let texel = vec2u(clamp(at, vec2f(0.0), size - 1.0));
    let odd = (texel.x + texel.y) % 2u == 1u;
    // Squares fade where they are smaller than pixels.
    let seen = 1.0 - smoothstep(0.3, 0.6, max(wide.x, wide.y));
    let square = select(1.0, 1.0 - 0.35 * seen, odd);
    if SHOWN == 2u {
        return Shaded(textureLoad(light_map, texel, 0).rgb * square * view.tone.x * there, rest, 1.0);
    }
    let figures = textureLoad(figure_map, texel, 0);
    if SHOWN == 3u { return Shaded(heat(figures.r) * there, rest, 0.0); }
    // Red was in something else and has been filled, blue belongs to no chart: the gutter.
    var shown = vec3f(0.25) * square;
    if figures.g <= 0.0 { shown = vec3f(0.05, 0.1, 0.8) * square; }
    if 0.0 < figures.b { shown = vec3f(0.8, 0.03, 0.03) * square; }
    return Shaded(shown * there, rest, 0.0);
}

fn ahead(p: vec3f) -> f32 {
    return max(dot(p - view.eye.xyz, view.forward.xyz), 0.0);
}

fn fogged(in: Out, s: Shaded) -> vec4f {
    if !FOGGY { return vec4f(s.own, s.tone); }
    let f = fog(in.clip.xy, ahead(in.position));
    // The fog in front is in the picture already, and what the surface takes of it is given back.
    return vec4f(s.own * f.passes + f.light * (1.0 - s.passes), s.tone);
}

@fragment
fn opaque(in: Out, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    var s = shade(in, front);
    s.passes = vec3f(0.0);
    return fogged(in, s);
}

// Multiplies what is behind.
@fragment
fn dim(in: Out, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    return vec4f(shade(in, front).passes, 1.0);
}

// Adds to it.
@fragment
fn add(in: Out, @builtin(front_facing) front: bool) -> @location(0) vec4f {
    return fogged(in, shade(in, front));
}
