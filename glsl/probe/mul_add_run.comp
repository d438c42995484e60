#version 460
// probe/mul_add_run: how fast the device multiplies and adds in registers; no paper, the yardstick of the benchmarks.
// Twelve independent chains v <- v scale + shift per invocation, `runs` x 32 steps long; y is the sum of their ends.
// The steps are written out: a loop's variables go through memory on some drivers, which would be measured instead.
//   in   x [n]   chain c starts at x + c
//   out  y [n] (=)
//   twin kernels/src/reference/probe/mul_add.rs   runs is below 65,536, where some drivers stop loops
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#define STEP a = a * p.scale + p.shift; b = b * p.scale + p.shift; c = c * p.scale + p.shift;
#define STEPS_8 STEP STEP STEP STEP STEP STEP STEP STEP
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
        STEPS_8 STEPS_8 STEPS_8 STEPS_8
    } while (++run < p.runs);
    vec4 sum = a + b + c;
    y[i] = (sum.x + sum.y) + (sum.z + sum.w);
}
