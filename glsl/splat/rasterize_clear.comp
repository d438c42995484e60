#version 460
// splat/rasterize_clear: tiles that no splat reaches show the background. One workgroup per 8x8 tile, one lane per
// column.
//   in   tile_order [tiles] the ones to clear from `num_active` on
//   out  image [..,H,W,4] = background, transmittance 1 (=), from pixel `out_offset` on
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/raster.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params {
    uint width, height, tiles_x, num_active, num_tiles, out_offset;
    float background_r, background_g, background_b;
} p;
TEXELS_U32(0, tile_order);
layout(set = 0, binding = 1) buffer Image { vec4 image[]; };

void main() {
    uint index = p.num_active + workgroup_index();
    if (index >= p.num_tiles) return;
    uint tile = texel_pick(tile_order, index);
    uint x = (tile % p.tiles_x) * 8u + gl_LocalInvocationID.x, y = (tile / p.tiles_x) * 8u;
    [[unroll]] for (uint k = 0u; k < 8u; ++k) {
        if (x < p.width && y + k < p.height) {
            image[p.out_offset + (y + k) * p.width + x] = vec4(p.background_r, p.background_g, p.background_b, 1.0);
        }
    }
}
