#version 460
// splat/tile_bin_active: which tiles have a pair. One invocation per tile.
//   in   tile_offsets [tiles+1]
//   out  active_tiles [tiles] 1 or 0 (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint num_tiles; } p;
TEXELS_U32(0, tile_offsets);
layout(set = 0, binding = 1) buffer Active { uint active_tiles[]; };

void main() {
    uint tile = global_index();
    if (tile >= p.num_tiles) return;
    active_tiles[tile] = texel_pick(tile_offsets, tile + 1u) > texel_pick(tile_offsets, tile) ? 1u : 0u;
}
