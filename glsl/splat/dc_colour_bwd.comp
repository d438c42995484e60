#version 460
// splat/dc_colour_bwd: gradient of the DC offsets from the gradient of the colours. One invocation per visible splat.
//   in   base [V,4] unmarked colour before the clamp   offsets [N,4] of the DC term   splat_from_visible [V]
//     v_colours [V,4]
//   in   v_before: v_offsets as texels
//   out  v_offsets [N,4] += Y_0 v_colour, per channel zero where the colour is clamped
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/sh_basis.glsl"
#include "lib/sh_colour.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint num_visible; float max_colour; } p;
TEXELS_F32(0, base);
TEXELS_F32(1, offsets);
TEXELS_F32(2, v_colours);
TEXELS_U32(3, splat_from_visible);
TEXELS_F32(4, v_before);
layout(set = 0, binding = 5) writeonly buffer VOffsets { vec4 v_offsets[]; };

void main() {
    uint i = global_index();
    if (i >= p.num_visible) return;
    int splat = int(texel_pick(splat_from_visible, i));
    vec3 raw = texel_load(base, int(i)).xyz + SH_CONSTANT * texel_load(offsets, splat).xyz;
    vec3 v = sh_v_raw(raw, texel_load(v_colours, int(i)).xyz, p.max_colour);
    v_offsets[splat] = texel_load(v_before, splat) + vec4(SH_CONSTANT * v, 0.0);
}
