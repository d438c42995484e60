#version 460
// splat/tile_bin_active: which tiles have a pair. One invocation per tile.
//   in   tile_offsets [tiles+1]
//   out  active_tiles [tiles] 1 or 0 (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
layout(push_constant) uniform Params { uint num_tiles; } p;
layout(set = 0, binding = 0) readonly buffer TileOffsets { uint tile_offsets[]; };
layout(set = 0, binding = 1) buffer Active { uint active_tiles[]; };

void main() {
    uint tile = global_index();
    if (tile >= p.num_tiles) return;
    active_tiles[tile] = tile_offsets[tile + 1u] > tile_offsets[tile] ? 1u : 0u;
}
