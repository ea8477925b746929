// What every shader knows. Lengths are metres from the middle of the scene, light is in nits unless it says otherwise.

struct View {
    clip_from_world: mat4x4f,
    // w: 1 for parallel cameras, else 0.
    eye: vec4f,
    // To the right and the upper edge of the picture, at distance 1 ahead. w: by how much froxels are shifted, in froxels.
    right: vec4f,
    up: vec4f,
    // w: distance of the last slice of fog.
    forward: vec4f,
    // w: 0 a gradient, 1 an image.
    zenith: vec4f,
    horizon: vec4f,
    ground: vec4f,
    // Quaternion from the world to the space of the image.
    sky_turn: vec4f,
    // Where nothing is known of the light. w: 1 where there are probes.
    mean_light: vec4f,
    grid_first: vec4f,
    // w: 1 where there is a grid.
    grid_per_metre: vec4f,
    // w: slices of a block.
    grid_size: vec4u,
    // w: side of the smallest cells.
    probe_origin: vec4f,
    probe_size: vec4u,
    // Where bricks and occlusions begin.
    probe_offsets: vec4u,
    // Froxels along x, y and z; w: media.
    froxels: vec4u,
    // Distance of the first slice's end; ln(last / first) / slices; where in a slice light is asked for, 0 to 1; spare.
    slices: vec4f,
    // Lamps; what is shown; bits: 1 fog, 2 lamps are added to fog; spare.
    switches: vec4u,
    // What radiance is multiplied by in the picture; what the picture is multiplied by before tone mapping; 1: encode
    // as sRGB; 1: without the tone curve.
    tone: vec4f,
    // Pixels, and one over them.
    size: vec4f,
}

struct Lamp {
    // w: 0 point, 1 spot, 2 sun.
    position: vec4f,
    // w: range, 0 without one.
    direction: vec4f,
    // Candela, lux for suns. w: first layer of its shadow map, negative without one.
    intensity: vec4f,
    // Scale and offset of the cone's cosine; 1 where lightmaps lack it; 1 where its shadow map is a cube.
    cone: vec4f,
    // How wide a texel of its shadow map is: metres, and for each metre from the lamp.
    texel: vec4f,
}

// An affine map as three rows.
struct Map {
    x: vec4f,
    y: vec4f,
    z: vec4f,
}

struct Medium {
    // w: mean cosine.
    sigma_s: vec4f,
    // w: bits: 1 in a cube, 2 falls with height, 4 has a texture.
    sigma_a: vec4f,
    cube: Map,
    texture: Map,
    // Base and falloff.
    height: vec4f,
    // Texels, and the first of them in the atlas.
    size: vec4u,
    first: vec4u,
}

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> lamps: array<Lamp>;
@group(0) @binding(2) var<storage, read> media: array<Medium>;
@group(0) @binding(3) var grid: texture_3d<f32>;
@group(0) @binding(4) var densities: texture_3d<f32>;
@group(0) @binding(5) var linear: sampler;
@group(0) @binding(6) var shadows: texture_depth_2d_array;
@group(0) @binding(7) var nearer: sampler_comparison;
@group(0) @binding(8) var<storage, read> shadow_from_world: array<mat4x4f>;
@group(0) @binding(9) var<storage, read> probe_words: array<u32>;
@group(0) @binding(10) var<storage, read> probe_light: array<f32>;
@group(0) @binding(11) var sky_image: texture_2d<f32>;

const PI: f32 = 3.14159265;
const FOG: u32 = 1u;
const FOG_LAMPS: u32 = 2u;

fn on(bit: u32) -> bool {
    return (view.switches.z & bit) != 0u;
}

fn through(m: Map, p: vec3f) -> vec3f {
    let q = vec4f(p, 1.0);
    return vec3f(dot(m.x, q), dot(m.y, q), dot(m.z, q));
}

// ---- Sky

