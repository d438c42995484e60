#version 460
// splat/deform_apply: adds the deformation heads to the raw splats, Wu et al. 2024 (4DGaussians). One invocation per
// splat.
//   in   means [N,4] = xyz, opacity logit   scales [N,4] log   quats [N,4] wxyz
//        heads [N,4*head_texels] = dx, do | ds, 0 | dr | dsh [16,3] when present; an unused head is zero
//   out  deformed_means, deformed_scales, deformed_quats [N,4] (=)
//   ROTATION 0 keeps the quaternion, 1 adds dr, 2 normalises the product quat dr
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/quat.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint ROTATION = 1;
layout(push_constant) uniform Params { uint n, head_texels; } p;
TEXELS_F32(0, means);
TEXELS_F32(1, scales);
TEXELS_F32(2, quats);
TEXELS_F32(3, heads);
layout(set = 0, binding = 4) buffer DeformedMeans { vec4 deformed_means[]; };
layout(set = 0, binding = 5) buffer DeformedScales { vec4 deformed_scales[]; };
layout(set = 0, binding = 6) buffer DeformedQuats { vec4 deformed_quats[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    int head = int(i * p.head_texels);
    vec4 quat = texel_load(quats, int(i)), turn = texel_load(heads, head + 2);
    deformed_means[i] = texel_load(means, int(i)) + texel_load(heads, head);
    deformed_scales[i] = texel_load(scales, int(i)) + texel_load(heads, head + 1);
    if (ROTATION == 1u) quat += turn;
    if (ROTATION == 2u) quat = quat_normalize(quat_mul(quat, turn));
    deformed_quats[i] = quat;
}
