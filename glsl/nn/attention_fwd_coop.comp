#version 460
// nn/attention_fwd_coop: nn/attention_fwd by cooperative matrices, operands and weights rounded to f16, sums in f32.
// One workgroup per (32 queries, head, image), 32 keys at a time; every query sees every key.
//   in   q rows [B*queries, q_stride texels]   k, v rows [B*keys, kv_stride texels], head h at texel h*HEAD_DIM/4 of
//     each part
//   out  attn [B*queries, heads*HEAD_DIM] (=)   lse [B, heads, queries] (=), base-2 logarithm of the softmax
//     denominators
//   Running maximum (Milakov & Gimelshein 2018), no score matrix in memory. twin kernels/src/reference/nn/attention.rs
//   Per workgroup and 32 keys of 64: 262,144 operations, 16 KiB read: 16 operations a byte of cache, which should limit
//     it.
//   Matrices of 16 x 16 x 16: 64 loads of 512 bytes from shared memory per 32 products of 8192 operations. 23 KiB
//     shared.
#extension GL_EXT_control_flow_attributes : require
#ifndef INTERFACE_ONLY
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#extension GL_KHR_cooperative_matrix : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_KHR_shader_subgroup_basic : require
#endif

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint TM = 16;
layout(constant_id = 1) const uint TN = 16;
layout(constant_id = 2) const uint TK = 16;
layout(constant_id = 3) const uint SUBGROUPS = 4;
layout(constant_id = 4) const int HEAD_DIM = 64;
layout(push_constant) uniform Params {
    int queries; int keys; int q_stride; int kv_stride; int k_offset; int v_offset; float scale;
} p;
layout(set = 0, binding = 0) readonly buffer Q { vec4 q[]; };
layout(set = 0, binding = 1) readonly buffer Kv { vec4 kv[]; };
layout(set = 0, binding = 2) writeonly buffer Attn { vec4 attn[]; };
layout(set = 0, binding = 3) writeonly buffer Lse { float lse[]; };

#ifdef INTERFACE_ONLY
// For compilers that do not know the extension; names everything that the host binds, and is never run.
void main() {
    uint names = TM + TN + TK + SUBGROUPS + uint(HEAD_DIM);
    attn[names] = q[p.queries] + kv[p.keys];
    lse[p.q_stride + p.kv_stride + p.k_offset + p.v_offset] = p.scale;
}
#else
#include "lib/attention_coop.glsl"
shared f16vec4 query_panel[PANEL];
shared f16vec4 key_panel[PANEL];
shared f16vec4 value_panel[PANEL];
shared float partial[GROUP];
shared vec4 fades[TILE * 4]; // 16 columns, so that they load as a matrix does

float largest(vec4 v) {
    return max(max(v.x, v.y), max(v.z, v.w));
}

// The tile's scores become exponentials below the running maximum; `fades` says how earlier ones shrink.
void soften(int id, int key0, inout float top, inout float sum) {
    int row = own_row(id);
    int at = row * SCORE_STRIDE4 + own_column(id) / 4;
    int key = key0 + own_column(id);
    vec4 low = mix(vec4(MASKED), scores[at] * (p.scale * LOG2_E), before(key, p.keys));
    vec4 high = mix(vec4(MASKED), scores[at + 1] * (p.scale * LOG2_E), before(key + 4, p.keys));
    partial[id] = max(largest(low), largest(high));
    barrier();
    float new_top = max(top, max(max(partial[4 * row], partial[4 * row + 1]),
                                 max(partial[4 * row + 2], partial[4 * row + 3])));
    float fade = exp2_or_nan(top - new_top);
    top = new_top;
    low = exp2_or_nan(low - new_top);
    high = exp2_or_nan(high - new_top);
    put_weights(id, low, high);
    vec4 both = low + high;
    sum = sum * fade + (both.x + both.y + both.z + both.w);
    fades[id] = vec4(fade);
}

float denominator(int row) {
    return partial[4 * row] + partial[4 * row + 1] + partial[4 * row + 2] + partial[4 * row + 3];
}

void main() {
    int id = int(gl_LocalInvocationID.x);
    ATTENTION_BASES
    coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator> acc[SUM_BLOCKS];
    CLEAR_SUMS(acc)
    vec4 next_key[FETCHES];
    vec4 next_value[FETCHES];
    FETCH_ROWS(next_key, q, q_base, p.q_stride, row0, p.queries)
    STAGE_ROWS(query_panel, next_key, 1.0)
    FETCH_ROWS(next_key, kv, k_base, p.kv_stride, 0, p.keys)
    FETCH_ROWS(next_value, kv, v_base, p.kv_stride, 0, p.keys)
    float top = MASKED;
    float sum = 0.0;
    int key0 = 0;
    do {
        STAGE_ROWS(key_panel, next_key, 1.0)
        STAGE_ROWS(value_panel, next_value, 1.0)
        barrier();
        FETCH_ROWS(next_key, kv, k_base, p.kv_stride, key0 + TILE, p.keys)
        FETCH_ROWS(next_value, kv, v_base, p.kv_stride, key0 + TILE, p.keys)
        PUT_SCORES(scores, query_panel, key_panel)
        barrier();
        soften(id, key0, top, sum);
        barrier();
        [[unroll]] for (uint i = 0; i < SUM_BLOCKS; ++i) {
            coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator> fade;
            uint row = (gl_SubgroupID + i * SUBGROUPS) % BLOCKS_DOWN * TM;
            coopMatLoad(fade, fades, row * 4, 4, gl_CooperativeMatrixLayoutRowMajor);
            acc[i] = acc[i] * fade;
        }
        ADD_PRODUCTS(acc, value_panel)
        barrier();
        key0 += TILE;
    } while (key0 < p.keys);

    partial[id] = sum;
#define STORE_ATTN(row, texel, value)                                                                           \
    if (row0 + (row) < p.queries) {                                                                             \
        attn[g_base + (row0 + (row)) * g_stride + (texel)] = (value) / denominator(row); \
    }
    STORE_SUMS(acc, STORE_ATTN)
    if (id % 4 == 0 && row0 + id / 4 < p.queries) {
        // Drivers may lose a NaN in log2.
        float below = denominator(id / 4);
        lse[stat + row0 + id / 4] = isnan(below) ? below : top + log2(below);
    }
}
#endif
