#version 460
// image/noise_bwd: lets the gradient pass where image/noise_fwd did not clamp. One invocation per pixel.
//   in   x [n,4]   v_y [n,4]
//   out  v_x [n,4] (=); fourth channel 0
//   twin kernels/src/reference/image/noise.rs   the noise is drawn again, not stored
#include "lib/grid.glsl"
#include "lib/clamp01.glsl"
#include "lib/gaussian_noise.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; float sigma; uint stream, seed_low, seed_high; } p;
TEXELS_F32(0, x);
TEXELS_F32(1, v_y);
layout(set = 0, binding = 2) writeonly buffer VX { vec4 v_x[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec3 noisy = texel_load(x, int(i)).rgb + p.sigma * gaussian_noise(i, p.stream, p.seed_low, p.seed_high);
    v_x[i] = vec4(clamp01_gate(noisy, texel_load(v_y, int(i)).rgb), 0.0);
}
