#version 460
// scan/prefix_sum_apply: exclusive sum in place, from each chunk's start value. Last of three passes.
//   in   starts [lanes, padded to 4]   before [n, padded to 4], the same memory as data: a lane reads a texel, then
//     writes it
//   out  data [n, padded to 4] (=), element n receives the total
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, chunk; } p;
TEXELS_U32(0, starts);
TEXELS_U32(1, before);
layout(set = 0, binding = 2) buffer Data { uvec4 data[]; };
#include "lib/chunk_prefix.glsl"

void main() {
    uint lane = global_index();
    uint texel = lane * p.chunk;
    put_prefixes(texel, min(texel + p.chunk, p.n / 4u + 1u), texel_pick(starts, lane));
}
