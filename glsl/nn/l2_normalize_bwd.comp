#version 460
// nn/l2_normalize_bwd: gradient of l2_normalize_fwd. One invocation per row.
//   in   x [rows, width] (input of the forward pass)   v_y [rows, width]
//   out  v_x [rows, width] (=)   v_x = (v_y - x * (x . v_y) / |x|^2) / |x|
//   twin kernels/src/reference/nn/l2_normalize.rs   a zero row gives NaN, as in the forward pass
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint rows; uint width; } p;
TEXELS_F32(0, x_tex);
TEXELS_F32(1, v_y_tex);
layout(set = 0, binding = 2) writeonly buffer VX { vec4 v_x[]; };

void main() {
    int texels = int(p.width / 4u);
    uint row = global_index();
    int x0 = int(min(row, p.rows - 1u)) * texels;
    vec4 square = vec4(0.0);
    vec4 cross_sum = vec4(0.0);
    int t = 0;
    do {
        vec4 x = texel_load(x_tex, x0 + t);
        square += x * x;
        cross_sum += x * texel_load(v_y_tex, x0 + t);
    } while (++t < texels);
    float norm_sq = square.x + square.y + square.z + square.w;
    float norm = sqrt(norm_sq);
    float along = (cross_sum.x + cross_sum.y + cross_sum.z + cross_sum.w) / norm_sq;
    t = 0;
    do {
        vec4 v = (texel_load(v_y_tex, x0 + t) - texel_load(x_tex, x0 + t) * along) / norm;
        if (row < p.rows) {
            v_x[x0 + t] = v;
        }
    } while (++t < texels);
}
