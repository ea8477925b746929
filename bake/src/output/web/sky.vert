#version 300 es
// A triangle behind everything; directions into the scene at its corners.
uniform mat3 world_from_clip;
out vec3 v_direction;

void main() {
    vec2 at = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
    v_direction = world_from_clip * vec3(at, 1.0);
    gl_Position = vec4(at, 1.0, 1.0);
}
