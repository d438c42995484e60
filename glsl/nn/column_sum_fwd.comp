#version 460
// nn/column_sum_fwd: sum over rows, the gradient of a bias. One invocation per four columns.
//   in   x [rows, width]
//   out  sum [width] (=)
//   twin kernels/src/reference/nn/column_sum.rs   rows are added in order, so the result is deterministic
//   Rows are on their way several at once: a card has few columns to hide the wait for one behind others.
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint rows; uint width; } p;
TEXELS_F32(0, x_tex);
layout(set = 0, binding = 1) writeonly buffer Sum { vec4 sum[]; };

const uint AT_ONCE = 8u;

void main() {
    uint texels = p.width / 4u;
    uint i = global_index();
    uint column = min(i, texels - 1u);
    vec4 acc = vec4(0.0);
    uint row = 0u;
    do {
        vec4 x[AT_ONCE];
        [[unroll]] for (uint k = 0u; k < AT_ONCE; ++k) {
            x[k] = texel_load(x_tex, int(min(row + k, p.rows - 1u) * texels + column));
        }
        [[unroll]] for (uint k = 0u; k < AT_ONCE; ++k) {
            acc = row + k < p.rows ? acc + x[k] : acc;
        }
        row += AT_ONCE;
    } while (row < p.rows);
    if (i < texels) {
        sum[i] = acc;
    }
}
