#version 460
// splat/tile_bin_pairs: compacts the sorted pairs that are kept. One invocation per pair.
//   in   slots [I] slot of each sorted pair   splat_from_slot [I]   visible [N+1] exclusive sum of the flags by splat
//        kept_isects, kept_slots [I+1] exclusive sums of the kept flags
//   out  splat_from_isect [I'] visible index (=)   slot_from_isect [I'] (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
layout(push_constant) uniform Params { uint num_isects; } p;
layout(set = 0, binding = 0) readonly buffer Slots { uint slots[]; };
layout(set = 0, binding = 1) readonly buffer SplatFromSlot { uint splat_from_slot[]; };
layout(set = 0, binding = 2) readonly buffer Visible { uint visible[]; };
layout(set = 0, binding = 3) readonly buffer KeptIsects { uint kept_isects[]; };
layout(set = 0, binding = 4) readonly buffer KeptSlots { uint kept_slots[]; };
layout(set = 0, binding = 5) buffer SplatFromIsect { uint splat_from_isect[]; };
layout(set = 0, binding = 6) buffer SlotFromIsect { uint slot_from_isect[]; };

void main() {
    uint i = global_index();
    if (i >= p.num_isects) return;
    uint to = kept_isects[i];
    if (kept_isects[i + 1u] == to) return;
    uint slot = slots[i];
    splat_from_isect[to] = visible[splat_from_slot[slot]];
    slot_from_isect[to] = kept_slots[slot];
}
