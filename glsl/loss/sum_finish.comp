#version 460
// loss/sum_finish: values[slot] = scale * sum of n elements of partial, in a fixed order. One workgroup.
//   in   partial [.], from first on
//   out  values [.], one element (=)
//   twin kernels/src/reference/loss/sum.rs
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint first, n, slot; float scale; } p;
TEXELS_F32(0, partial);
layout(set = 0, binding = 1) buffer Values { float values[]; };
shared float lanes[64];

void main() {
    uint lane = gl_LocalInvocationID.x;
    float sum = 0.0;
    uint i = lane;
    uint rounds = (p.n + 63) / 64;
    while (rounds > 0) {
        if (i < p.n) sum += texel_pick(partial, p.first + i);
        i += 64;
        rounds--;
    }
    lanes[lane] = sum;
    barrier();
    if (lane == 0) {
        float total = 0.0;
        for (uint l = 0; l < 64; l++) total += lanes[l];
        values[p.slot] = p.scale * total;
    }
}
