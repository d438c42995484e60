#version 460
// splat/tile_bin_splats: gathers the visible splats in depth order. One invocation per rank.
//   in   geom [N,8]   dirs [N,4]   order [N]   visible [N+1] exclusive sum of the flags   slot_offsets, kept_slots as in tile_bin_keep
//   out  visible_geom [V,8] (=)   visible_dirs [V,4] (=)   splat_from_visible [V] (=)   visible_offsets [V+1] slots (=)
//        visible_from_splat [N] for visible splats (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
layout(push_constant) uniform Params { uint n, bands; } p;
layout(set = 0, binding = 0, rgba32f) uniform readonly imageBuffer geom;
layout(set = 0, binding = 1, rgba32f) uniform readonly imageBuffer dirs;
layout(set = 0, binding = 2) readonly buffer Order { uint order[]; };
layout(set = 0, binding = 3) readonly buffer Visible { uint visible[]; };
layout(set = 0, binding = 4) readonly buffer SlotOffsets { uint slot_offsets[]; };
layout(set = 0, binding = 5) readonly buffer KeptSlots { uint kept_slots[]; };
layout(set = 0, binding = 6) buffer VisibleGeom { vec4 visible_geom[]; };
layout(set = 0, binding = 7) buffer VisibleDirs { vec4 visible_dirs[]; };
layout(set = 0, binding = 8) buffer SplatFromVisible { uint splat_from_visible[]; };
layout(set = 0, binding = 9) buffer VisibleOffsets { uint visible_offsets[]; };
layout(set = 0, binding = 10) buffer VisibleFromSplat { uint visible_from_splat[]; };

void main() {
    uint rank = global_index();
    if (rank >= p.n) return;
    uint i = visible[rank];
    if (visible[rank + 1u] == i) return;
    uint splat = order[rank];
    visible_geom[2u * i] = imageLoad(geom, int(2u * splat));
    visible_geom[2u * i + 1u] = imageLoad(geom, int(2u * splat + 1u));
    visible_dirs[i] = imageLoad(dirs, int(splat));
    splat_from_visible[i] = splat;
    visible_from_splat[splat] = i;
    if (i == 0u) visible_offsets[0] = 0u;
    // Ranks between this one and the next visible one keep no slot.
    visible_offsets[i + 1u] = kept_slots[slot_offsets[(rank + 1u) * p.bands]];
}
