#version 460
// optim/neighbour_mean_mix: rows mixed with the mean of their neighbours' rows, which smooths a field over scattered points.
// One invocation per texel of four elements.
//   in   base [n, row]: these rows themselves, or what earlier parts made of them   neighbours [n, K]
//   in   rows [part, row]: the rows from first_row on; neighbours outside this part add nothing
//   out  mixed [n, row] (=)   mixed_i = keep base_i + share sum_j rows_j, in the order of the neighbours
//   twin kernels/src/reference/optim/neighbour_mean.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint ROW_TEXELS = 1;
layout(constant_id = 1) const uint K = 1;
layout(push_constant) uniform Params { uint texels, first_row, part; float keep, share; } p;
TEXELS_F32(0, base);
TEXELS_F32(1, rows);
TEXELS_U32(2, neighbours);
layout(set = 0, binding = 3) writeonly buffer Mixed { vec4 mixed[]; };

void main() {
    uint i = global_index();
    if (i >= p.texels) return;
    uint row = i / ROW_TEXELS;
    uint column = i % ROW_TEXELS;
    // Each product and sum is rounded, so that parts give the bits of the whole.
    precise vec4 sum = p.keep * texel_load(base, int(i));
    for (uint k = 0; k < K; ++k) {
        // One before first_row wraps to more than any part has.
        uint at = texel_pick(neighbours, row * K + k) - p.first_row;
        if (at < p.part) sum += p.share * texel_load(rows, int(at * ROW_TEXELS + column));
    }
    mixed[i] = sum;
}
