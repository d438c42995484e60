#version 460
// scan/radix_sort_scatter: moves each pair to its place for one digit; lanes walk their chunks in order, so it is
// stable.
//   in   keys, values [n, padded to 4]
//        table [BINS,lanes] exclusive sum of the counts: where each lane puts its first key of each digit
//   out  sorted_keys, sorted_values [n] (=)
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint BINS = 256;
layout(push_constant) uniform Params { uint n, chunk, lanes, shift; } p;
TEXELS_U32(0, keys);
TEXELS_U32(1, values);
TEXELS_U32(2, table);
layout(set = 0, binding = 3) buffer SortedKeys { uint sorted_keys[]; };
layout(set = 0, binding = 4) buffer SortedValues { uint sorted_values[]; };

uint cursors[BINS];

void main() {
    uint lane = global_index();
    uint texel = lane * p.chunk, end = texel + p.chunk;
    uint bin = 0u;
    do {
        cursors[bin] = texel_pick(table, bin * p.lanes + lane);
    } while (++bin < BINS);
    do {
        int at = int(min(texel, (p.n - 1u) / 4u));
        uvec4 key = texel_load(keys, at), value = texel_load(values, at);
        [[unroll]] for (int k = 0; k < 4; ++k) {
            uint digit = (key[k] >> p.shift) & (BINS - 1u);
            uint to = cursors[digit];
            if (4u * texel + uint(k) < p.n) {
                cursors[digit] = to + 1u;
                sorted_keys[to] = key[k];
                sorted_values[to] = value[k];
            }
        }
        ++texel;
    } while (texel < end);
}
