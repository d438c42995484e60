#version 460
// image/levels_pack: clamps pixels to [0, 1] and rounds them to 8 bits, halves up, a word each. One invocation per
// pixel.
//   in   x [n,4]
//   out  levels [n] (=), first channel lowest; NaN, for which 8 bits have no room, becomes 0
//   twin kernels/src/reference/image/levels.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; } p;
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Levels { uint levels[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec4 v = texel_load(x, int(i));
    // Comparisons with NaN are false, so that it falls to 0.
    vec4 within = mix(vec4(0.0), min(v, 1.0), greaterThan(v, vec4(0.0)));
    uvec4 level = uvec4(floor(within * 255.0 + 0.5));
    levels[i] = level.x | level.y << 8 | level.z << 16 | level.w << 24;
}
