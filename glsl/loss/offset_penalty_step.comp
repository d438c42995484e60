#version 460
// loss/offset_penalty_step: weighted means of squared SH offsets, DC apart from the rest, and their gradient.
//   in   offsets, N rows of OFFSET_TEXELS = n texels   v_before: v_offsets as texels
//   out  v_offsets like offsets (=), or (+=) with ACCUMULATE   partial [groups * 8] (=)
//   twin kernels/src/reference/loss/offset_penalty.rs   dc, rest: weight of one square; groups: 64 * TEXELS each
//   The texels may be a piece of more: its workgroups are numbered from first_group on.
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
layout(constant_id = 0) const uint ACCUMULATE = 0;
layout(constant_id = 1) const uint TEXELS = 16;
layout(constant_id = 2) const uint OFFSET_TEXELS = 12;
layout(push_constant) uniform Params { uint n, first_group; float dc, rest, weight; } p;
TEXELS_F32(0, offsets);
TEXELS_F32(1, v_before);
layout(set = 0, binding = 2) writeonly buffer VOffsets { vec4 v_offsets[]; };
layout(set = 0, binding = 3) writeonly buffer Partial { float partial[]; };

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint i = gl_WorkGroupID.x * 64 * TEXELS + lane;
    vec4 sum = vec4(0.0);
    uint left = TEXELS;
    do {
        if (i < p.n) {
            vec4 d = texel_load(offsets, int(i));
            vec4 share = i % OFFSET_TEXELS == 0 ? vec4(vec3(p.dc), p.rest) : vec4(p.rest);
            sum += share * d * d;
            vec4 v = 2.0 * p.weight * share * d;
            if (ACCUMULATE != 0) v += texel_load(v_before, int(i));
            v_offsets[i] = v;
        }
        i += 64;
        left--;
    } while (left > 0);
    float total = sum.x + sum.y + sum.z + sum.w;
    total += lane_shuffle_xor(total, 1);
    total += lane_shuffle_xor(total, 2);
    total += lane_shuffle_xor(total, 4);
    if (lane % 8 == 0) partial[(p.first_group + gl_WorkGroupID.x) * 8 + lane / 8] = total;
}
