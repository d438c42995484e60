// Values passed between lanes: eight neighbours in a workgroup, whose width is a multiple of 8. Included behind
// local_size_x.
//   lane_shuffle(x, lane)   x of that lane, 0 to 7, the same for all   lane_shuffle_xor(x, mask)   x of lane ^ mask
// All invocations of the workgroup call them together: the tile kernels (TILES) wait for each other there.
#ifdef TILES
// Two halves by turns: who writes one half has passed the barrier behind every read of it.
shared vec4 exchanged[2u * gl_WorkGroupSize.x];
uint exchange_half = 0u;

// Place that the invocation writes next, and whose eight lanes it can read.
uint next_exchange() {
    exchange_half = gl_WorkGroupSize.x - exchange_half;
    return exchange_half + gl_LocalInvocationID.x;
}

float lane_shuffle(float x, uint lane) {
    uint own = next_exchange();
    exchanged[own].x = x;
    barrier();
    return exchanged[(own & ~7u) + lane].x;
}

vec4 lane_shuffle(vec4 x, uint lane) {
    uint own = next_exchange();
    exchanged[own] = x;
    barrier();
    return exchanged[(own & ~7u) + lane];
}

float lane_shuffle_xor(float x, uint mask) {
    uint own = next_exchange();
    exchanged[own].x = x;
    barrier();
    return exchanged[own ^ mask].x;
}

vec2 lane_shuffle_xor(vec2 x, uint mask) {
    uint own = next_exchange();
    exchanged[own].xy = x;
    barrier();
    return exchanged[own ^ mask].xy;
}

vec4 lane_shuffle_xor(vec4 x, uint mask) {
    uint own = next_exchange();
    exchanged[own] = x;
    barrier();
    return exchanged[own ^ mask];
}
#else
#extension GL_KHR_shader_subgroup_shuffle : require
#define lane_shuffle subgroupShuffle
#define lane_shuffle_xor subgroupShuffleXor
#endif
