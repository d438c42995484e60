#version 460
// scan/prefix_sum_single: exclusive sum in place by one workgroup of eight lanes, for data so short that three passes
// would wait for each other longer than they work.
//   in   before [n, padded to 4], the same memory as data
//   out  data [n, padded to 4] (=), element n receives the total   a lane owns `chunk` texels
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, chunk; } p;
TEXELS_U32(0, before);
layout(set = 0, binding = 1) buffer Data { uvec4 data[]; };
#include "lib/chunk_prefix.glsl"
shared uint sums[gl_WorkGroupSize.x];

void main() {
    uint lane = gl_LocalInvocationID.x, texel = lane * p.chunk, start = 0u, i = 0u;
    sums[lane] = chunk_sum(texel, texel + p.chunk);
    barrier();
    do {
        start += i < lane ? sums[i] : 0u;
        ++i;
    } while (i < gl_WorkGroupSize.x);
    put_prefixes(texel, min(texel + p.chunk, p.n / 4u + 1u), start);
}
