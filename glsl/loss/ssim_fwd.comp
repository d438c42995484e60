#version 460
// loss/ssim_fwd: 1 - SSIM and its slopes by the windowed means of d, d^2, d*y. One invocation per run of a column.
//   in   rows [H,W,3,4] of (x, y)   moments [.,2,4] of y from first_px on
//   out  slopes [H,W,3,4] (=)   partial [.] from first_partial on (=): sums of 1 - SSIM
//   twin kernels/src/reference/loss/ssim.rs   groups: x = 64 columns, y = runs of rows
//   Wang et al. 2004, eq. 13 is (1 - l)(1 - s) with l = mean(d)^2 / (mean(x)^2 + mean(y)^2 + C1) and
//   s = var(d) / (var(x) + var(y) + C2): nothing cancels where x is near y
#extension GL_EXT_control_flow_attributes : require
#include "lib/ssim.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
layout(push_constant) uniform Params { int height, width, first_px; uint first_partial; float c1, c2; } p;
TEXELS_F32(0, rows);
TEXELS_F32(1, moments);
layout(set = 0, binding = 2) writeonly buffer Slopes { vec4 slopes[]; };
layout(set = 0, binding = 3) writeonly buffer Partial { float partial[]; };

void main() {
    int column = int(gl_GlobalInvocationID.x);
    int row = int(gl_WorkGroupID.y) * RUN;
    vec3 a[RUN + 10];
    vec3 aa[RUN + 10];
    vec3 ab[RUN + 10];
    [[unroll]] for (int k = 0; k < RUN + 10; k++) {
        int r = row + k - 5;
        bvec3 inside = bvec3(r >= 0 && r < p.height);
        int at = (clamp(r, 0, p.height - 1) * p.width + min(column, p.width - 1)) * 3;
        a[k] = mix(vec3(0.0), texel_load(rows, at).rgb, inside);
        aa[k] = mix(vec3(0.0), texel_load(rows, at + 1).rgb, inside);
        ab[k] = mix(vec3(0.0), texel_load(rows, at + 2).rgb, inside);
    }
    vec3 total = vec3(0.0);
    [[unroll]] for (int r = 0; r < RUN; r++) {
        if (column < p.width && row + r < p.height) {
            int at = (row + r) * p.width + column;
            vec3 md = window(a, r);
            vec3 my = texel_load(moments, (p.first_px + at) * 2).rgb;
            vec3 mx = my + md;
            vec3 var_d = window(aa, r) - md * md;
            vec3 cov = window(ab, r) - md * my;
            vec3 inv1 = 1.0 / (mx * mx + my * my + p.c1);
            vec3 inv2 = 1.0 / (2.0 * (texel_load(moments, (p.first_px + at) * 2 + 1).rgb + cov) + var_d + p.c2);
            vec3 l = md * md * inv1;
            vec3 s = var_d * inv2;
            total += l + s - l * s;
            vec3 by_square = (1.0 - l) * (1.0 - s) * inv2;
            vec3 by_product = -2.0 * s * (1.0 - l) * inv2;
            vec3 by_mean = 2.0 * (1.0 - s) * (md - l * mx) * inv1 - 2.0 * md * by_square - my * by_product;
            slopes[at * 3] = vec4(by_mean, 0.0);
            slopes[at * 3 + 1] = vec4(by_square, 0.0);
            slopes[at * 3 + 2] = vec4(by_product, 0.0);
        }
    }
    float sum = total.r + total.g + total.b;
    sum += lane_shuffle_xor(sum, 1);
    sum += lane_shuffle_xor(sum, 2);
    sum += lane_shuffle_xor(sum, 4);
    uint group = gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x;
    uint lane = gl_LocalInvocationID.x;
    if (lane % 8 == 0) partial[p.first_partial + group * 8 + lane / 8] = sum;
}
