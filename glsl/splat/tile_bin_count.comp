#version 460
// splat/tile_bin_count: 8x8 tiles that each splat can reach, in depth order. One invocation per (rank, band of tile
// rows).
//   in   geom [N,8]   tile_rects [N,4]   order [N] splat of each depth rank
//   out  counts [N*bands] (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/tile_cull.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, bands, band_rows; } p;
TEXELS_F32(0, geom);
TEXELS_U32(1, tile_rects);
TEXELS_U32(2, order);
layout(set = 0, binding = 3) buffer Counts { uint counts[]; };

void main() {
    uint i = global_index();
    if (i >= p.n * p.bands) return;
    uint band = i % p.bands, splat = texel_pick(order, i / p.bands);
    uvec4 rect = texel_load(tile_rects, int(splat));
    uint first = clamp(band * p.band_rows, rect.y, rect.w), last = clamp((band + 1u) * p.band_rows, rect.y, rect.w);
    TileTest test = tile_test(texel_load(geom, int(2u * splat)), texel_load(geom, int(2u * splat + 1u)));
    uint total = (rect.z - rect.x) * (last - first), count = 0u, j = 0u;
    uvec2 tile = uvec2(rect.x, first);
    do {
        count += j < total && tile_reached(test, tile) ? 1u : 0u;
        bool wrap = tile.x + 1u >= rect.z;
        tile = uvec2(wrap ? rect.x : tile.x + 1u, wrap ? tile.y + 1u : tile.y);
        ++j;
    } while (j < total);
    counts[i] = count;
}
