#version 460
// image/normalize_fwd: (x - mean) / std per channel. One invocation per pixel.
//   in   x [n,4]
//   out  y [n,4] (=); fourth channel 0
//   twin kernels/src/reference/image/normalize.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; float mean_r, mean_g, mean_b, std_r, std_g, std_b; } p;
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec3 mean = vec3(p.mean_r, p.mean_g, p.mean_b);
    y[i] = vec4((texel_load(x, int(i)).rgb - mean) / vec3(p.std_r, p.std_g, p.std_b), 0.0);
}