fn sky(d: vec3f) -> vec3f {
    if view.zenith.w == 1.0 {
        let q = view.sky_turn;
        let s = d + 2.0 * cross(q.xyz, cross(q.xyz, d) + q.w * d);
        let uv = vec2f(0.5 + atan2(s.x, -s.z) / (2.0 * PI), acos(clamp(s.y, -1.0, 1.0)) / PI);
        return textureSampleLevel(sky_image, linear, uv, 0.0).rgb;
    }
    return mix(view.horizon.rgb, select(view.zenith.rgb, view.ground.rgb, d.y < 0.0), abs(d.y));
}

// ---- Lamps

// What reaches a place at distance r from a lamp in the direction `travels`, times r squared: candela.
fn candela(lamp: Lamp, travels: vec3f, r: f32) -> vec3f {
    var part = 1.0;
    if lamp.position.w == 1.0 {
        let a = clamp(dot(travels, lamp.direction.xyz) * lamp.cone.x + lamp.cone.y, 0.0, 1.0);
        part = a * a;
    }
    if 0.0 < lamp.direction.w {
        let x = r / lamp.direction.w;
        part *= clamp(1.0 - x * x * x * x, 0.0, 1.0);
    }
    return lamp.intensity.rgb * part;
}

// Which part of a lamp's light is not stopped by surfaces on its way to `p`.
fn lit(lamp: Lamp, p: vec3f) -> f32 {
    var layer = i32(lamp.intensity.w);
    // Rather dark than through walls.
    if layer < 0 { return 0.0; }
    if lamp.cone.w == 1.0 {
        // The face of the cube: +x, -x, +y, -y, +z, -z.
        let d = p - lamp.position.xyz;
        let a = abs(d);
        if a.y <= a.x && a.z <= a.x { layer += select(0, 1, d.x < 0.0); }
        else if a.z <= a.y { layer += select(2, 3, d.y < 0.0); }
        else { layer += select(4, 5, d.z < 0.0); }
    }
    let q = shadow_from_world[layer] * vec4f(p, 1.0);
    let s = q.xyz / q.w;
    // Beside the map of a spot or a sun there is nothing of the scene; behind it its shadow goes on.
    if lamp.cone.w != 1.0 && (q.w <= 0.0 || 1.0 < max(abs(s.x), abs(s.y))) { return 1.0; }
    let uv = vec2f(0.5, -0.5) * s.xy + 0.5;
    return textureSampleCompareLevel(shadows, nearer, uv, layer, clamp(s.z, 0.0, 1.0));
}

// ---- Media

// Coefficients at a place, per metre, and the mean cosine.
struct Here {
    sigma_s: vec3f,
    sigma_t: vec3f,
    g: f32,
}

// In units of the falloff, as far as exponentials can be told from 0 and infinity, also times any length.
fn height(m: Medium, y: f32) -> f32 {
    return clamp((y - m.height.x) / m.height.y, -60.0, 60.0);
}

fn density(m: Medium, p: vec3f) -> f32 {
    let bits = u32(m.sigma_a.w);
    var d = 1.0;
    if (bits & 1u) != 0u {
        let u = through(m.cube, p);
        if any(u < vec3f(0.0)) || any(vec3f(1.0) < u) { return 0.0; }
    }
    if (bits & 2u) != 0u {
        d *= exp(-height(m, p.y));
    }
    if (bits & 4u) != 0u {
        let u = through(m.texture, p);
        if any(u < vec3f(0.0)) || any(vec3f(1.0) < u) { return 0.0; }
        let size = vec3f(m.size.xyz);
        let texel = clamp(u * size, vec3f(0.5), size - 0.5) + vec3f(m.first.xyz);
        d *= textureSampleLevel(densities, linear, texel / vec3f(textureDimensions(densities)), 0.0).r;
    }
    return d;
}

