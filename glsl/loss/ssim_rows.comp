#version 460
// loss/ssim_rows: horizontal window over d, d^2 and d*y of d = x - y, or d = x with REFERENCE. One invocation per run
// of pixels of a row.
//   in   x y [.,4], H*W pixels from first_px on
//   out  rows [H,W,3,4] (=)
//   twin kernels/src/reference/loss/ssim.rs
#extension GL_EXT_control_flow_attributes : require
#include "lib/grid.glsl"
#include "lib/ssim.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 7) const uint REFERENCE = 0;
layout(push_constant) uniform Params { int height, width, first_px; } p;
TEXELS_F32(0, x);
TEXELS_F32(1, y);
layout(set = 0, binding = 2) writeonly buffer Rows { vec4 rows[]; };

void main() {
    int runs = (p.width + RUN - 1) / RUN;
    int i = int(global_index());
    if (i >= runs * p.height) return;
    int row = i / runs * p.width;
    int column = i % runs * RUN;
    vec3 a[RUN + 10];
    vec3 aa[RUN + 10];
    vec3 ab[RUN + 10];
    [[unroll]] for (int k = 0; k < RUN + 10; k++) {
        int c = column + k - 5;
        bvec3 inside = bvec3(c >= 0 && c < p.width);
        int at = p.first_px + row + clamp(c, 0, p.width - 1);
        vec3 other = texel_load(y, at).rgb;
        vec3 d = texel_load(x, at).rgb;
        if (REFERENCE == 0) d -= other;
        a[k] = mix(vec3(0.0), d, inside);
        aa[k] = a[k] * a[k];
        ab[k] = a[k] * mix(vec3(0.0), other, inside);
    }
    [[unroll]] for (int r = 0; r < RUN; r++) {
        if (column + r < p.width) {
            int at = (row + column + r) * 3;
            rows[at] = vec4(window(a, r), 0.0);
            rows[at + 1] = vec4(window(aa, r), 0.0);
            rows[at + 2] = vec4(window(ab, r), 0.0);
        }
    }
}
