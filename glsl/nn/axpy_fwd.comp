#version 460
// nn/axpy_fwd: y = x + scale * delta. One invocation per texel.
//   in   x [n,4]   delta [n,4]
//   out  y [n,4] (=)
//   twin kernels/src/reference/nn/axpy.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; float scale; } p;
TEXELS_F32(0, x);
TEXELS_F32(1, delta);
layout(set = 0, binding = 2) writeonly buffer Y { vec4 y[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    y[i] = texel_load(x, int(i)) + p.scale * texel_load(delta, int(i));
}
