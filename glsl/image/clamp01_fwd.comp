#version 460
// image/clamp01_fwd: clamps colour to [0, 1]; NaN stays NaN. One invocation per pixel.
//   in   x [n,4]
//   out  y [n,4] (=); the fourth channel is copied
//   twin kernels/src/reference/image/clamp01.rs
#include "lib/grid.glsl"
#include "lib/clamp01.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; } p;
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec4 v = texel_load(x, int(i));
    y[i] = vec4(clamp01(v.rgb), v.a);
}
