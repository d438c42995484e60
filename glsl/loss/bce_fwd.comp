#version 460
// loss/bce_fwd: mean over the rows and bits of each group. One invocation per group.
//   in   logits [G,R,L]   target [L] or [G,R,L], 0 or 1
//   out  value [G] (=): mean BCE; margin: mean softplus(margin - s o); chance: mean o^2
//   twin kernels/src/reference/loss/bce.rs   groups of at most 65,535 elements (lavapipe's loop cap)
#include "lib/grid.glsl"
#include "lib/bce.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint OBJECTIVE = 0;
layout(push_constant) uniform Params { uint groups, per_group, bits, target_stride; float margin; } p;
TEXELS_F32(0, logits);
TEXELS_F32(1, target);
layout(set = 0, binding = 2) writeonly buffer Value { float value[]; };

void main() {
    uint group = global_index();
    if (group >= p.groups) return;
    float sum = 0.0;
    uint i = 0;
    do {
        uint at = group * p.per_group + i;
        float o = texel_pick(logits, at);
        float t = texel_pick(target, p.target_stride == 0 ? i % p.bits : at);
        if (OBJECTIVE == OBJECTIVE_MARGIN) sum += softplus(p.margin - (2.0 * t - 1.0) * o);
        else if (OBJECTIVE == OBJECTIVE_CHANCE) sum += o * o;
        else sum += softplus(o) - o * t;
        i++;
    } while (i < p.per_group);
    value[group] = sum / float(p.per_group);
}
