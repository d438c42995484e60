#version 460
// scan/prefix_sum_spine: exclusive sum of the chunk sums, in place, by one lane. Second of three passes.
//   in   before [lanes], the same memory as sums: a texel is read, then written   out  sums [lanes] (=), lanes a
//     multiple of 4
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint lanes; } p;
TEXELS_U32(0, before);
layout(set = 0, binding = 1) buffer Sums { uvec4 sums[]; };

void main() {
    if (gl_LocalInvocationID.x != 0u) return;
    uint total = 0u, i = 0u;
    do {
        uvec4 v = texel_load(before, int(i));
        sums[i] = total + uvec4(0u, v.x, v.x + v.y, v.x + v.y + v.z);
        total += v.x + v.y + v.z + v.w;
        ++i;
    } while (4u * i < p.lanes);
}