fn here(p: vec3f) -> Here {
    var h = Here(vec3f(0.0), vec3f(0.0), 0.0);
    var weight = 0.0;
    for (var i = 0u; i < view.froxels.w; i++) {
        let d = density(media[i], p);
        if d <= 0.0 { continue; }
        let s = media[i].sigma_s.rgb * d;
        h.sigma_s += s;
        h.sigma_t += s + media[i].sigma_a.rgb * d;
        // Weighed by what scatters, as in the bake.
        let w = dot(s, vec3f(1.0));
        h.g += w * media[i].sigma_s.w;
        weight += w;
    }
    h.g = select(0.0, h.g / weight, 0.0 < weight);
    return h;
}

// Optical depth from `p` over `length` metres along the unit vector `d`.
fn optical_depth(p: vec3f, d: vec3f, length: f32) -> vec3f {
    var sum = vec3f(0.0);
    for (var i = 0u; i < view.froxels.w; i++) {
        let m = media[i];
        let bits = u32(m.sigma_a.w);
        var t0 = 0.0;
        var t1 = length;
        if (bits & 1u) != 0u {
            let span = slab(m.cube, p, d);
            t0 = max(t0, span.x);
            t1 = min(t1, span.y);
        }
        if (bits & 4u) != 0u {
            let span = slab(m.texture, p, d);
            t0 = max(t0, span.x);
            t1 = min(t1, span.y);
        }
        if t1 <= t0 { continue; }
        var mass = 0.0;
        if (bits & 4u) != 0u {
            for (var k = 0u; k < 8u; k++) {
                mass += density(m, p + d * mix(t0, t1, (f32(k) + 0.5) / 8.0)) * (t1 - t0) / 8.0;
            }
        } else if (bits & 2u) != 0u {
            // The integral of exp(-height) over the way, which is level or goes from one height to another.
            let h0 = height(m, p.y + t0 * d.y);
            let h1 = height(m, p.y + t1 * d.y);
            let climbs = d.y * (t1 - t0) / m.height.y;
            let level = (t1 - t0) * exp(-0.5 * (h0 + h1));
            mass = select((exp(-h0) - exp(-h1)) / climbs * (t1 - t0), level, abs(h1 - h0) < 1e-3);
        } else {
            mass = t1 - t0;
        }
        sum += (m.sigma_s.rgb + m.sigma_a.rgb) * mass;
    }
    return sum;
}

// Where a ray is inside of the cube [0, 1]^3 of a map.
fn slab(m: Map, p: vec3f, d: vec3f) -> vec2f {
    let o = through(m, p);
    let r = vec3f(dot(m.x.xyz, d), dot(m.y.xyz, d), dot(m.z.xyz, d));
    let inverse = 1.0 / select(r, vec3f(1e-20), abs(r) < vec3f(1e-20));
    let a = -o * inverse;
    let b = (1.0 - o) * inverse;
    let near = min(a, b);
    let far = max(a, b);
    return vec2f(max(near.x, max(near.y, near.z)), min(far.x, min(far.y, far.z)));
}

// Henyey-Greenstein, per steradian.
fn phase(cosine: f32, g: f32) -> f32 {
    let b = 1.0 + g * g - 2.0 * g * cosine;
    return (1.0 - g * g) / (4.0 * PI * b * sqrt(b));
}

// ---- Probes: the look-up of `tables::probes`

