#version 460
// nn/patch_embed_fold: adjoint of patch_embed_unfold. One invocation per pixel.
//   in   v_rows [B*tokens, patch*patch*4], tokens = 1 + grid*grid
//   out  v_pixels [B, side, side, 4] (=); fourth channel zero; pixels outside the grid of whole patches zero
//   twin kernels/src/reference/nn/patch_embed.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint total; uint side; uint patch_px; } p;
TEXELS_F32(0, v_rows_tex);
layout(set = 0, binding = 1) writeonly buffer VPixels { vec4 v_pixels[]; };

void main() {
    uint i = global_index();
    if (i < p.total) {
        uint grid = p.side / p.patch_px;
        uint x = i % p.side;
        uint y = (i / p.side) % p.side;
        uint image = i / (p.side * p.side);
        uint cell_x = min(x / p.patch_px, grid - 1u);
        uint cell_y = min(y / p.patch_px, grid - 1u);
        uint row = image * (grid * grid + 1u) + 1u + cell_y * grid + cell_x;
        uint texel = (y % p.patch_px) * p.patch_px + x % p.patch_px;
        vec3 v = texel_load(v_rows_tex, int(row * p.patch_px * p.patch_px + texel)).rgb;
        bool inside = x < grid * p.patch_px && y < grid * p.patch_px;
        v_pixels[i] = inside ? vec4(v, 0.0) : vec4(0.0);
    }
}
