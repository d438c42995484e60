#version 460
// image/resize_apply: a banded matrix along one axis; a separable resize or, with the transposed table, its adjoint.
//   in   x [planes, from, inner, 4]   table [tables, to, 1 + taps4, 4]: first source index, then weights, 0 = no tap;
//        one table for as many planes one after the other as planes_per_table says
//        plus like y, added with ADD; clamped like y: with GATE the result is 0 where it lies outside of [0, 1]
//   out  y [planes, to, inner, 4] (=); fourth channel 0
//   twin kernels/src/reference/image/resize.rs   one invocation per output pixel; groups: x = to * inner, yz = planes
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
#include "lib/clamp01.glsl"
layout(constant_id = 0) const uint ADD = 0;
layout(constant_id = 1) const uint GATE = 0;
layout(push_constant) uniform Params { int planes, from, to, inner, taps4, planes_per_table; } p;
TEXELS_F32(0, x);
TEXELS_F32(1, table);
TEXELS_F32(2, plus);
TEXELS_F32(3, clamped);
layout(set = 0, binding = 4) writeonly buffer Y { vec4 y[]; };

void main() {
    int plane = int(gl_WorkGroupID.y + gl_WorkGroupID.z * gl_NumWorkGroups.y);
    int j = int(gl_GlobalInvocationID.x);
    if (j >= p.to * p.inner || plane >= p.planes) return;
    int row = (plane / p.planes_per_table * p.to + j / p.inner) * (1 + p.taps4);
    int base = plane * p.from * p.inner + j % p.inner;
    int source = int(texel_load(table, row).x);
    vec3 sum = vec3(0.0);
    int group = 0;
    do {
        group++;
        vec4 weight = texel_load(table, row + group);
        for (int k = 0; k < 4; k++) {
            vec3 term = texel_load(x, base + min(source, p.from - 1) * p.inner).rgb * weight[k];
            sum += mix(vec3(0.0), term, bvec3(weight[k] != 0.0));
            source++;
        }
    } while (group < p.taps4);
    int at = plane * p.to * p.inner + j;
    if (ADD != 0) sum += texel_load(plus, at).rgb;
    if (GATE != 0) sum = clamp01_gate(texel_load(clamped, at).rgb, sum);
    y[at] = vec4(sum, 0.0);
}
