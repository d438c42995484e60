#version 460
// nn/pack_gather: a matrix W [n, k] with any strides into matmul's lane order. One invocation per packed vec4.
//   in   src, W(i, j) = src[i*stride_n + j*stride_k]
//   out  packed [ceil(n/8)][ceil(k/4)][8 lanes] vec4 (=), zero outside [n, k]
//   twin kernels/src/reference/nn/pack.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n; uint k; uint stride_n; uint stride_k; uint total; } p;
TEXELS_F32(0, src);
layout(set = 0, binding = 1) writeonly buffer Packed { vec4 packed[]; };

float at(uint row, uint col) {
    bool inside = row < p.n && col < p.k;
    float value = texel_pick(src, inside ? row * p.stride_n + col * p.stride_k : 0u);
    return inside ? value : 0.0;
}

void main() {
    uint i = global_index();
    if (i < p.total) {
        uint texels = (p.k + 3u) / 4u;
        uint row = (i / (8u * texels)) * 8u + i % 8u;
        uint col = ((i / 8u) % texels) * 4u;
        packed[i] = vec4(at(row, col), at(row, col + 1u), at(row, col + 2u), at(row, col + 3u));
    }
}
