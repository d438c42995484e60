#version 460
// nn/attention_vkv_coop: nn/attention_vkv by cooperative matrices, operands, weights and slopes rounded to f16, v_attn
// with the scale of the tiles so far, sums in f32. One workgroup per (32 keys, head, image), 32 queries at a time; no
// mask.
//   in   q, k, v and lse as in attention_fwd   v_attn [B*queries, heads*HEAD_DIM]   delta [B, heads, queries]
//   out  v_kv rows [B*keys, kv_stride texels] (=), the key and value parts only
//   v_v = P^T*v_attn, v_k = scale * dS^T*Q (Dao et al. 2022, algorithm 4); rows of a tile are keys here, columns are
//     queries.
//   twin kernels/src/reference/nn/attention.rs
//   Per workgroup and 32 queries of 64: 524,288 operations, 16 KiB read: 32 operations a byte of cache, which should
//     limit it.
//   Matrices of 16 x 16 x 16: 128 loads of 512 bytes from shared memory per 64 products of 8192 operations. 30 KiB
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
layout(set = 0, binding = 5) writeonly buffer VKv { vec4 v_kv[]; };

#ifdef INTERFACE_ONLY
// For compilers that do not know the extension; names everything that the host binds, and is never run.
void main() {
    uint names = TM + TN + TK + SUBGROUPS + uint(HEAD_DIM);
    float statistics = lse[p.q_stride] + delta[p.kv_stride + p.k_offset + p.v_offset] + p.scale;
    v_kv[names] = q[p.queries] + kv[p.keys] + v_attn[names] + statistics;
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

// Four weights of a key and their slopes, from scores and products with the gradient; zero from the first query on that
// is none.
void weigh(int at, int query, int stat, float scale, out vec4 weight, out vec4 slope) {
    [[unroll]] for (int c = 0; c < 4; ++c) {
        int own = stat + min(query + c, p.queries - 1);
        weight[c] = exp2_or_nan(scores[at][c] * (p.scale * LOG2_E) - lse[own]);
        slope[c] = weight[c] * (slopes[at][c] - delta[own] * scale);
    }
    weight = mix(vec4(0.0), weight, before(query, p.queries));
    slope = mix(vec4(0.0), slope, before(query, p.queries));
}

void main() {
    int id = int(gl_LocalInvocationID.x);
    ATTENTION_BASES
    coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator> acc_k[SUM_BLOCKS];
    coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator> acc_v[SUM_BLOCKS];
    CLEAR_SUMS(acc_k)
    CLEAR_SUMS(acc_v)
    vec4 next_query[FETCHES];
    vec4 next_gradient[FETCHES];
    start_block_scale(id);
    FETCH_ROWS(next_query, kv, k_base, p.kv_stride, row0, p.keys)
    FETCH_ROWS(next_gradient, kv, v_base, p.kv_stride, row0, p.keys)
    STAGE_ROWS(key_panel, next_query, 1.0)
    STAGE_ROWS(value_panel, next_gradient, 1.0)
    FETCH_ROWS(next_query, q, q_base, p.q_stride, 0, p.queries)
    FETCH_ROWS(next_gradient, v_attn, g_base, g_stride, 0, p.queries)
    barrier();
    float scale = 1.0;
    int query0 = 0;
    do {
        tell_fetched(next_gradient);
        barrier();
        float ratio = block_scale() * unscale(scale);
        scale = block_scale();
        [[unroll]] for (uint i = 0; i < SUM_BLOCKS; ++i) {
            acc_k[i] *= ratio;
            acc_v[i] *= ratio;
        }
        STAGE_ROWS(query_panel, next_query, 1.0)
        STAGE_ROWS(gradient_panel, next_gradient, scale)
        barrier();
        FETCH_ROWS(next_query, q, q_base, p.q_stride, query0 + TILE, p.queries)
        FETCH_ROWS(next_gradient, v_attn, g_base, g_stride, query0 + TILE, p.queries)
        PUT_SCORES(scores, key_panel, query_panel)
        PUT_SCORES(slopes, value_panel, gradient_panel)
        barrier();
        vec4 weight[2];
        vec4 slope[2];
        [[unroll]] for (int half_of_row = 0; half_of_row < 2; ++half_of_row) {
            int at = own_row(id) * SCORE_STRIDE4 + own_column(id) / 4 + half_of_row;
            weigh(at, query0 + own_column(id) + 4 * half_of_row, stat, scale, weight[half_of_row], slope[half_of_row]);
        }
        put_weights(id, weight[0], weight[1]);
        barrier();
        ADD_PRODUCTS(acc_v, gradient_panel)
        barrier();
        put_weights(id, slope[0], slope[1]);
        barrier();
        ADD_PRODUCTS(acc_k, query_panel)
        barrier();
        query0 += TILE;
    } while (query0 < p.queries);

#define STORE_V_K(row, texel, value)                                                                            \
    if (row0 + (row) < p.keys) {                                                                                \
        v_kv[k_base + (row0 + (row)) * p.kv_stride + (texel)] = (value) * p.scale * unscale(scale);             \
    }
#define STORE_V_V(row, texel, value)                                                                            \
    if (row0 + (row) < p.keys) {                                                                                \
        v_kv[v_base + (row0 + (row)) * p.kv_stride + (texel)] = (value) * unscale(scale);                       \
    }
    STORE_SUMS(acc_k, STORE_V_K)
    STORE_SUMS(acc_v, STORE_V_V)
}
#endif
