#version 460
// splat/trajectory_fwd: splats on polynomial paths at one time, Li et al. 2024 (SpacetimeGaussians). One invocation per
// splat.
//   in   means [N,4] = xyz, opacity logit   quats [N,4] wxyz
//        paths [N,16] = motion dt, centre | motion dt^2, 1/duration | motion dt^3, 0 | turn wxyz
//   out  moved_means, moved_quats [N,4] (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/sigmoid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; float time; } p;
TEXELS_F32(0, means);
TEXELS_F32(1, quats);
TEXELS_F32(2, paths);
layout(set = 0, binding = 3) buffer MovedMeans { vec4 moved_means[]; };
layout(set = 0, binding = 4) buffer MovedQuats { vec4 moved_quats[]; };

// Logit of sigmoid(logit) * exp(-falloff), without the difference of numbers close to 1. Drivers may lose a NaN on the
// way.
float faded(float logit, float falloff) {
    if (isnan(falloff)) return falloff;
    float gone = 1.0 - exp(-falloff);
    return -softplus(-logit) - falloff - log(sigmoid(-logit) + sigmoid(logit) * gone);
}

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    int path = int(4u * i);
    vec4 mean = texel_load(means, int(i));
    vec4 first = texel_load(paths, path), second = texel_load(paths, path + 1), third = texel_load(paths, path + 2);
    float dt = p.time - first.w;
    float steps = dt * second.w;
    vec3 position = mean.xyz + dt * (first.xyz + dt * (second.xyz + dt * third.xyz));
    moved_means[i] = vec4(position, faded(mean.w, steps * steps));
    moved_quats[i] = texel_load(quats, int(i)) + dt * texel_load(paths, path + 3);
}
