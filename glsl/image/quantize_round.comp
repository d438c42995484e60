#version 460
// image/quantize_round: clamps colour to [0, 1] and rounds it to 8 bits, halves up. One invocation per pixel.
//   in   x [n,4]
//   out  y [n,4] (=), multiples of 1/255; the fourth channel is copied
//   twin kernels/src/reference/image/quantize.rs   its gradient is taken as the identity
#include "lib/grid.glsl"
#include "lib/clamp01.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; } p;
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec4 v = texel_load(x, int(i));
    y[i] = vec4(floor(clamp01(v.rgb) * 255.0 + 0.5) / 255.0, v.a);
}
