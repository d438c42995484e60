#version 460
// scan/prefix_sum_partial_tile: sum of each workgroup's contiguous chunk. First of two passes on GPUs.
//   in   data [n, padded to 4]
//   out  sums [groups] (=)   a workgroup owns `chunk` texels
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 128) in;
#include "lib/block_scan.glsl"
layout(push_constant) uniform Params { uint n, chunk; } p;
layout(set = 0, binding = 0) readonly buffer Data { uvec4 data[]; };
layout(set = 0, binding = 1) writeonly buffer Sums { uint sums[]; };

void main() {
    uint group = gl_WorkGroupID.x;
    uint texel = group * p.chunk + gl_LocalInvocationID.x, end = (group + 1u) * p.chunk, sum = 0u;
    do {
        uint i = 4u * texel;
        uvec4 v = data[min(texel, (p.n - 1u) / 4u)];
        sum += (i < p.n ? v.x : 0u) + (i + 1u < p.n ? v.y : 0u) + (i + 2u < p.n ? v.z : 0u) + (i + 3u < p.n ? v.w : 0u);
        texel += gl_WorkGroupSize.x;
    } while (texel < end);
    uint total;
    sum_before(sum, total);
    if (gl_LocalInvocationID.x == 0u) sums[group] = total;
}
