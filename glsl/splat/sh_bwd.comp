#version 460
// splat/sh_bwd: gradient of the offsets from the gradient of the colours. One invocation per visible splat.
//   in   sh_coeffs [N,16,3]   offsets, N rows of OFFSET_TEXELS   dirs [V,4]   splat_from_visible [V]   v_colours [V,4]
//   in   v_before: v_offsets as texels
//   out  v_offsets like offsets += Y_j(d) v_colour, per channel zero where the colour is clamped
//   Rows of sh_coeffs and offsets are a piece of all: splats first_splat to first_splat + num_splats - 1.
//   OFFSET_TEXELS: 1 (the DC term) or 12 (like sh_coeffs)
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/sh_basis.glsl"
#include "lib/sh_colour.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint DEGREE = 3;
layout(constant_id = 1) const uint OFFSET_TEXELS = 12;
layout(push_constant) uniform Params { uint num_visible, first_splat, num_splats; float max_colour; } p;
TEXELS_F32(0, sh_coeffs);
TEXELS_F32(1, offsets);
TEXELS_F32(2, dirs);
TEXELS_F32(3, v_colours);
TEXELS_U32(4, splat_from_visible);
TEXELS_F32(5, v_before);
layout(set = 0, binding = 6) writeonly buffer VOffsets { vec4 v_offsets[]; };

void main() {
    uint i = global_index();
    if (i >= p.num_visible) return;
    uint splat = texel_pick(splat_from_visible, i) - p.first_splat;
    if (splat >= p.num_splats) return;
    uint row = 12u * splat;
    uint offset_row = OFFSET_TEXELS * splat;
    float y[16];
    sh_basis(texel_load(dirs, int(i)).xyz, DEGREE, y);
    vec4 h[12];
    [[unroll]] for (int q = 0; q < 12; ++q) {
        h[q] = q < int(sh_texels(DEGREE)) ? texel_load(sh_coeffs, int(row) + q) : vec4(0.0);
        if (OFFSET_TEXELS == 12u && q < int(sh_texels(DEGREE))) h[q] += texel_load(offsets, int(offset_row) + q);
    }
    if (OFFSET_TEXELS == 1u) h[0].xyz += texel_load(offsets, int(offset_row)).xyz;
    vec3 v = sh_v_raw(sh_raw_colour(h, y, DEGREE), texel_load(v_colours, int(i)).xyz, p.max_colour);
    if (OFFSET_TEXELS == 1u) {
        v_offsets[offset_row] = texel_load(v_before, int(offset_row)) + vec4(y[0] * v, 0.0);
    } else {
        [[unroll]] for (int q = 0; q < 12; ++q) {
            vec4 add;
            [[unroll]] for (int c = 0; c < 4; ++c)
                add[c] = 4 * q + c < 3 * int(sh_bases(DEGREE)) ? y[(4 * q + c) / 3] * v[(4 * q + c) % 3] : 0.0;
            if (q < int(sh_texels(DEGREE)))
                v_offsets[offset_row + uint(q)] = texel_load(v_before, int(offset_row) + q) + add;
        }
    }
}
