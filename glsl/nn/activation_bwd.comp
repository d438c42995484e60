#version 460
// nn/activation_bwd: v_x = v_y * act'(x), act chosen by KIND. One invocation per four elements.
//   in   x [n] (input of the forward pass)   v_y [n]
//   out  v_x [n] (=)
//   twin kernels/src/reference/nn/activation.rs   relu'(0) = 0
#include "lib/activation.glsl"
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint KIND = 1;
layout(push_constant) uniform Params { uint n4; } p;
TEXELS_F32(0, x_tex);
TEXELS_F32(1, v_y_tex);
layout(set = 0, binding = 2) writeonly buffer VX { vec4 v_x[]; };

void main() {
    uint i = global_index();
    if (i < p.n4) {
        v_x[i] = texel_load(v_y_tex, int(i)) * activate_grad4(KIND, texel_load(x_tex, int(i)));
    }
}
