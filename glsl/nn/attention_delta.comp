#version 460
// nn/attention_delta: delta = v_attn . attn per query and head, the softmax backward's row term. One invocation per
// (query, head).
//   in   attn [B*queries, heads*HEAD_DIM]   v_attn like attn
//   out  delta [B, heads, queries] (=)
//   twin kernels/src/reference/nn/attention.rs   Dao et al. 2022, appendix B.4
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const int HEAD_DIM = 64;
layout(push_constant) uniform Params { uint total; uint heads; uint queries; } p;
TEXELS_F32(0, attn_tex);
TEXELS_F32(1, v_attn_tex);
layout(set = 0, binding = 2) writeonly buffer Delta { float delta[]; };

void main() {
    uint i = global_index();
    int at = int(min(i, p.total - 1u)) * (HEAD_DIM / 4);
    vec4 sum = vec4(0.0);
    int t = 0;
    do {
        sum += texel_load(attn_tex, at + t) * texel_load(v_attn_tex, at + t);
    } while (++t < HEAD_DIM / 4);
    if (i < p.total) {
        uint row = i / p.heads;
        delta[((row / p.queries) * p.heads + i % p.heads) * p.queries + row % p.queries] =
            sum.x + sum.y + sum.z + sum.w;
    }
}
