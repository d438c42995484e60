#version 460
// image/clamp01_bwd: lets the gradient pass where 0 <= x <= 1. One invocation per pixel.
//   in   x [n,4] before the clamp   v_y [n,4]
//   out  v_x [n,4] (=); fourth channel 0
//   twin kernels/src/reference/image/clamp01.rs
#include "lib/grid.glsl"
#include "lib/clamp01.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; } p;
TEXELS_F32(0, x);
TEXELS_F32(1, v_y);
layout(set = 0, binding = 2) writeonly buffer VX { vec4 v_x[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    v_x[i] = vec4(clamp01_gate(texel_load(x, int(i)).rgb, texel_load(v_y, int(i)).rgb), 0.0);
}
