#version 460
// nn/attention_fwd_tile: nn/attention_fwd for GPUs. One workgroup per (32 queries, head, image), 32 keys at a time.
//   in   q rows [B*queries, q_stride texels]   k, v rows [B*keys, kv_stride texels], head h at texel h*HEAD_DIM/4 of
//     each part
//   out  attn [B*queries, heads*HEAD_DIM] (=)   lse [B, heads, queries] (=), base-2 logarithm of the softmax
//     denominators
//   Running maximum (Milakov & Gimelshein 2018), no score matrix in memory. CAUSAL = 1: query i sees keys 0 ..= keys -
//     queries + i.
//   twin kernels/src/reference/nn/attention.rs   13 KiB shared; four invocations keep the maximum and the sum of a row
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 128) in;
layout(constant_id = 0) const int HEAD_DIM = 64;
layout(constant_id = 1) const uint CAUSAL = 0;
layout(push_constant) uniform Params {
    int queries; int keys; int q_stride; int kv_stride; int k_offset; int v_offset; float scale;
} p;
layout(set = 0, binding = 0) readonly buffer Q { vec4 q[]; };
layout(set = 0, binding = 1) readonly buffer Kv { vec4 kv[]; };
layout(set = 0, binding = 2) writeonly buffer Attn { vec4 attn[]; };
layout(set = 0, binding = 3) writeonly buffer Lse { float lse[]; };

int hidden_from; // first key that row 0 of the tile does not see, counted from the tile of keys in hand
#define SEEN(row, column) (CAUSAL == 0u || (column) < hidden_from + (row))
#define OPERANDS 2
#include "lib/attention_block.glsl"
shared float partial[128];
shared float fades[TILE];

float largest(vec4 v) {
    return max(max(v.x, v.y), max(v.z, v.w));
}

// The tile's scores in `weights` become exponentials below the running maximum; `fades` says how earlier ones shrink.
void soften(int id, inout float top, inout float sum) {
    int row = id / 4;
    int at = row * WEIGHT_STRIDE + id % 4 * 2;
    vec4 low = weights[at];
    vec4 high = weights[at + 1];
    partial[id] = max(largest(low), largest(high));
    barrier();
    float new_top = max(top, max(max(partial[4 * row], partial[4 * row + 1]),
                                 max(partial[4 * row + 2], partial[4 * row + 3])));
    float fade = exp2_or_nan(top - new_top);
    top = new_top;
    low = exp2_or_nan(low - new_top);
    high = exp2_or_nan(high - new_top);
    weights[at] = low;
    weights[at + 1] = high;
    vec4 both = low + high;
    sum = sum * fade + (both.x + both.y + both.z + both.w);
    fades[row] = fade;
}

void main() {
    int id = int(gl_LocalInvocationID.x);
    int row0 = int(gl_WorkGroupID.x) * TILE;
    int head = int(gl_WorkGroupID.y);
    int heads = int(gl_NumWorkGroups.y);
    int image = int(gl_WorkGroupID.z);
    int q_base = image * p.queries * p.q_stride + head * TEXELS;
    int k_base = image * p.keys * p.kv_stride + p.k_offset + head * TEXELS;
    int v_base = image * p.keys * p.kv_stride + p.v_offset + head * TEXELS;
    int past_diagonal = p.keys - p.queries + row0 + 1;
    int key_end = CAUSAL == 1u ? min(p.keys, past_diagonal + TILE - 1) : p.keys;
    vec4 acc[SUMS];
    [[unroll]] for (int i = 0; i < SUMS; ++i) {
        acc[i] = vec4(0.0);
    }
    float top = MASKED;
    float sum = 0.0;
    int key0 = 0;
    do {
        float s[8] = float[8](0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        int chunk = 0;
        do {
            LOAD_CHUNK(0, q, q_base, p.q_stride, row0, p.queries, chunk)
            LOAD_CHUNK(1, kv, k_base, p.kv_stride, key0, p.keys, chunk)
            barrier();
            add_scores(s, id, 0, 1);
            barrier();
        } while (++chunk * CHUNK < TEXELS);
        hidden_from = past_diagonal - key0;
        [[unroll]] for (int i = 0; i < 8; ++i) {
            int column = id % 8 + 8 * (i % 4);
            bool counts = key0 + column < p.keys && SEEN(id / 8 + 16 * (i / 4), column);
            s[i] = counts ? s[i] * (p.scale * LOG2_E) : MASKED;
        }
        put_weights(s, id);
        barrier();
        soften(id, top, sum);
        [[unroll]] for (int slice = 0; slice < SLICES; ++slice) {
            LOAD_SLICE(kv, v_base, p.kv_stride, key0, p.keys, slice)
            barrier();
            [[unroll]] for (int r = 0; r < 4; ++r) {
                acc[4 * slice + r] *= fades[4 * (id / SLICE) + r];
            }
            add_products(acc, id, slice);
            barrier();
        }
        key0 += TILE;
    } while (key0 < key_end);

    partial[id] = sum;
    barrier();
    [[unroll]] for (int r = 0; r < 4; ++r) {
        int row = 4 * (id / SLICE) + r;
        float denominator = partial[4 * row] + partial[4 * row + 1] + partial[4 * row + 2] + partial[4 * row + 3];
        [[unroll]] for (int slice = 0; slice < SLICES; ++slice) {
            int texel = slice * SLICE + id % SLICE;
            if (row0 + row < p.queries && texel < TEXELS) {
                attn[((image * p.queries + row0 + row) * heads + head) * TEXELS + texel] =
                    acc[4 * slice + r] / denominator;
            }
        }
    }
    if (id % 4 == 0 && row0 + id / 4 < p.queries) {
        float denominator = partial[id] + partial[id + 1] + partial[id + 2] + partial[id + 3];
        // Drivers may lose a NaN in log2.
        lse[(image * heads + head) * p.queries + row0 + id / 4] =
            isnan(denominator) ? denominator : top + log2(denominator);
    }
}
