#version 460
// scan/prefix_sum_partial: sum of each lane's contiguous chunk. First of three passes.
//   in   before [n, padded to 4]
//   out  sums [lanes] (=)   a lane owns `chunk` texels
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, chunk; } p;
TEXELS_U32(0, before);
layout(set = 0, binding = 1) buffer Sums { uint sums[]; };
#include "lib/chunk_sum.glsl"

void main() {
    uint lane = global_index();
    sums[lane] = chunk_sum(lane * p.chunk, (lane + 1u) * p.chunk);
}
