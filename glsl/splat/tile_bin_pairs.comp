#version 460
// splat/tile_bin_pairs: compacts the sorted pairs that are kept. One invocation per pair.
//   in   slots [I] slot of each sorted pair   splat_from_slot [I]   visible [N+1] exclusive sum of the flags by splat
//        kept_isects, kept_slots [I+1] exclusive sums of the kept flags
//   out  splat_from_isect [I'] visible index (=)   slot_from_isect [I'] (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint num_isects; } p;
TEXELS_U32(0, slots);
TEXELS_U32(1, splat_from_slot);
TEXELS_U32(2, visible);
TEXELS_U32(3, kept_isects);
TEXELS_U32(4, kept_slots);
layout(set = 0, binding = 5) buffer SplatFromIsect { uint splat_from_isect[]; };
layout(set = 0, binding = 6) buffer SlotFromIsect { uint slot_from_isect[]; };

void main() {
    uint i = global_index();
    if (i >= p.num_isects) return;
    uint to = texel_pick(kept_isects, i);
    if (texel_pick(kept_isects, i + 1u) == to) return;
    uint slot = texel_pick(slots, i);
    splat_from_isect[to] = texel_pick(visible, texel_pick(splat_from_slot, slot));
    slot_from_isect[to] = texel_pick(kept_slots, slot);
}
