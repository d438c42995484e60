#version 460
// splat/dc_colour_fwd: colour of each visible splat from what does not depend on DC offsets. One invocation per visible
// splat.
//   in   base [V,4] unmarked colour before the clamp   offsets [N,4] of the DC term   splat_from_visible [V]
//   out  colours [V,4] = max(0, base + Y_0 delta), at most max_colour, NaN stays, 4th channel 0 (=)
//   HAS_OFFSETS: 0 leaves them out
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/sh_basis.glsl"
#include "lib/sh_colour.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint HAS_OFFSETS = 1;
layout(push_constant) uniform Params { uint num_visible; float max_colour; } p;
TEXELS_F32(0, base);
TEXELS_F32(1, offsets);
TEXELS_U32(2, splat_from_visible);
layout(set = 0, binding = 3) buffer Colours { vec4 colours[]; };

void main() {
    uint i = global_index();
    if (i >= p.num_visible) return;
    vec3 raw = texel_load(base, int(i)).xyz;
    if (HAS_OFFSETS == 1u) raw += SH_CONSTANT * texel_load(offsets, int(texel_pick(splat_from_visible, i))).xyz;
    colours[i] = vec4(sh_clamped(raw, p.max_colour), 0.0);
}
