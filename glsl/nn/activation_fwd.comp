#version 460
// nn/activation_fwd: y = act(x), act chosen by KIND. One invocation per four elements.
//   in   x [n]
//   out  y [n] (=)
//   twin kernels/src/reference/nn/activation.rs   QuickGELU: x*sigmoid(1.702x), Radford et al. 2021
#include "lib/activation.glsl"
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint KIND = 1;
layout(push_constant) uniform Params { uint n4; } p;
TEXELS_F32(0, x_tex);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    uint i = global_index();
    if (i < p.n4) {
        y[i] = activate4(KIND, texel_load(x_tex, int(i)));
    }
}
