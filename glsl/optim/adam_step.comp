#version 460
// optim/adam_step: Adam, Kingma & Ba 2015, Algorithm 1, with decoupled decay (Loshchilov & Hutter 2019, Algorithm 2).
// One invocation per texel of four elements; the last one's padding is updated like any element.
//   in   param_before, exp_avg_before, exp_avg_sq_before: the outputs' memory as texels   v_param [n] = dL/d(param)
//   out  param [n] (=)   exp_avg [n] (=)   exp_avg_sq [n] (=)
//   twin kernels/src/reference/optim/adam.rs   bias_i = 1 - beta_i^t and keep = 1 - decay, from the host
//   parameter groups: in rows of ROW elements the first HEAD move at lr, the others at lr_tail
//   bound: largest magnitude that a parameter has after the step; NaN stays
//   in   rates: a factor on both rates for each row, from row first_row on (RATED)
#include "lib/grid.glsl"
#include "lib/keep_nan.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint ROW = 1;
layout(constant_id = 1) const uint HEAD = 1;
layout(push_constant) uniform Params {
    uint texels, first_row; float lr, lr_tail, beta1, beta2, eps, bias1, bias2, keep, bound;
} p;
TEXELS_F32(0, param_before);
TEXELS_F32(1, exp_avg_before);
TEXELS_F32(2, exp_avg_sq_before);
TEXELS_F32(3, v_param);
#ifdef RATED
TEXELS_F32(7, rates);
#endif
layout(set = 0, binding = 4) writeonly buffer Param { vec4 param[]; };
layout(set = 0, binding = 5) writeonly buffer ExpAvg { vec4 exp_avg[]; };
layout(set = 0, binding = 6) writeonly buffer ExpAvgSq { vec4 exp_avg_sq[]; };

void main() {
    uint i = global_index();
    if (i >= p.texels) return;
    int at = int(i);
    vec4 v = texel_load(v_param, at);
    vec4 first = p.beta1 * texel_load(exp_avg_before, at) + (1.0 - p.beta1) * v;
    vec4 second = p.beta2 * texel_load(exp_avg_sq_before, at) + (1.0 - p.beta2) * v * v;
    exp_avg[i] = first;
    exp_avg_sq[i] = second;
    uvec4 element = 4 * i + uvec4(0, 1, 2, 3);
    vec4 lr = mix(vec4(p.lr_tail), vec4(p.lr), lessThan(element % ROW, uvec4(HEAD)));
#ifdef RATED
    uvec4 row = p.first_row + element / ROW;
    lr *= vec4(texel_pick(rates, row.x), texel_pick(rates, row.y), texel_pick(rates, row.z), texel_pick(rates, row.w));
#endif
    vec4 moved = p.keep * texel_load(param_before, at) - lr * (first / p.bias1) / (sqrt(second / p.bias2) + p.eps);
    vec4 bound = vec4(p.bound);
    param[i] = keep_nan(moved, clamp(moved, -bound, bound));
}
