// Fog to the eye in froxels, cells of the view: what scatters towards the eye in each, then sums from the eye on
// ([Wro14]; energy over a slice as in [Hil15]).

// Of each froxel: what it sends to the eye where nothing passes it, and its optical depth.
@group(1) @binding(0) var source_out: texture_storage_3d<rgba32float, write>;
@group(1) @binding(1) var depth_out: texture_storage_3d<rgba32float, write>;

// Distance ahead at which slice k begins.
fn slice_start(k: f32) -> f32 {
    return select(0.0, view.slices.x * exp(view.slices.y * (k - 1.0)), 0.5 < k);
}

struct Ray {
    origin: vec3f,
    // Unit vector away from the eye, and metres along it for each metre ahead.
    direction: vec3f,
    stretch: f32,
}

fn ray(at: vec2u) -> Ray {
    let x = (vec2f(at) + 0.5 + vec2f(view.right.w, view.up.w)) / vec2f(view.froxels.xy) * vec2f(2.0, -2.0) + vec2f(-1.0, 1.0);
    let aside = view.right.xyz * x.x + view.up.xyz * x.y;
    let flat = view.eye.w;
    let d = view.forward.xyz + (1.0 - flat) * aside;
    let stretch = length(d);
    return Ray(view.eye.xyz + flat * aside, d / stretch, stretch);
}

// Light from the grid that a medium of mean cosine g sends against `d`.
fn grid_light(p: vec3f, d: vec3f, g: f32) -> vec3f {
    if view.grid_per_metre.w == 0.0 { return vec3f(0.0); }
    let node = clamp((p - view.grid_first.xyz) * view.grid_per_metre.xyz, vec3f(0.0), vec3f(view.grid_size.xyz - 1u));
    let texel = vec3f(node.xy + 0.5, node.z + 1.5);
    let size = vec3f(vec2f(view.grid_size.xy), 7.0 * f32(view.grid_size.w));
    let step = f32(view.grid_size.w) / size.z;
    let at = texel / size;
    let l0 = textureSampleLevel(grid, linear, at, 0.0);
    let l6 = textureSampleLevel(grid, linear, at + vec3f(0.0, 0.0, 6.0 * step), 0.0);
    var sum = 0.282095 * l0.rgb;
    if g != 0.0 {
        let l1 = textureSampleLevel(grid, linear, at + vec3f(0.0, 0.0, step), 0.0);
        let l2 = textureSampleLevel(grid, linear, at + vec3f(0.0, 0.0, 2.0 * step), 0.0);
        let l3 = textureSampleLevel(grid, linear, at + vec3f(0.0, 0.0, 3.0 * step), 0.0);
        let l4 = textureSampleLevel(grid, linear, at + vec3f(0.0, 0.0, 4.0 * step), 0.0);
        let l5 = textureSampleLevel(grid, linear, at + vec3f(0.0, 0.0, 5.0 * step), 0.0);
        sum += g * 0.488603 * (l1.rgb * d.y + l2.rgb * d.z + l3.rgb * d.x);
        sum += g * g * (1.092548 * (l4.rgb * d.x * d.y + l5.rgb * d.y * d.z + vec3f(l0.a, l1.a, l2.a) * d.x * d.z)
            + 0.315392 * l6.rgb * (3.0 * d.z * d.z - 1.0)
            + 0.546274 * vec3f(l3.a, l4.a, l5.a) * (d.x * d.x - d.y * d.y));
    }
    // Nodes in walls hold nothing and do not count.
    return max(vec3f(0.0), sum) / max(l6.a, 1e-3);
}

// Light straight from lamps that is scattered against `r.direction` between t0 and t1 metres from its origin.
fn lamp_light(r: Ray, t0: f32, t1: f32, g: f32) -> vec3f {
    var sum = vec3f(0.0);
    let every = on(FOG_LAMPS);
    for (var i = 0u; i < view.switches.x; i++) {
        let lamp = lamps[i];
        if !every && lamp.cone.z == 0.0 { continue; }
        var travels = lamp.direction.xyz;
        var distance = 1e9;
        var light = lamp.intensity.rgb;
        var p = r.origin + r.direction * mix(t0, t1, view.slices.z);
        if lamp.position.w != 2.0 {
            // The mean of 1 / r^2 over the way through the froxel ([KF12]), which is finite where the way does not meet the lamp;
            // the froxel is as wide as it is here.
            let o = lamp.position.xyz - r.origin;
            let middle = dot(o, r.direction);
            let wide = 0.3 * length(view.right.xyz) * mix(0.5 * (t0 + t1), 1.0, view.eye.w) / f32(view.froxels.x);
            let beside = max(length(o - middle * r.direction), max(wide, 1e-4 * (t1 - t0)));
            let a = atan((t0 - middle) / beside);
            let b = atan((t1 - middle) / beside);
            // Where it is as likely to be scattered as 1 / r^2 says.
            p = r.origin + r.direction * (middle + beside * tan(mix(a, b, view.slices.z)));
            let d = p - lamp.position.xyz;
            distance = max(length(d), 1e-6 * t1);
            travels = d / distance;
            light = candela(lamp, travels, distance) * (b - a) / (beside * (t1 - t0));
        }
        if all(light <= vec3f(0.0)) { continue; }
        let seen = lit(lamp, p);
        if seen <= 0.0 { continue; }
        sum += light * seen * exp(-optical_depth(p, -travels, distance)) * phase(-dot(travels, r.direction), g);
    }
    return sum;
}

