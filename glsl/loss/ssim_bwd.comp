#version 460
// loss/ssim_bwd: gradient of the mean 1 - SSIM to x; horizontal window over the slopes. One invocation per run of a
// row.
//   in   rows [H,W,3,4] from loss/ssim_columns   x y [.,4] from first_px on   v_before: v_x as texels
//   out  v_x [.,4] at first_px (=), or (+=) with ACCUMULATE; fourth channel 0
//   twin kernels/src/reference/loss/ssim.rs
#extension GL_EXT_control_flow_attributes : require
#include "lib/grid.glsl"
#include "lib/ssim.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 7) const uint ACCUMULATE = 0;
layout(push_constant) uniform Params { int height, width, first_px; float scale; } p;
TEXELS_F32(0, rows);
TEXELS_F32(1, x);
TEXELS_F32(2, y);
TEXELS_F32(3, v_before);
layout(set = 0, binding = 4) writeonly buffer VX { vec4 v_x[]; };

void main() {
    int runs = (p.width + RUN - 1) / RUN;
    int i = int(global_index());
    if (i >= runs * p.height) return;
    int row = i / runs * p.width;
    int column = i % runs * RUN;
    vec3 by_mean[RUN + 10];
    vec3 by_square[RUN + 10];
    vec3 by_product[RUN + 10];
    [[unroll]] for (int k = 0; k < RUN + 10; k++) {
        int c = column + k - 5;
        bvec3 inside = bvec3(c >= 0 && c < p.width);
        int at = (row + clamp(c, 0, p.width - 1)) * 3;
        by_mean[k] = mix(vec3(0.0), texel_load(rows, at).rgb, inside);
        by_square[k] = mix(vec3(0.0), texel_load(rows, at + 1).rgb, inside);
        by_product[k] = mix(vec3(0.0), texel_load(rows, at + 2).rgb, inside);
    }
    [[unroll]] for (int r = 0; r < RUN; r++) {
        if (column + r < p.width) {
            int at = p.first_px + row + column + r;
            vec3 other = texel_load(y, at).rgb;
            vec3 d = texel_load(x, at).rgb - other;
            vec3 v = window(by_mean, r) + other * window(by_product, r);
            v = p.scale * (v + 2.0 * d * window(by_square, r));
            if (ACCUMULATE != 0) v += texel_load(v_before, at).rgb;
            v_x[at] = vec4(v, 0.0);
        }
    }
}
