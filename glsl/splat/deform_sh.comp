#version 460
// splat/deform_sh: adds the SH head to the coefficients, Wu et al. 2024 (4DGaussians). One invocation per texel.
//   in   sh_coeffs [N,16,3]   heads [N,4*head_texels] = 12 of deform_apply, then dsh [16,3]
//   out  deformed_sh [N,16,3] (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint num_texels, head_texels; } p;
TEXELS_F32(0, sh_coeffs);
TEXELS_F32(1, heads);
layout(set = 0, binding = 2) buffer DeformedSh { vec4 deformed_sh[]; };

void main() {
    uint i = global_index();
    if (i >= p.num_texels) return;
    uint splat = i / 12u, texel = i % 12u;
    deformed_sh[i] = texel_load(sh_coeffs, int(i)) + texel_load(heads, int(p.head_texels * splat + 3u + texel));
}
