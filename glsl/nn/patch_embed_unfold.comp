#version 460
// nn/patch_embed_unfold: images into rows of patches (im2col, stride = patch). One invocation per texel of rows.
//   in   pixels [B, side, side, 4], the fourth channel is not read as data
//   out  rows [B*tokens, patch*patch*4] (=); tokens = 1 + grid*grid, row 0 of each image (class token) is zero
//   twin kernels/src/reference/nn/patch_embed.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint total; uint side; uint patch_px; } p;
TEXELS_F32(0, pixels_tex);
layout(set = 0, binding = 1) writeonly buffer Rows { vec4 rows[]; };

void main() {
    uint i = global_index();
    if (i < p.total) {
        uint grid = p.side / p.patch_px;
        uint texels = p.patch_px * p.patch_px;
        uint tokens = grid * grid + 1u;
        uint row = i / texels;
        uint token = row % tokens;
        uint cell = max(token, 1u) - 1u;
        uint y = (cell / grid) * p.patch_px + (i % texels) / p.patch_px;
        uint x = (cell % grid) * p.patch_px + i % p.patch_px;
        vec3 rgb = texel_load(pixels_tex, int(((row / tokens) * p.side + y) * p.side + x)).rgb;
        rows[i] = token == 0u ? vec4(0.0) : vec4(rgb, 0.0);
    }
}
