#version 460
// scan/radix_sort_count: digit counts of each lane's contiguous chunk, for a stable least-significant-digit sort.
//   in   keys [n, padded to 4]
//   out  table [BINS,lanes] (=) counts
//   Counters are private: a processor's driver reads them eight at a time, but a storage buffer one lane after the
//     other.
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint BINS = 256;
layout(push_constant) uniform Params { uint n, chunk, lanes, shift; } p;
TEXELS_U32(0, keys);
layout(set = 0, binding = 1) buffer Table { uint table[]; };

uint counts[BINS];

void main() {
    uint lane = global_index();
    uint texel = lane * p.chunk, end = texel + p.chunk;
    uint bin = 0u;
    do {
        counts[bin] = 0u;
    } while (++bin < BINS);
    do {
        uvec4 key = texel_load(keys, int(min(texel, (p.n - 1u) / 4u)));
        [[unroll]] for (int k = 0; k < 4; ++k) {
            counts[(key[k] >> p.shift) & (BINS - 1u)] += 4u * texel + uint(k) < p.n ? 1u : 0u;
        }
        ++texel;
    } while (texel < end);
    bin = 0u;
    do {
        table[bin * p.lanes + lane] = counts[bin];
    } while (++bin < BINS);
}
