#version 460
// nn/attention_vkv: gradients of attention_fwd to keys and values; probabilities are recomputed from lse.
//   in   q, k, v and lse as in attention_fwd   v_attn [B*queries, heads*HEAD_DIM]   delta [B, heads, queries]
//   out  v_kv rows [B*keys, kv_stride texels] (=), the key and value parts only
//   One subgroup of eight lanes per (16 keys, head, image). v_v = P^T*v_attn, v_k = scale * dS^T*Q.
//   twin kernels/src/reference/nn/attention.rs   Dao et al. 2022, algorithm 4
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
layout(constant_id = 0) const int HEAD_DIM = 64;
layout(constant_id = 1) const uint CAUSAL = 0;
layout(push_constant) uniform Params {
    int queries; int keys; int q_stride; int kv_stride; int k_offset; int v_offset; float scale;
} p;
TEXELS_F32(0, q_tex);
TEXELS_F32(1, kv_tex);
TEXELS_F32(2, v_attn_tex);
TEXELS_F32(3, lse);
TEXELS_F32(4, delta);
layout(set = 0, binding = 5) writeonly buffer VKv { vec4 v_kv[]; };

#include "lib/attention_tile.glsl"

void main() {
    int lane = int(gl_LocalInvocationID.x);
    int row0 = int(gl_WorkGroupID.x) * TILE;
    int head = int(gl_WorkGroupID.y);
    int heads = int(gl_NumWorkGroups.y);
    int image = int(gl_WorkGroupID.z);
    int low_row = min(row0 + lane, p.keys - 1) * p.kv_stride;
    int high_row = min(row0 + 8 + lane, p.keys - 1) * p.kv_stride;
    int q_base = image * p.queries * p.q_stride + head * TEXELS;
    int g_stride = heads * TEXELS;
    int g_base = image * p.queries * g_stride + head * TEXELS;
    int k_base = image * p.keys * p.kv_stride + p.k_offset + head * TEXELS;
    int v_base = image * p.keys * p.kv_stride + p.v_offset + head * TEXELS;
    int stat = (image * heads + head) * p.queries;
    int diagonal = p.keys - p.queries;

    vec4 acc_k[TILE * SLICES];
    vec4 acc_v[TILE * SLICES];
    [[unroll]] for (int i = 0; i < TILE * SLICES; ++i) {
        acc_k[i] = vec4(0.0);
        acc_v[i] = vec4(0.0);
    }
    int query0 = CAUSAL == 1u ? max(row0 - diagonal, 0) : 0;
    do {
        int low_query = min(query0 + lane, p.queries - 1);
        int high_query = min(query0 + 8 + lane, p.queries - 1);
        float s[2 * TILE];
        float dp[2 * TILE];
        [[unroll]] for (int i = 0; i < 2 * TILE; ++i) {
            s[i] = 0.0;
            dp[i] = 0.0;
        }
        int t = 0;
        do {
            vec4 left0 = texel_load(kv_tex, k_base + low_row + t) * (p.scale * LOG2_E);
            vec4 left1 = texel_load(kv_tex, k_base + high_row + t) * (p.scale * LOG2_E);
            vec4 right0 = texel_load(q_tex, q_base + low_query * p.q_stride + t);
            vec4 right1 = texel_load(q_tex, q_base + high_query * p.q_stride + t);
            ADD_SCORES(s, left0, left1, right0, right1)
            vec4 value0 = texel_load(kv_tex, v_base + low_row + t);
            vec4 value1 = texel_load(kv_tex, v_base + high_row + t);
            vec4 grad0 = texel_load(v_attn_tex, g_base + low_query * g_stride + t);
            vec4 grad1 = texel_load(v_attn_tex, g_base + high_query * g_stride + t);
            ADD_SCORES(dp, value0, value1, grad0, grad1)
        } while (++t < TEXELS);
        float lse0 = texel_pick(lse, stat + low_query);
        float lse1 = texel_pick(lse, stat + high_query);
        float delta0 = texel_pick(delta, stat + low_query);
        float delta1 = texel_pick(delta, stat + high_query);
        [[unroll]] for (int r = 0; r < TILE; ++r) {
            int from = CAUSAL == 1u ? row0 + r - diagonal : 0;
            bool low_seen = query0 + lane < p.queries && query0 + lane >= from;
            bool high_seen = query0 + 8 + lane < p.queries && query0 + 8 + lane >= from;
            s[r] = low_seen ? exp2(s[r] - lse0) : 0.0;
            s[r + 16] = high_seen ? exp2(s[r + 16] - lse1) : 0.0;
            dp[r] = low_seen ? s[r] * (dp[r] - delta0) : 0.0;
            dp[r + 16] = high_seen ? s[r + 16] * (dp[r + 16] - delta1) : 0.0;
        }
        int j = 0;
        do {
            float weight[TILE];
            float slope[TILE];
            [[unroll]] for (int r = 0; r < TILE; ++r) {
                weight[r] = j < 8 ? s[r] : s[r + 16];
                slope[r] = j < 8 ? dp[r] : dp[r + 16];
            }
            vec4 grad[4 * SLICES];
            vec4 left[4 * SLICES];
            [[unroll]] for (int u = 0; u < 4; ++u) {
                int query = min(query0 + j + u, p.queries - 1);
                bool exists = query0 + j + u < p.queries;
                [[unroll]] for (int i = 0; i < SLICES; ++i) {
                    int texel = min(lane + 8 * i, TEXELS - 1);
                    grad[u * SLICES + i] =
                        texel_or_zero(exists, texel_load(v_attn_tex, g_base + query * g_stride + texel));
                    left[u * SLICES + i] =
                        texel_or_zero(exists, texel_load(q_tex, q_base + query * p.q_stride + texel));
                }
            }
            [[unroll]] for (int r = 0; r < TILE; ++r) {
                [[unroll]] for (int u = 0; u < 4; ++u) {
                    float w = lane_shuffle(weight[r], (j & 7) + u);
                    float d = lane_shuffle(slope[r], (j & 7) + u);
                    bool seen = CAUSAL == 0u || query0 + j + u >= row0 + r - diagonal;
                    [[unroll]] for (int i = 0; i < SLICES; ++i) {
                        acc_v[r * SLICES + i] += masked_term(seen, w, grad[u * SLICES + i]);
                        acc_k[r * SLICES + i] += masked_term(seen, d, left[u * SLICES + i]);
                    }
                }
            }
            j += 4;
        } while (j < min(TILE, p.queries - query0));
        query0 += TILE;
    } while (query0 < p.queries);

    [[unroll]] for (int r = 0; r < TILE; ++r) {
        [[unroll]] for (int i = 0; i < SLICES; ++i) {
            if (row0 + r < p.keys && lane + 8 * i < TEXELS) {
                int at = (row0 + r) * p.kv_stride + lane + 8 * i;
                v_kv[k_base + at] = acc_k[r * SLICES + i] * p.scale;
                v_kv[v_base + at] = acc_v[r * SLICES + i];
            }
        }
    }
}
