#version 460
// nn/attention_vq_tile: nn/attention_vq for GPUs. One workgroup per (32 queries, head, image), 32 keys at a time.
//   in   q, k, v and lse as in attention_fwd   v_attn [B*queries, heads*HEAD_DIM]   delta [B, heads, queries]
//   out  v_q rows [B*queries, q_stride texels] (=), the query part only
//   dS = P*(v_attn.V - delta), v_q = scale * dS*K (Dao et al. 2022, algorithm 4).
//   twin kernels/src/reference/nn/attention.rs   14.5 KiB shared
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
layout(set = 0, binding = 5) writeonly buffer VQ { vec4 v_q[]; };

int hidden_from; // first key that row 0 of the tile does not see, counted from the tile of keys in hand
#define SEEN(row, column) (CAUSAL == 0u || (column) < hidden_from + (row))
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
    int past_diagonal = p.keys - p.queries + row0 + 1;
    int key_end = CAUSAL == 1u ? min(p.keys, past_diagonal + TILE - 1) : p.keys;
    int stat = (image * heads + head) * p.queries;
    float row_lse[2];
    float row_delta[2];
    [[unroll]] for (int i = 0; i < 2; ++i) {
        int row = min(row0 + id / 8 + 16 * i, p.queries - 1);
        row_lse[i] = lse[stat + row];
        row_delta[i] = delta[stat + row];
    }
    vec4 acc[SUMS];
    [[unroll]] for (int i = 0; i < SUMS; ++i) {
        acc[i] = vec4(0.0);
    }
    int key0 = 0;
    do {
        float s[8] = float[8](0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        float dp[8] = s;
        int chunk = 0;
        do {
            LOAD_CHUNK(0, q, q_base, p.q_stride, row0, p.queries, chunk)
            LOAD_CHUNK(1, kv, k_base, p.kv_stride, key0, p.keys, chunk)
            LOAD_CHUNK(2, v_attn, g_base, g_stride, row0, p.queries, chunk)
            LOAD_CHUNK(3, kv, v_base, p.kv_stride, key0, p.keys, chunk)
            barrier();
            add_scores(s, id, 0, 1);
            add_scores(dp, id, 2, 3);
            barrier();
        } while (++chunk * CHUNK < TEXELS);
        hidden_from = past_diagonal - key0;
        [[unroll]] for (int i = 0; i < 8; ++i) {
            int column = id % 8 + 8 * (i % 4);
            bool counts = key0 + column < p.keys && SEEN(id / 8 + 16 * (i / 4), column);
            float slope = exp2_or_nan(s[i] * (p.scale * LOG2_E) - row_lse[i / 4]) * (dp[i] - row_delta[i / 4]);
            s[i] = counts ? slope : 0.0;
        }
        put_weights(s, id);
        [[unroll]] for (int slice = 0; slice < SLICES; ++slice) {
            LOAD_SLICE(kv, k_base, p.kv_stride, key0, p.keys, slice)
            barrier();
            add_products(acc, id, slice);
            barrier();
        }
        key0 += TILE;
    } while (key0 < key_end);

    [[unroll]] for (int r = 0; r < 4; ++r) {
        int row = row0 + 4 * (id / SLICE) + r;
        [[unroll]] for (int slice = 0; slice < SLICES; ++slice) {
            int texel = slice * SLICE + id % SLICE;
            if (row < p.queries && texel < TEXELS) {
                v_q[q_base + row * p.q_stride + texel] = acc[4 * slice + r] * p.scale;
            }
        }
    }
}