// E / pi at `p` for the normal `n`.
fn probes(p: vec3f, n: vec3f) -> vec3f {
    let spacing = view.probe_origin.w;
    let size = view.probe_size.xyz;
    let inside = p - view.probe_origin.xyz;
    let at = clamp(inside / spacing, vec3f(0.0), vec3f(4u * size));
    let b = min(vec3u(at / 4.0), size - 1u);
    let brick = probe_words[(b.z * size.y + b.y) * size.x + b.x];
    if brick == 0xffffffffu { return view.mean_light.rgb; }
    let base = view.probe_offsets.x + brick * 193u;
    let corner = vec3f(f32(probe_words[base]), f32(probe_words[base + 1u]), f32(probe_words[base + 2u]));
    let local = (at - corner) / f32(1u << probe_words[base + 3u]);
    let cell = min(vec3u(local), vec3u(3u));
    let part = clamp(local - vec3f(cell), vec3f(0.0), vec3f(1.0));
    let occlusion = probe_words[base + 129u + (cell.z * 4u + cell.y) * 4u + cell.x];
    let walls = view.probe_offsets.y + occlusion * 64u;
    var region = 0u;
    if occlusion != 0xffffffffu {
        for (var k = 0u; k < 4u; k++) {
            let o = walls + 4u * k;
            let plane = vec4f(bitcast<f32>(probe_words[o]), bitcast<f32>(probe_words[o + 1u]),
                bitcast<f32>(probe_words[o + 2u]), bitcast<f32>(probe_words[o + 3u]));
            region |= select(0u, 1u, plane.w < dot(plane.xyz, inside)) << k;
        }
        let own = probe_words[walls + 48u + region];
        if own != 0xffffffffu { return irradiance(own, n); }
    }
    var sum = vec3f(0.0);
    var weights = 0.0;
    for (var k = 0u; k < 8u; k++) {
        let far = vec3u(k & 1u, (k >> 1u) & 1u, k >> 2u);
        let side = select(1.0 - part, part, far == vec3u(1u));
        var w = side.x * side.y * side.z;
        if occlusion != 0xffffffffu {
            let bytes = probe_words[walls + 16u + region * 2u + k / 4u];
            w = max(w, 1e-4) * f32((bytes >> (8u * (k % 4u))) & 255u);
        }
        if 0.0 < w {
            let node = cell + far;
            sum += w * irradiance(probe_words[base + 4u + (node.z * 5u + node.y) * 5u + node.x], n);
            weights += w;
        }
    }
    return sum / max(weights, 1e-6);
}

fn irradiance(probe: u32, n: vec3f) -> vec3f {
    var y = array<f32, 9>(0.282095, 0.325735 * n.y, 0.325735 * n.z, 0.325735 * n.x, 0.273137 * n.x * n.y,
        0.273137 * n.y * n.z, 0.078848 * (3.0 * n.z * n.z - 1.0), 0.273137 * n.x * n.z,
        0.136569 * (n.x * n.x - n.y * n.y));
    var sum = vec3f(0.0);
    for (var i = 0u; i < 9u; i++) {
        let o = probe * 27u + 3u * i;
        sum += y[i] * vec3f(probe_light[o], probe_light[o + 1u], probe_light[o + 2u]);
    }
    return max(vec3f(0.0), sum);
}

// E / pi of the lamps that lightmaps and probes lack, on a surface at `p` that faces `n`.
fn added(p: vec3f, n: vec3f) -> vec3f {
    var sum = vec3f(0.0);
    for (var i = 0u; i < view.switches.x; i++) {
        let lamp = lamps[i];
        if lamp.cone.z == 0.0 { continue; }
        var travels = lamp.direction.xyz;
        var r = 1e9;
        var light = lamp.intensity.rgb;
        if lamp.position.w != 2.0 {
            let d = p - lamp.position.xyz;
            r = length(d);
            travels = d / max(r, 1e-20);
            light = candela(lamp, travels, r) / max(r * r, 1e-20);
        }
        let cosine = -dot(travels, n);
        if cosine <= 0.0 || all(light <= vec3f(0.0)) { continue; }
        // A texel of the map knows one depth for all of its surface: what is asked for lies in front of that.
        let wide = lamp.texel.x + lamp.texel.y * r;
        light *= lit(lamp, p + n * (1.5 * wide)) * cosine / PI;
        light *= exp(-optical_depth(p, -travels, r));
        sum += light;
    }
    return sum;
}
