#version 460
// nn/attention_fwd: softmax(Q*K^T*scale)*V per head with a running maximum (Milakov & Gimelshein 2018), no score matrix
// in memory.
//   in   q rows [B*queries, q_stride texels]   k, v rows [B*keys, kv_stride texels], head h at texel h*HEAD_DIM/4 of
//     each part
//   out  attn [B*queries, heads*HEAD_DIM] (=)   lse [B, heads, queries] (=), base-2 logarithm of the softmax
//     denominators
//   One subgroup of eight lanes per (16 queries, head, image). CAUSAL = 1: query i sees keys 0 ..= keys - queries + i.
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
layout(set = 0, binding = 2) writeonly buffer Attn { vec4 attn[]; };
layout(set = 0, binding = 3) writeonly buffer Lse { float lse[]; };

#include "lib/attention_tile.glsl"

void main() {
    int lane = int(gl_LocalInvocationID.x);
    int row0 = int(gl_WorkGroupID.x) * TILE;
    int head = int(gl_WorkGroupID.y);
    int heads = int(gl_NumWorkGroups.y);
    int image = int(gl_WorkGroupID.z);
    int q_base = image * p.queries * p.q_stride + head * TEXELS;
    int q0 = q_base + min(row0 + lane, p.queries - 1) * p.q_stride;
    int q1 = q_base + min(row0 + 8 + lane, p.queries - 1) * p.q_stride;
    int k_base = image * p.keys * p.kv_stride + p.k_offset + head * TEXELS;
    int v_base = image * p.keys * p.kv_stride + p.v_offset + head * TEXELS;
    int first_key = CAUSAL == 1u ? p.keys - p.queries + row0 : p.keys - 1;
    int key_end = CAUSAL == 1u ? min(p.keys, first_key + TILE) : p.keys;
    float scale = p.scale * LOG2_E;

    vec4 o[TILE * SLICES];
    float sum[TILE];
    [[unroll]] for (int r = 0; r < TILE; ++r) {
        sum[r] = 0.0;
        [[unroll]] for (int i = 0; i < SLICES; ++i) {
            o[r * SLICES + i] = vec4(0.0);
        }
    }
    float top0 = MASKED;
    float top1 = MASKED;
    int key0 = 0;
    do {
        float s[2 * TILE];
        [[unroll]] for (int i = 0; i < 2 * TILE; ++i) {
            s[i] = 0.0;
        }
        int k0 = k_base + min(key0 + lane, p.keys - 1) * p.kv_stride;
        int k1 = k_base + min(key0 + 8 + lane, p.keys - 1) * p.kv_stride;
        int t = 0;
        do {
            vec4 left0 = texel_load(q_tex, q0 + t) * scale;
            vec4 left1 = texel_load(q_tex, q1 + t) * scale;
            vec4 right0 = texel_load(kv_tex, k0 + t);
            vec4 right1 = texel_load(kv_tex, k1 + t);
            ADD_SCORES(s, left0, left1, right0, right1)
        } while (++t < TEXELS);

        float new0 = top0;
        float new1 = top1;
        [[unroll]] for (int r = 0; r < TILE; ++r) {
            int limit = CAUSAL == 1u ? min(key_end, first_key + r + 1) : p.keys;
            s[r] = key0 + lane < limit ? s[r] : MASKED;
            s[r + 16] = key0 + 8 + lane < limit ? s[r + 16] : MASKED;
            float row_top = lanes_max(max(s[r], s[r + 16]));
            if (r < 8) {
                new0 = lane == r ? max(new0, row_top) : new0;
            } else {
                new1 = lane == r - 8 ? max(new1, row_top) : new1;
            }
        }
        float fade0 = exp2(top0 - new0);
        float fade1 = exp2(top1 - new1);
        top0 = new0;
        top1 = new1;
        [[unroll]] for (int r = 0; r < TILE; ++r) {
            float row_top = r < 8 ? lane_shuffle(new0, r) : lane_shuffle(new1, r - 8);
            float fade = r < 8 ? lane_shuffle(fade0, r) : lane_shuffle(fade1, r - 8);
            s[r] = exp2(s[r] - row_top);
            s[r + 16] = exp2(s[r + 16] - row_top);
            sum[r] = sum[r] * fade + (s[r] + s[r + 16]);
            [[unroll]] for (int i = 0; i < SLICES; ++i) {
                o[r * SLICES + i] *= fade;
            }
        }

        int j = 0;
        do {
            float weight[TILE];
            [[unroll]] for (int r = 0; r < TILE; ++r) {
                weight[r] = j < 8 ? s[r] : s[r + 16];
            }
            vec4 value[4 * SLICES];
            [[unroll]] for (int u = 0; u < 4; ++u) {
                int v_row = v_base + min(key0 + j + u, p.keys - 1) * p.kv_stride;
                bool exists = key0 + j + u < p.keys;
                [[unroll]] for (int i = 0; i < SLICES; ++i) {
                    value[u * SLICES + i] =
                        texel_or_zero(exists, texel_load(kv_tex, v_row + min(lane + 8 * i, TEXELS - 1)));
                }
            }
            [[unroll]] for (int r = 0; r < TILE; ++r) {
                [[unroll]] for (int u = 0; u < 4; ++u) {
                    float w = lane_shuffle(weight[r], (j & 7) + u);
                    bool seen = CAUSAL == 0u || key0 + j + u <= first_key + r;
                    [[unroll]] for (int i = 0; i < SLICES; ++i) {
                        o[r * SLICES + i] += masked_term(seen, w, value[u * SLICES + i]);
                    }
                }
            }
            j += 4;
        } while (j < min(TILE, p.keys - key0));
        key0 += TILE;
    } while (key0 < key_end);

    int out_stride = heads * TEXELS;
    float log_sum0 = 0.0;
    float log_sum1 = 0.0;
    [[unroll]] for (int r = 0; r < TILE; ++r) {
        float denominator = lanes_sum(sum[r]);
        if (r < 8) {
            log_sum0 = lane == r ? denominator : log_sum0;
        } else {
            log_sum1 = lane == r - 8 ? denominator : log_sum1;
        }
        [[unroll]] for (int i = 0; i < SLICES; ++i) {
            if (row0 + r < p.queries && lane + 8 * i < TEXELS) {
                attn[(image * p.queries + row0 + r) * out_stride + head * TEXELS + lane + 8 * i] =
                    o[r * SLICES + i] / denominator;
            }
        }
    }
    int stat = (image * heads + head) * p.queries + row0 + lane;
    if (row0 + lane < p.queries) {
        lse[stat] = top0 + log2(log_sum0);
    }
    if (row0 + 8 + lane < p.queries) {
        lse[stat + 8] = top1 + log2(log_sum1);
    }
}
