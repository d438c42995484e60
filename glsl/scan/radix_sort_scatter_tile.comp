#version 460
// scan/radix_sort_scatter_tile: moves each pair to its place for one digit, on GPUs. An invocation has 16 pairs that
// lie together, so that pairs of one digit stay in order.
//   in   keys, values [n, padded to 4]
//        table [BINS,groups] exclusive sum of the counts: where each workgroup puts its first key of each digit
//   out  sorted_keys, sorted_values [n] (=)
//   Counters of two digits share a word, since a workgroup has 2048 pairs.
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 128) in;
layout(constant_id = 0) const uint BINS = 16;
layout(push_constant) uniform Params { uint n, groups, shift; } p;
layout(set = 0, binding = 0) readonly buffer Keys { uvec4 keys[]; };
layout(set = 0, binding = 1) readonly buffer Values { uvec4 values[]; };
layout(set = 0, binding = 2) readonly buffer Table { uint table[]; };
layout(set = 0, binding = 3) writeonly buffer SortedKeys { uint sorted_keys[]; };
layout(set = 0, binding = 4) writeonly buffer SortedValues { uint sorted_values[]; };

#include "lib/radix_tile.glsl"

const uint WORDS = MAX_BINS / 2u, LANES = gl_WorkGroupSize.x;

// [WORDS, LANES]
shared uint counts[WORDS * LANES];
shared uint first[MAX_BINS];

// The invocation's counter of a digit, and by how much it is shifted in its word.
uint word(uint d) {
    return (d >> 1u) * LANES + gl_LocalInvocationID.x;
}
uint half_shift(uint d) {
    return 16u * (d & 1u);
}

// Counts of all invocations before this one take the place of its own.
void sum_counts() {
    uint id = gl_LocalInvocationID.x;
    barrier();
    uint before[WORDS], step = 1u;
    do {
        [[unroll]] for (uint w = 0u; w < WORDS; ++w) before[w] = id >= step ? counts[w * LANES + id - step] : 0u;
        barrier();
        [[unroll]] for (uint w = 0u; w < WORDS; ++w) counts[w * LANES + id] += before[w];
        barrier();
        step *= 2u;
    } while (step < LANES);
    [[unroll]] for (uint w = 0u; w < WORDS; ++w) before[w] = id > 0u ? counts[w * LANES + id - 1u] : 0u;
    barrier();
    [[unroll]] for (uint w = 0u; w < WORDS; ++w) counts[w * LANES + id] = before[w];
}

void main() {
    uint id = gl_LocalInvocationID.x, group = gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x;
    if (group >= p.groups) return;
    [[unroll]] for (uint w = 0u; w < WORDS; ++w) counts[w * LANES + id] = 0u;
    if (id < BINS) first[id] = table[id * p.groups + group];
    uint texel = (group * LANES + id) * OWN;
    uvec4 key[OWN], value[OWN];
    [[unroll]] for (uint k = 0u; k < OWN; ++k) {
        uint at = min(texel + k, (p.n - 1u) / 4u);
        key[k] = keys[at];
        value[k] = values[at];
        [[unroll]] for (uint c = 0u; c < 4u; ++c) {
            uint d = digit(key[k][c]);
            if (4u * (texel + k) + c < p.n) counts[word(d)] += 1u << half_shift(d);
        }
    }
    sum_counts();
    [[unroll]] for (uint k = 0u; k < OWN; ++k) {
        [[unroll]] for (uint c = 0u; c < 4u; ++c) {
            uint d = digit(key[k][c]);
            uint to = first[d] + ((counts[word(d)] >> half_shift(d)) & 0xffffu);
            if (4u * (texel + k) + c < p.n) {
                counts[word(d)] += 1u << half_shift(d);
                sorted_keys[to] = key[k][c];
                sorted_values[to] = value[k][c];
            }
        }
    }
}
