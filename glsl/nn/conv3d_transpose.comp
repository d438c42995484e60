#version 460
// nn/conv3d_transpose: weights for nn/conv3d_bwd. One invocation per output texel.
//   in   weight [27,Ci/4,Co,4]
//   out  weight_t [27,Co/4,Ci,4] (=)
//   twin kernels/src/reference/nn/conv3d.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint in_channels, out_channels; } p;
TEXELS_F32(0, weight);
layout(set = 0, binding = 1) writeonly buffer WeightT { vec4 weight_t[]; };

void main() {
    uint i = global_index();
    uint texels = p.in_channels * p.out_channels / 4;
    if (i >= 27 * texels) return;
    uint tap = i / texels;
    uint co = i % texels / p.in_channels * 4;
    uint ci = i % p.in_channels;
    uint at = ((tap * p.in_channels / 4 + ci / 4) * p.out_channels + co) * 4 + ci % 4;
    weight_t[i] = vec4(texel_pick(weight, at), texel_pick(weight, at + 4), texel_pick(weight, at + 8),
                       texel_pick(weight, at + 12));
}
