#version 460
// image/normalize_bwd: gradient of image/normalize_fwd. One invocation per pixel.
//   in   v_y [n,4]
//   out  v_x [n,4] (=); fourth channel 0
//   twin kernels/src/reference/image/normalize.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; float std_r, std_g, std_b; } p;
TEXELS_F32(0, v_y);
layout(set = 0, binding = 1) writeonly buffer VX { vec4 v_x[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    v_x[i] = vec4(texel_load(v_y, int(i)).rgb / vec3(p.std_r, p.std_g, p.std_b), 0.0);
}
