#version 460
// splat/tile_bin_emit: writes the (tile, splat) pairs that tile_bin_count counted, by depth rank.
//   in   geom [N,8]   tile_rects [N,4]   order [N]   slot_offsets [N*bands+1] exclusive sum of the counts
//   out  tile_keys [I] tile index (=)   slots [I] = slot (=)   splat_from_slot [I] (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/tile_cull.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, bands, band_rows, tiles_x; } p;
TEXELS_F32(0, geom);
TEXELS_U32(1, tile_rects);
TEXELS_U32(2, order);
TEXELS_U32(3, slot_offsets);
layout(set = 0, binding = 4) buffer TileKeys { uint tile_keys[]; };
layout(set = 0, binding = 5) buffer Slots { uint slots[]; };
layout(set = 0, binding = 6) buffer SplatFromSlot { uint splat_from_slot[]; };

void main() {
    uint i = global_index();
    if (i >= p.n * p.bands) return;
    uint band = i % p.bands, splat = texel_pick(order, i / p.bands);
    uvec4 rect = texel_load(tile_rects, int(splat));
    uint first = clamp(band * p.band_rows, rect.y, rect.w), last = clamp((band + 1u) * p.band_rows, rect.y, rect.w);
    TileTest test = tile_test(texel_load(geom, int(2u * splat)), texel_load(geom, int(2u * splat + 1u)));
    uint total = (rect.z - rect.x) * (last - first), j = 0u;
    uint slot = texel_pick(slot_offsets, i), end = texel_pick(slot_offsets, i + 1u);
    uvec2 tile = uvec2(rect.x, first);
    do {
        if (j < total && slot < end && tile_reached(test, tile)) {
            tile_keys[slot] = tile.y * p.tiles_x + tile.x;
            slots[slot] = slot;
            splat_from_slot[slot] = splat;
            ++slot;
        }
        bool wrap = tile.x + 1u >= rect.z;
        tile = uvec2(wrap ? rect.x : tile.x + 1u, wrap ? tile.y + 1u : tile.y);
        ++j;
    } while (j < total);
}
