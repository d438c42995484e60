#version 460
// scan/radix_sort_count: digit counts of each lane's contiguous chunk, for a stable least-significant-digit sort.
//   in   keys [n, padded to 4]
//   out  table [bins,lanes] += counts; zero before
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, chunk, lanes, shift, mask; } p;
TEXELS_U32(0, keys);
layout(set = 0, binding = 1) buffer Table { uint table[]; };

void main() {
    uint lane = global_index();
    uint texel = lane * p.chunk, end = texel + p.chunk;
    do {
        uvec4 key = texel_load(keys, int(min(texel, (p.n - 1u) / 4u)));
        [[unroll]] for (int k = 0; k < 4; ++k) {
            uint digit = (key[k] >> p.shift) & p.mask;
            if (4u * texel + uint(k) < p.n) table[digit * p.lanes + lane] += 1u;
        }
        ++texel;
    } while (texel < end);
}
