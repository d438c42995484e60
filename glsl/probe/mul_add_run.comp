#version 460
// probe/mul_add_run: how fast the device multiplies and adds in registers; no paper, the yardstick of the benchmarks.
// Twelve independent chains v <- v scale + shift per invocation, each `runs` x STEPS long; y is the sum of their ends.
//   in   x [n]   chain c starts at x + c
//   out  y [n] (=)
//   twin kernels/src/reference/probe/mul_add.rs   runs is below 65,536, where some drivers stop loops
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
layout(constant_id = 0) const uint STEPS = 1;
layout(push_constant) uniform Params { uint n, runs; float scale, shift; } p;
layout(set = 0, binding = 0) readonly buffer X { float x[]; };
layout(set = 0, binding = 1) buffer Y { float y[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec4 a = vec4(x[i]) + vec4(0.0, 1.0, 2.0, 3.0);
    vec4 b = a + 4.0;
    vec4 c = b + 4.0;
    uint run = 0;
    do {
        for (uint s = 0; s < STEPS; ++s) {
            a = a * p.scale + p.shift;
            b = b * p.scale + p.shift;
            c = c * p.scale + p.shift;
        }
    } while (++run < p.runs);
    vec4 sum = a + b + c;
    y[i] = (sum.x + sum.y) + (sum.z + sum.w);
}
