#version 460
// nn/conv3d_reduce: sums the partial weight gradients of nn/conv3d_correlate in chunk order. One invocation per texel.
//   in   partial [chunks, stride, 4]
//   out  v_weight [texels, 4] (=), or (+=) with ACCUMULATE; texels <= stride drops the bias
//   twin kernels/src/reference/nn/conv3d.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint ACCUMULATE = 0;
layout(push_constant) uniform Params { uint texels, stride, chunks; } p;
TEXELS_F32(0, partial);
layout(set = 0, binding = 1) buffer VWeight { vec4 v_weight[]; };

void main() {
    uint i = global_index();
    if (i >= p.texels) return;
    vec4 sum = vec4(0.0);
    uint chunk = 0;
    do {
        sum += texel_load(partial, int(chunk * p.stride + i));
        chunk++;
    } while (chunk < p.chunks);
    if (ACCUMULATE != 0) sum += v_weight[i];
    v_weight[i] = sum;
}
