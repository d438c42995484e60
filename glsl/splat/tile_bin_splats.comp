#version 460
// splat/tile_bin_splats: gathers the visible splats in the order of the scene. One invocation per depth rank.
//   in   geom [N,8]   dirs [N,4]   order [N]   visible [N+1] exclusive sum of the flags by splat
//        slot_offsets [N*bands+1]   kept_slots [I+1] exclusive sum of the kept flags by slot
//   out  visible_geom [V,8] (=)   visible_dirs [V,4] (=)   splat_from_visible [V] (=)   slot_ranges [V,2] first, end
//     (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, bands; } p;
TEXELS_F32(0, geom);
TEXELS_F32(1, dirs);
TEXELS_U32(2, order);
TEXELS_U32(3, visible);
TEXELS_U32(4, slot_offsets);
TEXELS_U32(5, kept_slots);
layout(set = 0, binding = 6) buffer VisibleGeom { vec4 visible_geom[]; };
layout(set = 0, binding = 7) buffer VisibleDirs { vec4 visible_dirs[]; };
layout(set = 0, binding = 8) buffer SplatFromVisible { uint splat_from_visible[]; };
layout(set = 0, binding = 9) buffer SlotRanges { uint slot_ranges[]; };

void main() {
    uint rank = global_index();
    if (rank >= p.n) return;
    uint splat = texel_pick(order, rank);
    uint i = texel_pick(visible, splat);
    if (texel_pick(visible, splat + 1u) == i) return;
    visible_geom[2u * i] = texel_load(geom, int(2u * splat));
    visible_geom[2u * i + 1u] = texel_load(geom, int(2u * splat + 1u));
    visible_dirs[i] = texel_load(dirs, int(splat));
    splat_from_visible[i] = splat;
    slot_ranges[2u * i] = texel_pick(kept_slots, texel_pick(slot_offsets, rank * p.bands));
    slot_ranges[2u * i + 1u] = texel_pick(kept_slots, texel_pick(slot_offsets, (rank + 1u) * p.bands));
}
