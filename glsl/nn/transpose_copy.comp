#version 460
// nn/transpose_copy: y = xT with rows padded by zeros. One invocation per four elements of y.
//   in   x [rows, cols]
//   out  y [cols, ceil4(rows)] (=), zero in the padding
//   twin kernels/src/reference/nn/transpose.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint rows; uint cols; } p;
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

float at(uint row, uint col) {
    bool inside = row < p.rows;
    float value = texel_pick(x, (inside ? row : 0u) * p.cols + col);
    return inside ? value : 0.0;
}

void main() {
    uint i = global_index();
    uint texels = (p.rows + 3u) / 4u;
    if (i < texels * p.cols) {
        uint col = i / texels;
        uint row = (i % texels) * 4u;
        y[i] = vec4(at(row, col), at(row + 1u, col), at(row + 2u, col), at(row + 3u, col));
    }
}
