#version 460
// nn/layer_norm_bwd: gradient of layer_norm_fwd to its input; gamma and beta are constants. One invocation per row.
//   in   x [.., width] (rows row_offset + i*row_step)   gamma [width]   v_y [rows, width]   v_residual like v_x, read
//     if ADD = 1
//   out  v_x [.., width] (=), only the rows named above
//   g = v_y*gamma:  v_x = rstd * (g - mean(g) - x_hat*mean(g*x_hat)) + v_residual
//   twin kernels/src/reference/nn/layer_norm.rs
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint ADD = 0;
layout(push_constant) uniform Params { uint rows; uint width; uint row_step; uint row_offset; float eps; } p;
TEXELS_F32(0, x_tex);
TEXELS_F32(1, gamma_tex);
TEXELS_F32(2, v_y_tex);
TEXELS_F32(3, v_residual_tex);
layout(set = 0, binding = 4) writeonly buffer VX { vec4 v_x[]; };

float total(vec4 v) {
    return v.x + v.y + v.z + v.w;
}

void main() {
    int texels = int(p.width / 4u);
    float inv_width = 1.0 / float(p.width);
    uint row = global_index();
    uint safe_row = min(row, p.rows - 1u);
    int x0 = int(p.row_offset + safe_row * p.row_step) * texels;
    int y0 = int(safe_row) * texels;
    vec4 sum = vec4(0.0);
    vec4 sum_g = vec4(0.0);
    int t = 0;
    do {
        sum += texel_load(x_tex, x0 + t);
        sum_g += texel_load(v_y_tex, y0 + t) * texel_load(gamma_tex, t);
    } while (++t < texels);
    float mean = total(sum) * inv_width;
    float mean_g = total(sum_g) * inv_width;
    vec4 square = vec4(0.0);
    vec4 sum_gd = vec4(0.0);
    t = 0;
    do {
        vec4 d = texel_load(x_tex, x0 + t) - mean;
        square += d * d;
        sum_gd += texel_load(v_y_tex, y0 + t) * texel_load(gamma_tex, t) * d;
    } while (++t < texels);
    float rstd = 1.0 / sqrt(total(square) * inv_width + p.eps);
    float slope = total(sum_gd) * inv_width * rstd * rstd;
    t = 0;
    do {
        vec4 g = texel_load(v_y_tex, y0 + t) * texel_load(gamma_tex, t);
        vec4 v = rstd * (g - mean_g - (texel_load(x_tex, x0 + t) - mean) * slope);
        if (ADD == 1u) {
            v += texel_load(v_residual_tex, x0 + t);
        }
        if (row < p.rows) {
            v_x[x0 + t] = v;
        }
    } while (++t < texels);
}
