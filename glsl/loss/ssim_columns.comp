#version 460
// loss/ssim_columns: vertical window over the three slopes. One invocation per run of a column.
//   in   slopes [H,W,3,4]
//   out  rows [H,W,3,4] (=)
//   twin kernels/src/reference/loss/ssim.rs   groups: x = 64 columns, y = runs of rows
#extension GL_EXT_control_flow_attributes : require
#include "lib/ssim.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { int height, width; } p;
TEXELS_F32(0, slopes);
layout(set = 0, binding = 1) writeonly buffer Rows { vec4 rows[]; };

void main() {
    int column = int(gl_GlobalInvocationID.x);
    int row = int(gl_WorkGroupID.y) * RUN;
    [[unroll]] for (int plane = 0; plane < 3; plane++) {
        vec3 v[RUN + 10];
        [[unroll]] for (int k = 0; k < RUN + 10; k++) {
            int r = row + k - 5;
            int at = (clamp(r, 0, p.height - 1) * p.width + min(column, p.width - 1)) * 3 + plane;
            v[k] = mix(vec3(0.0), texel_load(slopes, at).rgb, bvec3(r >= 0 && r < p.height));
        }
        [[unroll]] for (int r = 0; r < RUN; r++) {
            if (column < p.width && row + r < p.height) {
                rows[((row + r) * p.width + column) * 3 + plane] = vec4(window(v, r), 0.0);
            }
        }
    }
}
