#version 460
// image/levels_unpack: pixels of 8 bits as numbers in [0, 1]. One invocation per pixel.
//   in   levels [n], first channel lowest
//   out  y [n,4] (=), multiples of 1/255
//   twin kernels/src/reference/image/levels.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; } p;
TEXELS_U32(0, levels);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    uint word = texel_pick(levels, i);
    y[i] = vec4(word & 255u, word >> 8 & 255u, word >> 16 & 255u, word >> 24) / 255.0;
}
