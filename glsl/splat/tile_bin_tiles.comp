#version 460
// splat/tile_bin_tiles: tile boundaries after the pairs were compacted. One invocation per boundary.
//   in   tile_offsets [tiles+1]   kept_isects [I+1] exclusive sum of the kept flags
//   out  kept_tile_offsets [tiles+1] (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint num_tiles; } p;
TEXELS_U32(0, tile_offsets);
TEXELS_U32(1, kept_isects);
layout(set = 0, binding = 2) buffer KeptTileOffsets { uint kept_tile_offsets[]; };

void main() {
    uint tile = global_index();
    if (tile > p.num_tiles) return;
    kept_tile_offsets[tile] = texel_pick(kept_isects, texel_pick(tile_offsets, tile));
}
