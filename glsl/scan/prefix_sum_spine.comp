#version 460
// scan/prefix_sum_spine: exclusive sum of the chunk sums, in place, by one lane. Second of three passes.
//   in/out sums [lanes] (=)
layout(local_size_x = 8) in;
layout(push_constant) uniform Params { uint lanes; } p;
layout(set = 0, binding = 0) buffer Sums { uint sums[]; };

void main() {
    if (gl_LocalInvocationID.x != 0u) return;
    uint total = 0u, i = 0u;
    do {
        uint value = sums[i];
        sums[i] = total;
        total += value;
        ++i;
    } while (i < p.lanes);
}
