#version 460
// nn/attention_vq: gradient of attention_fwd to the queries; probabilities are recomputed from lse (Dao et al. 2022,
// algorithm 4).
//   in   q, k, v and lse as in attention_fwd   v_attn [B*queries, heads*HEAD_DIM]   delta [B, heads, queries]
//   out  v_q rows [B*queries, q_stride texels] (=), the query part only
//   One subgroup of eight lanes per (16 queries, head, image). dS = P*(v_attn.V - delta), v_q = scale * dS*K.
//   twin kernels/src/reference/nn/attention.rs
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
layout(set = 0, binding = 5) writeonly buffer VQ { vec4 v_q[]; };

#include "lib/attention_tile.glsl"

void main() {
    int lane = int(gl_LocalInvocationID.x);
    int row0 = int(gl_WorkGroupID.x) * TILE;
    int head = int(gl_WorkGroupID.y);
    int heads = int(gl_NumWorkGroups.y);
    int image = int(gl_WorkGroupID.z);
    int row_low = min(row0 + lane, p.queries - 1);
    int row_high = min(row0 + 8 + lane, p.queries - 1);
    int q_base = image * p.queries * p.q_stride + head * TEXELS;
    int g_base = image * p.queries * heads * TEXELS + head * TEXELS;
    int q0 = q_base + row_low * p.q_stride;
    int q1 = q_base + row_high * p.q_stride;
    int g0 = g_base + row_low * heads * TEXELS;
    int g1 = g_base + row_high * heads * TEXELS;
    int k_base = image * p.keys * p.kv_stride + p.k_offset + head * TEXELS;
    int v_base = image * p.keys * p.kv_stride + p.v_offset + head * TEXELS;
    int first_key = CAUSAL == 1u ? p.keys - p.queries + row0 : p.keys - 1;
    int key_end = CAUSAL == 1u ? min(p.keys, first_key + TILE) : p.keys;
    int stat = (image * heads + head) * p.queries;
    float lse0 = texel_pick(lse, stat + row_low);
    float lse1 = texel_pick(lse, stat + row_high);
    float delta0 = texel_pick(delta, stat + row_low);
    float delta1 = texel_pick(delta, stat + row_high);

    vec4 acc[TILE * SLICES];
    [[unroll]] for (int i = 0; i < TILE * SLICES; ++i) {
        acc[i] = vec4(0.0);
    }
    int key0 = 0;
    do {
        float s[2 * TILE];
        float dp[2 * TILE];
        [[unroll]] for (int i = 0; i < 2 * TILE; ++i) {
            s[i] = 0.0;
            dp[i] = 0.0;
        }
        int low_key = min(key0 + lane, p.keys - 1) * p.kv_stride;
        int high_key = min(key0 + 8 + lane, p.keys - 1) * p.kv_stride;
        int t = 0;
        do {
            vec4 left0 = texel_load(q_tex, q0 + t) * (p.scale * LOG2_E);
            vec4 left1 = texel_load(q_tex, q1 + t) * (p.scale * LOG2_E);
            vec4 right0 = texel_load(kv_tex, k_base + low_key + t);
            vec4 right1 = texel_load(kv_tex, k_base + high_key + t);
            ADD_SCORES(s, left0, left1, right0, right1)
            vec4 grad0 = texel_load(v_attn_tex, g0 + t);
            vec4 grad1 = texel_load(v_attn_tex, g1 + t);
            vec4 value0 = texel_load(kv_tex, v_base + low_key + t);
            vec4 value1 = texel_load(kv_tex, v_base + high_key + t);
            ADD_SCORES(dp, grad0, grad1, value0, value1)
        } while (++t < TEXELS);
        [[unroll]] for (int r = 0; r < TILE; ++r) {
            int limit = CAUSAL == 1u ? min(key_end, first_key + r + 1) : p.keys;
            float row_lse = r < 8 ? lane_shuffle(lse0, r) : lane_shuffle(lse1, r - 8);
            float row_delta = r < 8 ? lane_shuffle(delta0, r) : lane_shuffle(delta1, r - 8);
            float low = exp2(s[r] - row_lse) * (dp[r] - row_delta);
            float high = exp2(s[r + 16] - row_lse) * (dp[r + 16] - row_delta);
            s[r] = key0 + lane < limit ? low : 0.0;
            s[r + 16] = key0 + 8 + lane < limit ? high : 0.0;
        }
        int j = 0;
        do {
            float weight[TILE];
            [[unroll]] for (int r = 0; r < TILE; ++r) {
                weight[r] = j < 8 ? s[r] : s[r + 16];
            }
            vec4 key[4 * SLICES];
            [[unroll]] for (int u = 0; u < 4; ++u) {
                int k_row = k_base + min(key0 + j + u, p.keys - 1) * p.kv_stride;
                bool exists = key0 + j + u < p.keys;
                [[unroll]] for (int i = 0; i < SLICES; ++i) {
                    key[u * SLICES + i] =
                        texel_or_zero(exists, texel_load(kv_tex, k_row + min(lane + 8 * i, TEXELS - 1)));
                }
            }
            [[unroll]] for (int r = 0; r < TILE; ++r) {
                [[unroll]] for (int u = 0; u < 4; ++u) {
                    float w = lane_shuffle(weight[r], (j & 7) + u);
                    bool seen = CAUSAL == 0u || key0 + j + u <= first_key + r;
                    [[unroll]] for (int i = 0; i < SLICES; ++i) {
                        acc[r * SLICES + i] += masked_term(seen, w, key[u * SLICES + i]);
                    }
                }
            }
            j += 4;
        } while (j < min(TILE, p.keys - key0));
        key0 += TILE;
    } while (key0 < key_end);

    [[unroll]] for (int r = 0; r < TILE; ++r) {
        [[unroll]] for (int i = 0; i < SLICES; ++i) {
            if (row0 + r < p.queries && lane + 8 * i < TEXELS) {
                v_q[q_base + (row0 + r) * p.q_stride + lane + 8 * i] = acc[r * SLICES + i] * p.scale;
            }
        }
    }
}
