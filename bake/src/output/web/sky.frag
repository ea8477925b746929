// A sky that is linear in the sine of elevation.
uniform vec3 zenith;
uniform vec3 horizon;
uniform vec3 ground;
in vec3 v_direction;
out vec4 color;

void main() {
    float sine = normalize(v_direction).y;
    color = vec4(tone_map(mix(horizon, sine < 0.0 ? ground : zenith, abs(sine))), 1.0);
}
