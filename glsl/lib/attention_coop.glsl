// lib/attention_coop: 32 x 32 scores of one head and their products with 32 rows by cooperative matrices, held by 128
// invocations. Heads of up to MAX_DIM elements, zeros beyond theirs. Operands lie in shared memory as f16, a multiple
// of 16 bytes apart, as cooperative loads want, and on other banks than the row before. The layout of a matrix in
// registers is the device's secret, so scores go through shared memory to the invocations that weigh them, eight
// columns of a row each, and come back as `weights`. SUBGROUPS subgroups share the matrices of a tile. No pair is
// masked: what does not exist is a zero row.
#include "lib/softmax.glsl"
const int TILE = 32;
const int GROUP = 128;
const int MAX_DIM = 64;
const int TEXELS = HEAD_DIM / 4;
const uint DIM = uint(HEAD_DIM + 15) / 16 * 16;
const int ROW_TEXELS = MAX_DIM / 4;
const int STRIDE4 = ROW_TEXELS + 2;
const int PANEL = TILE * STRIDE4;
const int FETCHES = TILE * ROW_TEXELS / GROUP;
const int SCORE_STRIDE4 = TILE / 4 + 1;
const int WEIGHT_STRIDE4 = TILE / 4 + 2;
const uint BLOCKS_DOWN = uint(TILE) / TM;
const uint SCORE_BLOCKS = uint(TILE * TILE) / (TM * TN) / SUBGROUPS;
const uint SUM_BLOCKS = (BLOCKS_DOWN * (DIM / TN) + SUBGROUPS - 1) / SUBGROUPS;
// At the end also a matrix of each subgroup: SUBGROUPS * TM * TN <= 1024, as the host checks.
shared vec4 scores[TILE * SCORE_STRIDE4];
shared f16vec4 weights[TILE * WEIGHT_STRIDE4];

// Where the workgroup's rows, head and image begin, in texels of each buffer and in statistics.
#define ATTENTION_BASES                                                                                         \
    int row0 = int(gl_WorkGroupID.x) * TILE;                                                                    \
    int head = int(gl_WorkGroupID.y);                                                                           \
    int heads = int(gl_NumWorkGroups.y);                                                                        \
    int image = int(gl_WorkGroupID.z);                                                                          \
    int q_base = image * p.queries * p.q_stride + head * TEXELS;                                                \
    int g_stride = heads * TEXELS;                                                                              \
    int g_base = image * p.queries * g_stride + head * TEXELS;                                                  \
    int k_base = image * p.keys * p.kv_stride + p.k_offset + head * TEXELS;                                     \
    int v_base = image * p.keys * p.kv_stride + p.v_offset + head * TEXELS;                                     \
    int stat = (image * heads + head) * p.queries;

// Rows first.. of an operand, four texels per invocation; rows from `end` on are zero.
#define FETCH_ROWS(next, source, base, stride, first, end)                                                      \
    [[unroll]] for (int f = 0; f < FETCHES; ++f) {                                                              \
        int row = (first) + id / ROW_TEXELS + f * (GROUP / ROW_TEXELS);                                         \
        bool inside = row < (end) && id % ROW_TEXELS < TEXELS;                                                  \
        next[f] = inside ? source[(base) + row * (stride) + id % ROW_TEXELS] : vec4(0.0);                       \
    }

#define STAGE_ROWS(panel, next, factor)                                                                         \
    [[unroll]] for (int f = 0; f < FETCHES; ++f) {                                                              \
        panel[(id / ROW_TEXELS + f * (GROUP / ROW_TEXELS)) * STRIDE4 + id % ROW_TEXELS] = f16vec4(next[f] * (factor)); \
    }

