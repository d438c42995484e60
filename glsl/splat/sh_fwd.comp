#version 460
// splat/sh_fwd: view-dependent colour of each visible splat, Kerbl et al. 2023. One invocation per visible splat.
//   in   sh_coeffs [N,16,3]   offsets, N rows of OFFSET_TEXELS   dirs [V,4] unit   splat_from_visible [V]
//   out  colours [V,4] = max(0, 1/2 + sum_j Y_j(d) (h_j + delta_j)), at most max_colour, NaN stays, 4th channel 0 (=)
//   Rows of sh_coeffs and offsets are a piece of all: splats first_splat to first_splat + num_splats - 1.
//   OFFSET_TEXELS: 0, 1 (the DC term) or 12 (like sh_coeffs)   CLAMP: 0 leaves out both
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/sh_basis.glsl"
#include "lib/sh_colour.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint DEGREE = 3;
layout(constant_id = 1) const uint OFFSET_TEXELS = 12;
layout(constant_id = 2) const uint CLAMP = 1;
layout(push_constant) uniform Params { uint num_visible, first_splat, num_splats; float max_colour; } p;
TEXELS_F32(0, sh_coeffs);
TEXELS_F32(1, offsets);
TEXELS_F32(2, dirs);
TEXELS_U32(3, splat_from_visible);
layout(set = 0, binding = 4) buffer Colours { vec4 colours[]; };

void main() {
    uint i = global_index();
    if (i >= p.num_visible) return;
    uint splat = texel_pick(splat_from_visible, i) - p.first_splat;
    if (splat >= p.num_splats) return;
    int row = int(12u * splat);
    int offset_row = int(OFFSET_TEXELS * splat);
    float y[16];
    sh_basis(texel_load(dirs, int(i)).xyz, DEGREE, y);
    vec4 h[12];
    [[unroll]] for (int q = 0; q < 12; ++q) {
        h[q] = q < int(sh_texels(DEGREE)) ? texel_load(sh_coeffs, row + q) : vec4(0.0);
        if (OFFSET_TEXELS == 12u && q < int(sh_texels(DEGREE))) h[q] += texel_load(offsets, offset_row + q);
    }
    if (OFFSET_TEXELS == 1u) h[0].xyz += texel_load(offsets, offset_row).xyz;
    vec3 raw = sh_raw_colour(h, y, DEGREE);
    colours[i] = vec4(CLAMP == 1u ? sh_clamped(raw, p.max_colour) : raw, 0.0);
}
