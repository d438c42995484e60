#version 460
// splat/warp_apply: adds the heads of a deformation MLP to activated splats, Yang et al. 2024 (Deformable 3D
// Gaussians). One invocation per splat.
//   in   means [N,4] = xyz, opacity logit   scales [N,4] log, 0   quats [N,4] wxyz
//        heads [N,16] = dx or v, 0 | ds, 0 | dr | w, 0
//   out  warped_means [N,4] (=)   warped_scales [N,4] log, 1 (=)   warped_quats [N,4], any norm, which the 1 says to
//     keep (=)
//   SCREW 0 adds dx, 1 moves by the screw with axis w / |w| and angle |w|
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/quat.glsl"
#include "lib/sincos.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint SCREW = 0;
layout(push_constant) uniform Params { uint n; } p;
TEXELS_F32(0, means);
TEXELS_F32(1, scales);
TEXELS_F32(2, quats);
TEXELS_F32(3, heads);
layout(set = 0, binding = 4) buffer WarpedMeans { vec4 warped_means[]; };
layout(set = 0, binding = 5) buffer WarpedScales { vec4 warped_scales[]; };
layout(set = 0, binding = 6) buffer WarpedQuats { vec4 warped_quats[]; };

const float LEAST_ANGLE = 1e-20;
const float NUDGE = 1e-5;
const float LEAST_SCALE = 1e-12;

// exp of the twist: rotation about w by theta, and the shift that goes with it.
vec3 screw(vec3 x, vec3 w, vec3 v) {
    float theta = sqrt(dot(w, w));
    float inverse = 1.0 / max(theta, LEAST_ANGLE);
    w = w * inverse + NUDGE;
    v = v * inverse + NUDGE;
    vec2 turn = sin_cos(theta);
    float s = turn.x, c = 1.0 - turn.y;
    vec3 wx = cross(w, x), wv = cross(w, v);
    vec3 turned = x + s * wx + c * cross(w, wx);
    return turned + theta * v + c * wv + (theta - s) * cross(w, wv);
}

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    int head = int(4u * i);
    vec4 mean = texel_load(means, int(i));
    vec3 shift = texel_load(heads, head).xyz;
    vec3 moved = SCREW == 1u ? screw(mean.xyz, texel_load(heads, head + 3).xyz, shift) : mean.xyz + shift;
    // The covariance has the square of a standard deviation, whose sign is nothing.
    vec3 scale = abs(exp(texel_load(scales, int(i)).xyz) + texel_load(heads, head + 1).xyz);
    warped_means[i] = vec4(moved, mean.w);
    warped_scales[i] = vec4(log(max(scale, LEAST_SCALE)), 1.0);
    warped_quats[i] = quat_normalize(texel_load(quats, int(i))) + texel_load(heads, head + 2);
}
