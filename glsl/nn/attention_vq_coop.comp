#version 460
// nn/attention_vq_coop: nn/attention_vq by cooperative matrices, operands, weights and slopes rounded to f16, v_attn
// with the scale of its tile, sums in f32. One workgroup per (32 queries, head, image), 32 keys at a time; every query
// sees every key.
//   in   q, k, v and lse as in attention_fwd   v_attn [B*queries, heads*HEAD_DIM]   delta [B, heads, queries]
//   out  v_q rows [B*queries, q_stride texels] (=), the query part only
//   dS = P*(v_attn.V - delta), v_q = scale * dS*K (Dao et al. 2022, algorithm 4). twin
//     kernels/src/reference/nn/attention.rs
//   Per workgroup and 32 keys of 64: 393,216 operations, 16 KiB read: 24 operations a byte of cache, which should limit
//     it.
//   Matrices of 16 x 16 x 16: 96 loads of 512 bytes from shared memory per 48 products of 8192 operations. 30 KiB
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
layout(set = 0, binding = 2) readonly buffer VAttn { vec4 v_attn[]; };
layout(set = 0, binding = 3) readonly buffer Lse { float lse[]; };
layout(set = 0, binding = 4) readonly buffer Delta { float delta[]; };
layout(set = 0, binding = 5) writeonly buffer VQ { vec4 v_q[]; };

#ifdef INTERFACE_ONLY
// For compilers that do not know the extension; names everything that the host binds, and is never run.
void main() {
    uint names = TM + TN + TK + SUBGROUPS + uint(HEAD_DIM);
    float statistics = lse[p.q_stride] + delta[p.kv_stride + p.k_offset + p.v_offset] + p.scale;
    v_q[names] = q[p.queries] + kv[p.keys] + v_attn[names] + statistics;
}
#else
#include "lib/attention_coop.glsl"
#include "lib/block_scale.glsl"
shared vec4 slopes[TILE * SCORE_STRIDE4];
shared f16vec4 query_panel[PANEL];
shared f16vec4 gradient_panel[PANEL];
shared f16vec4 key_panel[PANEL];
shared f16vec4 value_panel[PANEL];

void tell_fetched(vec4 next[FETCHES]) {
    uint bits = 0u;
    [[unroll]] for (int f = 0; f < FETCHES; ++f) {
        bits = max(bits, finite_bits(next[f]));
    }
    tell_block_scale(bits);
}

// Four slopes of a query, from their scores and products with the gradient; zero from the first key on that is none.
vec4 slope(int at, int key, vec2 row) {
    vec4 weight = exp2_or_nan(scores[at] * (p.scale * LOG2_E) - row.x);
    return mix(vec4(0.0), weight * (slopes[at] - row.y), before(key, p.keys));
}

void main() {
    int id = int(gl_LocalInvocationID.x);
    ATTENTION_BASES
    coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator> acc[SUM_BLOCKS];
    CLEAR_SUMS(acc)
    vec4 next_key[FETCHES];
    vec4 next_value[FETCHES];
    start_block_scale(id);
    barrier();
    FETCH_ROWS(next_key, q, q_base, p.q_stride, row0, p.queries)
    FETCH_ROWS(next_value, v_attn, g_base, g_stride, row0, p.queries)
    tell_fetched(next_value);
    barrier();
    float scale = block_scale();
    STAGE_ROWS(query_panel, next_key, 1.0)
    STAGE_ROWS(gradient_panel, next_value, scale)
    FETCH_ROWS(next_key, kv, k_base, p.kv_stride, 0, p.keys)
    FETCH_ROWS(next_value, kv, v_base, p.kv_stride, 0, p.keys)
    int own = stat + min(row0 + own_row(id), p.queries - 1);
    vec2 row_statistics = vec2(lse[own], delta[own] * scale);
    int key0 = 0;
    do {
        STAGE_ROWS(key_panel, next_key, 1.0)
        STAGE_ROWS(value_panel, next_value, 1.0)
        barrier();
        FETCH_ROWS(next_key, kv, k_base, p.kv_stride, key0 + TILE, p.keys)
        FETCH_ROWS(next_value, kv, v_base, p.kv_stride, key0 + TILE, p.keys)
        PUT_SCORES(scores, query_panel, key_panel)
        PUT_SCORES(slopes, gradient_panel, value_panel)
        barrier();
        int at = own_row(id) * SCORE_STRIDE4 + own_column(id) / 4;
        int key = key0 + own_column(id);
        put_weights(id, slope(at, key, row_statistics), slope(at + 1, key + 4, row_statistics));
        barrier();
        ADD_PRODUCTS(acc, key_panel)
        barrier();
        key0 += TILE;
    } while (key0 < p.keys);

#define STORE_V_Q(row, texel, value)                                                                            \
    if (row0 + (row) < p.queries) {                                                                             \
        v_q[q_base + (row0 + (row)) * p.q_stride + (texel)] = (value) * p.scale * unscale(scale);               \
    }
    STORE_SUMS(acc, STORE_V_Q)
}
#endif
