#version 460
// nn/l2_normalize_fwd: y = x / |x| per row, no epsilon (a zero row gives NaN). One invocation per row.
//   in   x [rows, width]
//   out  y [rows, width] (=)
//   twin kernels/src/reference/nn/l2_normalize.rs
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint rows; uint width; } p;
TEXELS_F32(0, x_tex);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    int texels = int(p.width / 4u);
    uint row = global_index();
    int x0 = int(min(row, p.rows - 1u)) * texels;
    vec4 square = vec4(0.0);
    int t = 0;
    do {
        vec4 x = texel_load(x_tex, x0 + t);
        square += x * x;
    } while (++t < texels);
    float norm = sqrt(square.x + square.y + square.z + square.w);
    t = 0;
    do {
        vec4 out4 = texel_load(x_tex, x0 + t) / norm;
        if (row < p.rows) {
            y[x0 + t] = out4;
        }
    } while (++t < texels);
}
