#version 460
// loss/bce_bwd: gradient of weight * objective(value of the group). One invocation per logit.
//   in   logits [G,R,L]   target [L] or [G,R,L]   value [G] from bce_fwd
//   out  v_logits [G,R,L] (=)
//   twin kernels/src/reference/loss/bce.rs
//   inverse (Guard4D Eq. 10): 1 / (B + eps); hinge: 1 / (min(B, ln 2) + eps), so it stops at chance
#include "lib/grid.glsl"
#include "lib/bce.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint OBJECTIVE = 0;
layout(push_constant) uniform Params { uint n, per_group, bits, target_stride; float margin, eps, weight; } p;
TEXELS_F32(0, logits);
TEXELS_F32(1, target);
TEXELS_F32(2, value);
layout(set = 0, binding = 3) writeonly buffer VLogits { float v_logits[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    float o = texel_pick(logits, i);
    float t = texel_pick(target, p.target_stride == 0 ? i % p.bits : i);
    float v;
    if (OBJECTIVE == OBJECTIVE_MARGIN) {
        float s = 2.0 * t - 1.0;
        v = -s * sigmoid(p.margin - s * o);
    } else if (OBJECTIVE == OBJECTIVE_CHANCE) {
        v = 2.0 * o;
    } else {
        v = sigmoid(o) - t;
        float b = texel_pick(value, i / p.per_group);
        float inverse = 1.0 / (b + p.eps);
        if (OBJECTIVE == OBJECTIVE_INVERSE) v *= -inverse * inverse;
        if (OBJECTIVE == OBJECTIVE_HINGE) v *= b < LN2 ? -inverse * inverse : 0.0;
    }
    v_logits[i] = v * p.weight / float(p.per_group);
}
