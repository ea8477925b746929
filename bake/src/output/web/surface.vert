#version 300 es
// Places a vertex and hands over texture coordinates.
uniform mat4 clip_from_mesh;
layout(location = 0) in vec3 position;
layout(location = 1) in vec2 light_uv;
layout(location = 2) in vec2 base_uv;
layout(location = 3) in vec2 glow_uv;
layout(location = 4) in vec4 tint;
layout(location = 5) in vec2 through_uv;
out vec2 v_light_uv;
out vec2 v_base_uv;
out vec2 v_glow_uv;
out vec4 v_tint;
out vec2 v_through_uv;

void main() {
    v_light_uv = light_uv;
    v_base_uv = base_uv;
    v_glow_uv = glow_uv;
    v_tint = tint;
    v_through_uv = through_uv;
    gl_Position = clip_from_mesh * vec4(position, 1.0);
}
