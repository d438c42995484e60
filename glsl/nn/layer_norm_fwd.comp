#version 460
// nn/layer_norm_fwd: y = (x - mean) / sqrt(var + eps) * gamma + beta, Ba et al. 2016, eq. 4. One invocation per row.
//   in   x [.., width], row i of y is row row_offset + i*row_step of x   gamma [width]   beta [width]
//   out  y [rows, width] (=)
//   twin kernels/src/reference/nn/layer_norm.rs   var is the biased variance, taken about the mean
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint rows; uint width; uint row_step; uint row_offset; float eps; } p;
TEXELS_F32(0, x_tex);
TEXELS_F32(1, gamma_tex);
TEXELS_F32(2, beta_tex);
layout(set = 0, binding = 3) writeonly buffer Y { vec4 y[]; };

void main() {
    int texels = int(p.width / 4u);
    uint row = global_index();
    int x0 = int(p.row_offset + min(row, p.rows - 1u) * p.row_step) * texels;
    vec4 sum = vec4(0.0);
    int t = 0;
    do {
        sum += texel_load(x_tex, x0 + t);
    } while (++t < texels);
    float mean = (sum.x + sum.y + sum.z + sum.w) / float(p.width);
    vec4 square = vec4(0.0);
    t = 0;
    do {
        vec4 d = texel_load(x_tex, x0 + t) - mean;
        square += d * d;
    } while (++t < texels);
    float var = (square.x + square.y + square.z + square.w) / float(p.width);
    float rstd = 1.0 / sqrt(var + p.eps);
    t = 0;
    do {
        vec4 x_hat = (texel_load(x_tex, x0 + t) - mean) * rstd;
        vec4 out4 = x_hat * texel_load(gamma_tex, t) + texel_load(beta_tex, t);
        if (row < p.rows) {
            y[int(row) * texels + t] = out4;
        }
    } while (++t < texels);
}