@compute @workgroup_size(8, 8, 1)
fn scatter(@builtin(global_invocation_id) id: vec3u) {
    if any(view.froxels.xyz <= id) { return; }
    let r = ray(id.xy);
    let t0 = slice_start(f32(id.z)) * r.stretch;
    let t1 = slice_start(f32(id.z) + 1.0) * r.stretch;
    // Where media end inside of a froxel two places know more than one.
    let a = here(r.origin + r.direction * mix(t0, t1, 0.5 * view.slices.z));
    let b = here(r.origin + r.direction * mix(t0, t1, 0.5 + 0.5 * view.slices.z));
    let sigma_s = 0.5 * (a.sigma_s + b.sigma_s);
    let sigma_t = 0.5 * (a.sigma_t + b.sigma_t);
    var light = vec3f(0.0);
    if any(vec3f(0.0) < sigma_s) {
        // As heavy as what scatters there.
        let w = vec2f(dot(a.sigma_s, vec3f(1.0)), dot(b.sigma_s, vec3f(1.0)));
        let g = dot(w, vec2f(a.g, b.g)) / (w.x + w.y);
        let p = r.origin + r.direction * mix(t0, t1, view.slices.z);
        light = (grid_light(p, r.direction, g) + lamp_light(r, t0, t1, g)) * view.tone.x;
        light *= select(vec3f(0.0), sigma_s / sigma_t, vec3f(0.0) < sigma_t);
    }
    textureStore(source_out, id, vec4f(light, 0.0));
    textureStore(depth_out, id, vec4f(sigma_t * (t1 - t0), 0.0));
}

@group(2) @binding(0) var source: texture_3d<f32>;
@group(2) @binding(1) var depths: texture_3d<f32>;
@group(3) @binding(0) var light_out: texture_storage_3d<rgba16float, write>;
@group(3) @binding(1) var passing_out: texture_storage_3d<rgba16float, write>;

// Texel k of what goes out: what is scattered towards the eye before slice k begins, and what passes from there; the last is all the way.
@compute @workgroup_size(8, 8, 1)
fn accumulate(@builtin(global_invocation_id) id: vec3u) {
    if any(view.froxels.xy <= id.xy) { return; }
    let r = ray(id.xy);
    var light = vec3f(0.0);
    var passes = vec3f(1.0);
    var s = vec3f(0.0);
    for (var k = 0u; k < view.froxels.z; k++) {
        store(id.xy, k, light, passes);
        s = textureLoad(source, vec3u(id.xy, k), 0).rgb;
        let depth = textureLoad(depths, vec3u(id.xy, k), 0).rgb;
        light += passes * s * taken(depth);
        passes *= exp(-depth);
    }
    store(id.xy, view.froxels.z, light, passes);
    // Beyond the last slice are only media that have no end, lit as they are there.
    let last = slice_start(f32(view.froxels.z)) * r.stretch;
    let beyond = optical_depth(r.origin + r.direction * last, r.direction, 1e9);
    light += passes * s * taken(beyond);
    store(id.xy, view.froxels.z + 1u, light, passes * exp(-beyond));
}

fn store(at: vec2u, k: u32, light: vec3f, passes: vec3f) {
    textureStore(light_out, vec3u(at, k), vec4f(min(light, vec3f(6e4)), 1.0));
    textureStore(passing_out, vec3u(at, k), vec4f(passes, 1.0));
}

// What an optical depth takes of light, also where it is hardly more than nothing.
fn taken(depth: vec3f) -> vec3f {
    return select(1.0 - exp(-depth), depth * (1.0 - 0.5 * depth), depth < vec3f(1e-3));
}
