#version 460
// splat/tile_bin_keep: which splats keep at least one pair. One invocation per depth rank.
//   in   order [N] splat of each rank   slot_offsets [N*bands+1]   kept_slots [I+1] exclusive sum of the kept flags by
//     slot
//   out  visible [N] 1 or 0 (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, bands; } p;
TEXELS_U32(0, slot_offsets);
TEXELS_U32(1, kept_slots);
TEXELS_U32(2, order);
layout(set = 0, binding = 3) buffer Visible { uint visible[]; };

void main() {
    uint rank = global_index();
    if (rank >= p.n) return;
    uint first = texel_pick(kept_slots, texel_pick(slot_offsets, rank * p.bands));
    uint last = texel_pick(kept_slots, texel_pick(slot_offsets, (rank + 1u) * p.bands));
    visible[texel_pick(order, rank)] = last > first ? 1u : 0u;
}
