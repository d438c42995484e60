#version 460
// loss/ssim_reference: mean and variance of the reference from its loss/ssim_rows. One invocation per run of a column.
//   in   rows [H,W,3,4]
//   out  moments [.,2,4] from first_px on (=): mean, variance
//   twin kernels/src/reference/loss/ssim.rs   groups: x = 64 columns, y = runs of rows
#extension GL_EXT_control_flow_attributes : require
#include "lib/ssim.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { int height, width, first_px; } p;
TEXELS_F32(0, rows);
layout(set = 0, binding = 1) writeonly buffer Moments { vec4 moments[]; };

void main() {
    int column = int(gl_GlobalInvocationID.x);
    int row = int(gl_WorkGroupID.y) * RUN;
    vec3 a[RUN + 10];
    vec3 aa[RUN + 10];
    [[unroll]] for (int k = 0; k < RUN + 10; k++) {
        int r = row + k - 5;
        bvec3 inside = bvec3(r >= 0 && r < p.height);
        int at = (clamp(r, 0, p.height - 1) * p.width + min(column, p.width - 1)) * 3;
        a[k] = mix(vec3(0.0), texel_load(rows, at).rgb, inside);
        aa[k] = mix(vec3(0.0), texel_load(rows, at + 1).rgb, inside);
    }
    [[unroll]] for (int r = 0; r < RUN; r++) {
        if (column < p.width && row + r < p.height) {
            int at = (p.first_px + (row + r) * p.width + column) * 2;
            vec3 mean = window(a, r);
            moments[at] = vec4(mean, 0.0);
            moments[at + 1] = vec4(window(aa, r) - mean * mean, 0.0);
        }
    }
}
