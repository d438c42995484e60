#version 460
// scan/prefix_sum_apply: exclusive sum in place, from each chunk's start value. Last of three passes.
//   in   starts [lanes]
//   in/out data [n, padded to 4] (=), element n receives the total
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
layout(push_constant) uniform Params { uint n, chunk; } p;
layout(set = 0, binding = 0) readonly buffer Starts { uint starts[]; };
layout(set = 0, binding = 1) buffer Data { uvec4 data[]; };

void main() {
    uint lane = global_index();
    uint texel = lane * p.chunk, end = min(texel + p.chunk, p.n / 4u + 1u), sum = starts[lane];
    do {
        uint i = 4u * texel;
        uvec4 v = data[min(texel, p.n / 4u)];
        v = uvec4(i < p.n ? v.x : 0u, i + 1u < p.n ? v.y : 0u, i + 2u < p.n ? v.z : 0u, i + 3u < p.n ? v.w : 0u);
        uvec4 before = uvec4(sum, sum + v.x, sum + v.x + v.y, sum + v.x + v.y + v.z);
        if (texel < end) data[texel] = before;
        sum = before.w + v.w;
        ++texel;
    } while (texel < end);
}
