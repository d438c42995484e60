#version 460
// scan/radix_sort_count_tile: digit counts of each workgroup's 2048 pairs, for a stable least-significant-digit sort on
// GPUs.
//   in   keys [n, padded to 4]
//   out  table [BINS,groups] (=) counts
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 128) in;
layout(constant_id = 0) const uint BINS = 16;
layout(push_constant) uniform Params { uint n, groups, shift; } p;
layout(set = 0, binding = 0) readonly buffer Keys { uvec4 keys[]; };
layout(set = 0, binding = 1) writeonly buffer Table { uint table[]; };

#include "lib/radix_tile.glsl"

shared uint counts[MAX_BINS];

void main() {
    uint id = gl_LocalInvocationID.x, group = gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x;
    if (group >= p.groups) return;
    if (id < BINS) counts[id] = 0u;
    barrier();
    [[unroll]] for (uint k = 0u; k < OWN; ++k) {
        // Counts have no order: neighbours read neighbours.
        uint texel = (group * OWN + k) * gl_WorkGroupSize.x + id;
        uvec4 key = keys[min(texel, (p.n - 1u) / 4u)];
        [[unroll]] for (uint c = 0u; c < 4u; ++c) {
            if (4u * texel + c < p.n) atomicAdd(counts[digit(key[c])], 1u);
        }
    }
    barrier();
    if (id < BINS) table[id * p.groups + group] = counts[id];
}
