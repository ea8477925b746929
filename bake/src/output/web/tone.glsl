#version 300 es
precision highp float;
precision highp sampler2D;
uniform float exposure;

// The curve of preview.png: exposed light x becomes x (1 + x / 144) / (1 + x), then sRGB (IEC 61966-2-1).
vec3 tone_map(vec3 light) {
    vec3 x = min(max(light * exposure, 0.0), 12.0);
    vec3 y = x * (1.0 + x / 144.0) / (1.0 + x);
    vec3 curve = 1.055 * pow(y, vec3(1.0 / 2.4)) - 0.055;
    return mix(curve, 12.92 * y, vec3(lessThanEqual(y, vec3(0.0031308))));
}
