#version 460
// optim/adam_step: Adam, Kingma & Ba 2015, Algorithm 1, with decoupled decay (Loshchilov & Hutter 2019, Algorithm 2).
// One invocation per element.
//   in   param [n]   v_param [n] = dL/d(param)
//   out  param [n] (=)   exp_avg [n] (=)   exp_avg_sq [n] (=)
//   twin kernels/src/reference/optim/adam.rs   bias_i = 1 - beta_i^t and keep = 1 - decay, from the host
//   parameter groups: in rows of ROW elements the first HEAD move at lr, the others at lr_tail
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
layout(constant_id = 0) const uint ROW = 1;
layout(constant_id = 1) const uint HEAD = 1;
layout(push_constant) uniform Params { uint n; float lr, lr_tail, beta1, beta2, eps, bias1, bias2, keep; } p;
layout(set = 0, binding = 0) buffer Param { float param[]; };
layout(set = 0, binding = 1) readonly buffer VParam { float v_param[]; };
layout(set = 0, binding = 2) buffer ExpAvg { float exp_avg[]; };
layout(set = 0, binding = 3) buffer ExpAvgSq { float exp_avg_sq[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    float v = v_param[i];
    float first = p.beta1 * exp_avg[i] + (1.0 - p.beta1) * v;
    float second = p.beta2 * exp_avg_sq[i] + (1.0 - p.beta2) * v * v;
    exp_avg[i] = first;
    exp_avg_sq[i] = second;
    float lr = i % ROW < HEAD ? p.lr : p.lr_tail;
    param[i] = p.keep * param[i] - lr * (first / p.bias1) / (sqrt(second / p.bias2) + p.eps);
}
