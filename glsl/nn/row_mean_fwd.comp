#version 460
// nn/row_mean_fwd: mean of every row. One invocation per row.
//   in   x [rows, width]
//   out  mean [rows] (=)
//   twin kernels/src/reference/nn/row_mean.rs
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint rows; uint width; } p;
TEXELS_F32(0, x_tex);
layout(set = 0, binding = 1) writeonly buffer Mean { float mean[]; };

void main() {
    int texels = int(p.width / 4u);
    uint row = global_index();
    int x0 = int(min(row, p.rows - 1u)) * texels;
    vec4 sum = vec4(0.0);
    int t = 0;
    do {
        sum += texel_load(x_tex, x0 + t);
    } while (++t < texels);
    if (row < p.rows) {
        mean[row] = (sum.x + sum.y + sum.z + sum.w) / float(p.width);
    }
}
