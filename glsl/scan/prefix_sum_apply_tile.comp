#version 460
// scan/prefix_sum_apply_tile: exclusive sum in place. Last of two passes on GPUs.
//   in   sums [groups] of the chunks
//   out  data [n, padded to 4] (=), element n receives the total   a workgroup owns `chunk` texels, a multiple of 512
//   Each workgroup adds up the sums before its own, which are 512 at most: cheaper than a pass for it.
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 128) in;
#include "lib/block_scan.glsl"
layout(push_constant) uniform Params { uint n, chunk; } p;
layout(set = 0, binding = 0) readonly buffer Sums { uint sums[]; };
layout(set = 0, binding = 1) buffer Data { uvec4 data[]; };

// Texels of one invocation in a block.
const uint OWN = 4u;

void main() {
    uint id = gl_LocalInvocationID.x, group = gl_WorkGroupID.x;
    uint sum = 0u, i = id;
    do {
        sum += i < group ? sums[i] : 0u;
        i += gl_WorkGroupSize.x;
    } while (i < group);
    uint start;
    sum_before(sum, start);
    uint texel = group * p.chunk + OWN * id, end = (group + 1u) * p.chunk + OWN * id, last = p.n / 4u;
    do {
        uvec4 v[OWN];
        sum = 0u;
        [[unroll]] for (uint k = 0u; k < OWN; ++k) {
            uint e = 4u * (texel + k);
            v[k] = data[min(texel + k, last)];
            v[k] = uvec4(e < p.n ? v[k].x : 0u, e + 1u < p.n ? v[k].y : 0u, e + 2u < p.n ? v[k].z : 0u,
                e + 3u < p.n ? v[k].w : 0u);
            sum += v[k].x + v[k].y + v[k].z + v[k].w;
        }
        uint total;
        uint before = start + sum_before(sum, total);
        [[unroll]] for (uint k = 0u; k < OWN; ++k) {
            uvec4 sums_before = before + uvec4(0u, v[k].x, v[k].x + v[k].y, v[k].x + v[k].y + v[k].z);
            if (texel + k <= last) data[texel + k] = sums_before;
            before = sums_before.w + v[k].w;
        }
        start += total;
        texel += OWN * gl_WorkGroupSize.x;
    } while (texel < end);
}
