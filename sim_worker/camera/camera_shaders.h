#pragma once

// GLSL 3.30 of the camera. One program draws everything; `mode` chooses between object ids and
// light.

namespace omentum {

inline constexpr const char* kVertexShader = R"glsl(#version 330 core
layout(location = 0) in vec3 position;   // in W [m]
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 texture_point;
uniform mat4 projection_from_world;
out vec3 world_position;
out vec3 world_normal;
out vec3 material_point;
void main() {
  world_position = position;
  world_normal = normal;
  material_point = texture_point;
  gl_Position = projection_from_world * vec4(position, 1.0);
}
)glsl";

inline constexpr const char* kFragmentShader = R"glsl(#version 330 core
in vec3 world_position;
in vec3 world_normal;
in vec3 material_point;
uniform int object_id;     // ObjectId
uniform bool shaded;
uniform vec3 eye;          // camera position in W [m]
uniform vec3 side_light;   // unit, towards the second light
out vec4 colour;

// Value noise of a lattice hash: smooth, zero mean, about [-1, 1].
float hash(vec3 cell) {
  cell = fract(cell * 0.3183099 + vec3(0.11, 0.17, 0.13));
  cell *= 17.0;
  return fract(cell.x * cell.y * cell.z * (cell.x + cell.y + cell.z));
}
float noise(vec3 p) {
  vec3 cell = floor(p);
  vec3 f = fract(p);
  f = f * f * (3.0 - 2.0 * f);
  vec4 near_side = vec4(hash(cell), hash(cell + vec3(1, 0, 0)), hash(cell + vec3(0, 1, 0)),
                        hash(cell + vec3(1, 1, 0)));
  vec4 far_side = vec4(hash(cell + vec3(0, 0, 1)), hash(cell + vec3(1, 0, 1)),
                       hash(cell + vec3(0, 1, 1)), hash(cell + vec3(1, 1, 1)));
  vec4 across = mix(near_side, far_side, f.z);
  vec2 line = mix(across.xz, across.yw, f.x);
  return 2.0 * mix(line.x, line.y, f.y) - 1.0;
}
float mottle(vec3 p) { return 0.6 * noise(p) + 0.3 * noise(2.1 * p) + 0.1 * noise(4.3 * p); }

struct Material {
  vec3 albedo;    // linear
  float gloss;    // strength of the highlight
  float tight;    // exponent of the highlight
  float wrap;     // light that bleeds around the edge of shade, as in flesh
};

Material material_of(int id) {
  if (id == 1) {  // board: pale checks of 10 mm
    vec2 square = floor(world_position.xy / 0.010 + 0.5);
    float check = mod(square.x + square.y, 2.0);
    return Material(mix(vec3(0.16, 0.19, 0.22), vec3(0.23, 0.26, 0.29), check), 0.05, 12.0, 0.1);
  }
  if (id == 2) {  // organ: kidney brown-red
    float m = mottle(material_point / 0.006);
    return Material(vec3(0.36, 0.075, 0.065) * (1.0 + 0.25 * m), 0.45, 50.0, 0.25);
  }
  if (id == 3) {  // tumour: green, as in the paper's pictures, muted
    float m = mottle(material_point / 0.003);
    return Material(vec3(0.17, 0.42, 0.17) * (1.0 + 0.22 * m), 0.40, 45.0, 0.25);
  }
  if (id == 4) {  // fat: warm yellow with lobules
    float m = mottle(material_point / 0.005);
    return Material(vec3(0.82, 0.54, 0.16) * (1.0 + 0.16 * m), 0.30, 38.0, 0.35);
  }
  if (id == 5) return Material(vec3(0.34, 0.36, 0.39), 0.9, 60.0, 0.0);  // tool: steel
  return Material(vec3(0.25, 0.18, 0.34), 0.2, 20.0, 0.1);               // obstacle
}

void main() {
  if (!shaded) {
    colour = vec4(float(object_id) / 255.0, 0.0, 0.0, 1.0);
    return;
  }
  Material material = material_of(object_id);
  vec3 to_eye = normalize(eye - world_position);
  vec3 n = normalize(world_normal);
  if (dot(n, to_eye) < 0.0) n = -n;  // two-sided
  // A headlight that weakens with distance and a weaker light from the side, so that shape shows.
  float distance_to_eye = length(eye - world_position);
  float headlight = 1.9 * pow(0.25 / max(distance_to_eye, 0.05), 1.2);
  float facing = max((dot(n, to_eye) + material.wrap) / (1.0 + material.wrap), 0.0);
  float beside = max((dot(n, side_light) + material.wrap) / (1.0 + material.wrap), 0.0);
  vec3 light = vec3(1.0, 0.97, 0.92) * headlight * 0.46 * facing +
               vec3(0.92, 0.96, 1.0) * 0.42 * beside + vec3(0.06);
  vec3 half_way = normalize(to_eye + normalize(to_eye + 0.35 * side_light));
  float highlight = material.gloss * pow(max(dot(n, half_way), 0.0), material.tight) +
                    0.4 * material.gloss *
                        pow(max(dot(n, normalize(to_eye + side_light)), 0.0), material.tight);
  vec3 lit = material.albedo * light + vec3(highlight * 0.55);
  lit = lit / (1.0 + 0.25 * lit);                 // soft shoulder instead of clipping
  colour = vec4(pow(clamp(lit, 0.0, 1.0), vec3(1.0 / 2.2)), 1.0);
}
)glsl";

}  // namespace omentum
