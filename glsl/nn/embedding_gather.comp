#version 460
// nn/embedding_gather: token plus position embedding. One invocation per four elements of y.
//   in   ids [rows], each < vocab   table [vocab, width]   position [tokens, width]
//   out  y [rows, width] (=)   y[r] = table[ids[r]] + position[r mod tokens]
//   twin kernels/src/reference/nn/embedding.rs   an id >= vocab reads the last row; the host refuses it first
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint rows; uint tokens; uint width; uint vocab; } p;
TEXELS_U32(0, ids);
TEXELS_F32(1, table_tex);
TEXELS_F32(2, position_tex);
layout(set = 0, binding = 3) writeonly buffer Y { vec4 y[]; };

void main() {
    uint texels = p.width / 4u;
    uint i = global_index();
    if (i < p.rows * texels) {
        uint row = i / texels;
        uint t = i % texels;
        uint id = min(texel_pick(ids, row), p.vocab - 1u);
        y[i] = texel_load(table_tex, int(id * texels + t)) +
               texel_load(position_tex, int((row % p.tokens) * texels + t));
    }
}
