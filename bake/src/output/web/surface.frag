// What a surface sends to the eye: albedo times E / pi, plus emission; and what passes it.
uniform sampler2D light_map;
uniform sampler2D base_map;
uniform sampler2D glow_map;
uniform vec4 base;
uniform vec3 glow;
uniform vec3 mean_light;
uniform float light_scale;
uniform bool has_texels;
uniform float cutoff;
uniform sampler2D through_map;
// Part of the light that passes straight through.
uniform float through;
uniform bool blend;
uniform int mode;
// 0: an opaque surface; of one that light passes, 1 is what passes, 2 what it sends itself.
uniform int part;
in vec2 v_light_uv;
in vec2 v_base_uv;
in vec2 v_glow_uv;
in vec4 v_tint;
in vec2 v_through_uv;
out vec4 color;

// The texel itself, in squares of two shades that fade where they are smaller than pixels.
vec3 texel() {
    vec2 size = vec2(textureSize(light_map, 0));
    vec2 at = v_light_uv * size;
    vec2 width = fwidth(at);
    float seen = 1.0 - smoothstep(0.3, 0.6, max(width.x, width.y));
    ivec2 i = ivec2(clamp(at, vec2(0.0), size - 1.0));
    float shade = (i.x + i.y) % 2 == 0 ? 1.0 : 1.0 - 0.35 * seen;
    return tone_map(texelFetch(light_map, i, 0).rgb * light_scale) * shade;
}

void main() {
    vec4 albedo = clamp(base * texture(base_map, v_base_uv) * v_tint, 0.0, 1.0);
    vec3 emission = glow * texture(glow_map, v_glow_uv).rgb;
    if (albedo.a < cutoff) {
        discard;
    }
    vec3 light = has_texels ? texture(light_map, v_light_uv).rgb * light_scale : mean_light;
    float alpha = blend ? albedo.a : 1.0;
    float passing = through * texture(through_map, v_through_uv).r;
    if (part == 1) {
        // Multiplies what is curved like sRGB already.
        vec3 tint = mode == 0 ? pow(albedo.rgb, vec3(1.0 / 2.2)) : vec3(1.0);
        color = vec4(1.0 - alpha + alpha * passing * tint, 1.0);
        return;
    }
    vec3 shown = tone_map(mode == 0 ? albedo.rgb * light * (1.0 - passing) + emission : light);
    if (mode == 2 && has_texels) {
        shown = texel();
    }
    color = vec4(shown * alpha * (mode == 0 ? 1.0 : 1.0 - passing), 1.0);
}
