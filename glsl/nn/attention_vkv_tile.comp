#version 460
// nn/attention_vkv_tile: nn/attention_vkv for GPUs. One workgroup per (32 keys, head, image), 32 queries at a time.
//   in   q, k, v and lse as in attention_fwd   v_attn [B*queries, heads*HEAD_DIM]   delta [B, heads, queries]
//   out  v_kv rows [B*keys, kv_stride texels] (=), the key and value parts only
//   v_v = P^T*v_attn, v_k = scale * dS^T*Q, one after the other through the same shared memory (Dao et al. 2022,
//     algorithm 4).
//   twin kernels/src/reference/nn/attention.rs   14.5 KiB shared; rows of a tile are keys here, columns are queries
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 128) in;
layout(constant_id = 0) const int HEAD_DIM = 64;
layout(constant_id = 1) const uint CAUSAL = 0;
layout(push_constant) uniform Params {
    int queries; int keys; int q_stride; int kv_stride; int k_offset; int v_offset; float scale;
} p;
layout(set = 0, binding = 0) readonly buffer Q { vec4 q[]; };
layout(set = 0, binding = 1) readonly buffer Kv { vec4 kv[]; };
layout(set = 0, binding = 2) readonly buffer VAttn { vec4 v_attn[]; };
layout(set = 0, binding = 3) readonly buffer Lse { float lse[]; };
layout(set = 0, binding = 4) readonly buffer Delta { float delta[]; };
layout(set = 0, binding = 5) writeonly buffer VKv { vec4 v_kv[]; };

int seen_from; // first query that sees row 0 of the tile, counted from the tile of queries in hand
#define SEEN(row, column) (CAUSAL == 0u || (column) >= seen_from + (row))
#define OPERANDS 4
#include "lib/attention_block.glsl"

void main() {
    int id = int(gl_LocalInvocationID.x);
    int row0 = int(gl_WorkGroupID.x) * TILE;
    int head = int(gl_WorkGroupID.y);
    int heads = int(gl_NumWorkGroups.y);
    int image = int(gl_WorkGroupID.z);
    int q_base = image * p.queries * p.q_stride + head * TEXELS;
    int g_stride = heads * TEXELS;
    int g_base = image * p.queries * g_stride + head * TEXELS;
    int k_base = image * p.keys * p.kv_stride + p.k_offset + head * TEXELS;
    int v_base = image * p.keys * p.kv_stride + p.v_offset + head * TEXELS;
    int stat = (image * heads + head) * p.queries;
    int diagonal = row0 - (p.keys - p.queries);
    vec4 acc_k[SUMS];
    vec4 acc_v[SUMS];
    [[unroll]] for (int i = 0; i < SUMS; ++i) {
        acc_k[i] = vec4(0.0);
        acc_v[i] = vec4(0.0);
    }
    int query0 = CAUSAL == 1u ? max(diagonal, 0) : 0;
    do {
        float s[8] = float[8](0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        float dp[8] = s;
        int chunk = 0;
        do {
            LOAD_CHUNK(0, kv, k_base, p.kv_stride, row0, p.keys, chunk)
            LOAD_CHUNK(1, q, q_base, p.q_stride, query0, p.queries, chunk)
            LOAD_CHUNK(2, kv, v_base, p.kv_stride, row0, p.keys, chunk)
            LOAD_CHUNK(3, v_attn, g_base, g_stride, query0, p.queries, chunk)
            barrier();
            add_scores(s, id, 0, 1);
            add_scores(dp, id, 2, 3);
            barrier();
        } while (++chunk * CHUNK < TEXELS);
        seen_from = diagonal - query0;
        [[unroll]] for (int i = 0; i < 8; ++i) {
            int column = id % 8 + 8 * (i % 4);
            int query = min(query0 + column, p.queries - 1);
            bool counts = query0 + column < p.queries && SEEN(id / 8 + 16 * (i / 4), column);
            float weight = exp2_or_nan(s[i] * (p.scale * LOG2_E) - lse[stat + query]);
            float slope = weight * (dp[i] - delta[stat + query]);
            s[i] = counts ? weight : 0.0;
            dp[i] = counts ? slope : 0.0;
        }
        put_weights(s, id);
        [[unroll]] for (int slice = 0; slice < SLICES; ++slice) {
            LOAD_SLICE(v_attn, g_base, g_stride, query0, p.queries, slice)
            barrier();
            add_products(acc_v, id, slice);
            barrier();
        }
        put_weights(dp, id);
        [[unroll]] for (int slice = 0; slice < SLICES; ++slice) {
            LOAD_SLICE(q, q_base, p.q_stride, query0, p.queries, slice)
            barrier();
            add_products(acc_k, id, slice);
            barrier();
        }
        query0 += TILE;
    } while (query0 < p.queries);

    [[unroll]] for (int r = 0; r < 4; ++r) {
        int row = row0 + 4 * (id / SLICE) + r;
        [[unroll]] for (int slice = 0; slice < SLICES; ++slice) {
            int texel = slice * SLICE + id % SLICE;
            if (row < p.keys && texel < TEXELS) {
                v_kv[k_base + row * p.kv_stride + texel] = acc_k[4 * slice + r] * p.scale;
                v_kv[v_base + row * p.kv_stride + texel] = acc_v[4 * slice + r];
            }
        }
    }
}