// result[row, column] = left(row) . right(column), both panels.
#define PUT_SCORES(result, left, right)                                                                         \
    [[unroll]] for (uint i = 0; i < SCORE_BLOCKS; ++i) {                                                        \
        uint block = gl_SubgroupID + i * SUBGROUPS;                                                             \
        uint row = block % BLOCKS_DOWN * TM;                                                                    \
        uint column = block / BLOCKS_DOWN * TN;                                                                 \
        coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator> sum =                                 \
            coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator>(0.0);                             \
        uint k = 0;                                                                                             \
        do {                                                                                                    \
            coopmat<float16_t, gl_ScopeSubgroup, TM, TK, gl_MatrixUseA> a;                                      \
            coopmat<float16_t, gl_ScopeSubgroup, TK, TN, gl_MatrixUseB> b;                                      \
            coopMatLoad(a, left, row * STRIDE4 + k / 4, STRIDE4, gl_CooperativeMatrixLayoutRowMajor);           \
            coopMatLoad(b, right, column * STRIDE4 + k / 4, STRIDE4, gl_CooperativeMatrixLayoutColumnMajor);    \
            sum = coopMatMulAdd(a, b, sum);                                                                     \
            k += TK;                                                                                            \
        } while (k < DIM);                                                                                      \
        coopMatStore(sum, result, row * SCORE_STRIDE4 + column / 4, SCORE_STRIDE4, \
                     gl_CooperativeMatrixLayoutRowMajor); \
    }

// Matrix i of this subgroup's share of a tile [TILE, DIM]: its first row and column; whether there is one.
bool owns_sum(uint i, out uint row, out uint column) {
    uint block = gl_SubgroupID + i * SUBGROUPS;
    row = block % BLOCKS_DOWN * TM;
    column = block / BLOCKS_DOWN * TN;
    return column < DIM;
}

// acc += weights * panel
#define ADD_PRODUCTS(acc, panel)                                                                                \
    [[unroll]] for (uint i = 0; i < SUM_BLOCKS; ++i) {                                                          \
        uint row;                                                                                               \
        uint column;                                                                                            \
        if (owns_sum(i, row, column)) {                                                                         \
            uint k = 0;                                                                                         \
            do {                                                                                                \
                coopmat<float16_t, gl_ScopeSubgroup, TM, TK, gl_MatrixUseA> a;                                  \
                coopmat<float16_t, gl_ScopeSubgroup, TK, TN, gl_MatrixUseB> b;                                  \
                coopMatLoad(a, weights, row * WEIGHT_STRIDE4 + k / 4, WEIGHT_STRIDE4, \
                            gl_CooperativeMatrixLayoutRowMajor); \
                coopMatLoad(b, panel, k * STRIDE4 + column / 4, STRIDE4, gl_CooperativeMatrixLayoutRowMajor);   \
                acc[i] = coopMatMulAdd(a, b, acc[i]);                                                           \
                k += TK;                                                                                        \
            } while (k < uint(TILE));                                                                           \
        }                                                                                                       \
    }

#define CLEAR_SUMS(acc)                                                                                         \
    [[unroll]] for (uint i = 0; i < SUM_BLOCKS; ++i) {                                                          \
        acc[i] = coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator>(0.0);                        \
    }

// Every texel of the tile through STORE_TEXEL(row, texel, value).
#define STORE_SUMS(acc, STORE_TEXEL)                                                                            \
    [[unroll]] for (uint i = 0; i < SUM_BLOCKS; ++i) {                                                          \
        uint row;                                                                                               \
        uint column;                                                                                            \
        bool owns = owns_sum(i, row, column);                                                                   \
        uint patch0 = gl_SubgroupID * TM * TN / 4;                                                              \
        if (owns) {                                                                                             \
            coopMatStore(acc[i], scores, patch0, TN / 4, gl_CooperativeMatrixLayoutRowMajor);                   \
        }                                                                                                       \
        barrier();                                                                                              \
        for (uint e = gl_SubgroupInvocationID; owns && e < TM * TN / 4; e += gl_SubgroupSize) {                 \
            int texel = int(column / 4 + e % (TN / 4));                                                         \
            if (texel < TEXELS) {                                                                               \
                STORE_TEXEL(int(row + e / (TN / 4)), texel, scores[patch0 + e])                                 \
            }                                                                                                   \
        }                                                                                                       \
        barrier();                                                                                              \
    }

// Eight neighbouring columns of a row of scores or weights belong to an invocation.
int own_row(int id) {
    return id / 4;
}

int own_column(int id) {
    return id % 4 * 8;
}

void put_weights(int id, vec4 low, vec4 high) {
    int at = own_row(id) * WEIGHT_STRIDE4 + own_column(id) / 4;
    weights[at] = f16vec4(low);
    weights[at + 1] = f16vec4(high);
}

// Which of four columns from `first` on lie before `end`.
bvec4 before(int first, int end) {
    return lessThan(ivec4(first, first + 1, first + 2, first + 3), ivec4(end));
}
