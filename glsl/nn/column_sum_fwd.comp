#version 460
// nn/column_sum_fwd: sum over rows, the gradient of a bias. One invocation per four columns.
//   in   x [rows, width]
//   out  sum [width] (=)
//   twin kernels/src/reference/nn/column_sum.rs   rows are added in order, so the result is deterministic
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint rows; uint width; } p;
TEXELS_F32(0, x_tex);
layout(set = 0, binding = 1) writeonly buffer Sum { vec4 sum[]; };

void main() {
    uint texels = p.width / 4u;
    uint i = global_index();
    int at = int(min(i, texels - 1u));
    vec4 acc = vec4(0.0);
    uint row = 0u;
    do {
        acc += texel_load(x_tex, at);
        at += int(texels);
    } while (++row < p.rows);
    if (i < texels) {
        sum[i] = acc;
    }
}
