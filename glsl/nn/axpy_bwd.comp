#version 460
// nn/axpy_bwd: gradient to delta of nn/axpy_fwd; the gradient to x is v_y itself. One invocation per texel.
//   in   v_y [n,4]
//   out  v_delta [n,4] (=)
//   twin kernels/src/reference/nn/axpy.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; float scale; } p;
TEXELS_F32(0, v_y);
layout(set = 0, binding = 1) writeonly buffer VDelta { vec4 v_delta[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    v_delta[i] = p.scale * texel_load(v_y, int(i));
}
