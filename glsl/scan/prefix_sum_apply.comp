#version 460
// scan/prefix_sum_apply: exclusive sum in place, from each chunk's start value. Last of three passes.
//   in   starts [lanes, padded to 4]   before [n, padded to 4], the same memory as data: a lane reads a texel, then
//     writes it
//   out  data [n, padded to 4] (=), element n receives the total
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, chunk; } p;
TEXELS_U32(0, starts);
TEXELS_U32(1, before);
layout(set = 0, binding = 2) buffer Data { uvec4 data[]; };

void main() {
    uint lane = global_index();
    uint texel = lane * p.chunk, end = min(texel + p.chunk, p.n / 4u + 1u), sum = texel_pick(starts, lane);
    do {
        uint i = 4u * texel;
        uvec4 v = texel_load(before, int(min(texel, p.n / 4u)));
        v = uvec4(i < p.n ? v.x : 0u, i + 1u < p.n ? v.y : 0u, i + 2u < p.n ? v.z : 0u, i + 3u < p.n ? v.w : 0u);
        uvec4 sums = uvec4(sum, sum + v.x, sum + v.x + v.y, sum + v.x + v.y + v.z);
        if (texel < end) data[texel] = sums;
        sum = sums.w + v.w;
        ++texel;
    } while (texel < end);
}
