#version 460
// splat/tile_bin_pairs: compacts the sorted pairs that are kept. One invocation per pair.
//   in   slots [I] slot of each sorted pair   splat_from_slot [I]   visible [N+1] exclusive sum of the flags by splat
//        kept_isects, kept_slots [I+1] exclusive sums of the kept flags
//        slot_ranges [V,2] first, end
//   out  splat_from_isect [I'] visible index, packed with the place of its slot where PACKED (=)
//        slot_from_isect [I'] (=), not where PACKED
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint PACKED = 1;
#include "lib/isect.glsl"
layout(push_constant) uniform Params { uint num_isects; } p;
TEXELS_U32(0, slots);
TEXELS_U32(1, splat_from_slot);
TEXELS_U32(2, visible);
TEXELS_U32(3, kept_isects);
TEXELS_U32(4, kept_slots);
TEXELS_U32(7, slot_ranges);
layout(set = 0, binding = 5) buffer SplatFromIsect { uint splat_from_isect[]; };
layout(set = 0, binding = 6) buffer SlotFromIsect { uint slot_from_isect[]; };

void main() {
    uint i = global_index();
    if (i >= p.num_isects) return;
    uint to = texel_pick(kept_isects, i);
    if (texel_pick(kept_isects, i + 1u) == to) return;
    uint slot = texel_pick(slots, i);
    uint splat = texel_pick(visible, texel_pick(splat_from_slot, slot));
    uint kept = texel_pick(kept_slots, slot);
    splat_from_isect[to] = isect_word(splat, kept - texel_pick(slot_ranges, 2u * splat));
    if (PACKED == 0u) slot_from_isect[to] = kept;
}
