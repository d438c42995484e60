#version 460
// splat/tile_bin_order: tiles with pairs first, the others behind them, both row by row. One invocation per tile.
//   in   active_tiles [tiles+1] exclusive sum of the flags
//   out  tile_order [tiles] (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint num_tiles; } p;
TEXELS_U32(0, active_tiles);
layout(set = 0, binding = 1) buffer TileOrder { uint tile_order[]; };

void main() {
    uint tile = global_index();
    if (tile >= p.num_tiles) return;
    uint before = texel_pick(active_tiles, tile);
    bool has_pairs = texel_pick(active_tiles, tile + 1u) > before;
    tile_order[has_pairs ? before : texel_pick(active_tiles, p.num_tiles) + tile - before] = tile;
}
