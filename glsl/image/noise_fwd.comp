#version 460
// image/noise_fwd: adds N(0, sigma^2) to colour, then clamps to [0, 1]. One invocation per pixel.
//   in   x [n,4]
//   out  y [n,4] (=); the fourth channel is copied
//   twin kernels/src/reference/image/noise.rs   the noise depends on pixel index, stream and seed only
#include "lib/grid.glsl"
#include "lib/clamp01.glsl"
#include "lib/gaussian_noise.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; float sigma; uint stream, seed_low, seed_high; } p;
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec4 v = texel_load(x, int(i));
    y[i] = vec4(clamp01(v.rgb + p.sigma * gaussian_noise(i, p.stream, p.seed_low, p.seed_high)), v.a);
}
