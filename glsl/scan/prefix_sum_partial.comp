#version 460
// scan/prefix_sum_partial: sum of each lane's contiguous chunk. First of three passes.
//   in   data [n, padded to 4]
//   out  sums [lanes] (=)   a lane owns `chunk` texels
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, chunk; } p;
TEXELS_U32(0, data);
layout(set = 0, binding = 1) buffer Sums { uint sums[]; };

void main() {
    uint lane = global_index();
    uint texel = lane * p.chunk, end = texel + p.chunk, sum = 0u;
    do {
        uvec4 v = texel_load(data, int(min(texel, (p.n - 1u) / 4u)));
        uint i = 4u * texel;
        sum += (i < p.n ? v.x : 0u) + (i + 1u < p.n ? v.y : 0u) + (i + 2u < p.n ? v.z : 0u) + (i + 3u < p.n ? v.w : 0u);
        ++texel;
    } while (texel < end);
    sums[lane] = sum;
}
