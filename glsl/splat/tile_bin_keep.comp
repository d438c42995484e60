#version 460
// splat/tile_bin_keep: which splats keep at least one pair. One invocation per depth rank.
//   in   order [N] splat of each rank   slot_offsets [N*bands+1]   kept_slots [I+1] exclusive sum of the kept flags by slot
//   out  visible [N] 1 or 0 (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
layout(push_constant) uniform Params { uint n, bands; } p;
layout(set = 0, binding = 0) readonly buffer SlotOffsets { uint slot_offsets[]; };
layout(set = 0, binding = 1) readonly buffer KeptSlots { uint kept_slots[]; };
layout(set = 0, binding = 2) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 3) buffer Visible { uint visible[]; };

void main() {
    uint rank = global_index();
    if (rank >= p.n) return;
    uint first = kept_slots[slot_offsets[rank * p.bands]];
    uint last = kept_slots[slot_offsets[(rank + 1u) * p.bands]];
    visible[order[rank]] = last > first ? 1u : 0u;
}
