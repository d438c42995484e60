#version 460
// splat/tile_bin_ranges: first pair of each tile in the sorted list, by binary search. One invocation per boundary.
//   in   tile_keys [I] ascending
//   out  tile_offsets [tiles+1] (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint num_tiles, num_isects; } p;
TEXELS_U32(0, tile_keys);
layout(set = 0, binding = 1) buffer TileOffsets { uint tile_offsets[]; };

void main() {
    uint tile = global_index();
    if (tile > p.num_tiles) return;
    uint low = 0u, high = p.num_isects;
    // 32 halvings empty any range of 32-bit indices.
    for (uint step = 0u; step < 32u; ++step) {
        uint mid = low + (high - low) / 2u;
        bool open = low < high;
        bool right = open && texel_pick(tile_keys, open ? mid : 0u) < tile;
        low = right ? mid + 1u : low;
        high = open && !right ? mid : high;
    }
    tile_offsets[tile] = low;
}
