// lib/attention_block: 32 x 32 scores of one head and their products with 32 rows, held by 128 invocations; below 16
// KiB of shared memory for any HEAD_DIM, because operands pass through it in chunks of 4 texels and slices of 16.
// Scores: invocation i holds rows i/8 and i/8 + 16, columns i%8 + 8u for u in 0..4: a texel read serves two or four of
// them. In `weights` a vec4 spans the four columns of an invocation, so column c + 8u is component u of texel c.
// Products: invocation i holds rows 4*(i/16).. at texel i%16 of every slice. Includers define HEAD_DIM and SEEN(row,
// column): whether the mask shows the pair, for positions in the tile.
#include "lib/softmax.glsl"
const int TILE = 32;
const int TEXELS = HEAD_DIM / 4;
const int CHUNK = 4;
// A chunk's rows lie 5 texels apart: rows of eight neighbours then fall into different banks, as do those of `weights`.
const int CHUNK_STRIDE = CHUNK + 1;
const int CHUNK_SIZE = TILE * CHUNK_STRIDE;
const int WEIGHT_STRIDE = TILE / 4 + 1;
const int SLICE = 16;
const int SLICES = (TEXELS + SLICE - 1) / SLICE;
const int SUMS = 4 * SLICES;
shared vec4 pool[OPERANDS * CHUNK_SIZE > TILE * SLICE ? OPERANDS * CHUNK_SIZE : TILE * SLICE];
shared vec4 weights[TILE * WEIGHT_STRIDE];

// Rows first.. of an operand at texels of one chunk, one texel per invocation; rows from `end` on are zero.
#define LOAD_CHUNK(operand, source, base, stride, first, end, chunk)                                      \
    {                                                                                                     \
        int chunk_row = id / CHUNK;                                                                       \
        int chunk_texel = (chunk) * CHUNK + id % CHUNK;                                                   \
        bool chunk_inside = (first) + chunk_row < (end) && chunk_texel < TEXELS;                          \
        pool[(operand) * CHUNK_SIZE + chunk_row * CHUNK_STRIDE + id % CHUNK] =                            \
            chunk_inside ? source[(base) + ((first) + chunk_row) * (stride) + chunk_texel] : vec4(0.0);   \
    }

// Rows first.. at the texels of one slice, four texels per invocation; rows from `end` on are zero.
#define LOAD_SLICE(source, base, stride, first, end, slice)                                               \
    [[unroll]] for (int part = 0; part < 4; ++part) {                                                     \
        int slice_row = id / SLICE + 8 * part;                                                            \
        int slice_texel = (slice) * SLICE + id % SLICE;                                                   \
        bool slice_inside = (first) + slice_row < (end) && slice_texel < TEXELS;                          \
        pool[slice_row * SLICE + id % SLICE] =                                                            \
            slice_inside ? source[(base) + ((first) + slice_row) * (stride) + slice_texel] : vec4(0.0);   \
    }

// score[4*half + u] += left(row) . right(column) over the chunk in the pool.
void add_scores(inout float score[8], int id, int left, int right) {
    int rows = left * CHUNK_SIZE + (id / 8) * CHUNK_STRIDE;
    int columns = right * CHUNK_SIZE + (id % 8) * CHUNK_STRIDE;
    [[unroll]] for (int t = 0; t < CHUNK; ++t) {
        vec4 low = pool[rows + t];
        vec4 high = pool[rows + 16 * CHUNK_STRIDE + t];
        [[unroll]] for (int u = 0; u < 4; ++u) {
            vec4 other = pool[columns + 8 * u * CHUNK_STRIDE + t];
            [[unroll]] for (int q = 0; q < 4; ++q) {
                score[u] += low[q] * other[q];
                score[4 + u] += high[q] * other[q];
            }
        }
    }
}

void put_weights(float score[8], int id) {
    int at = (id / 8) * WEIGHT_STRIDE + id % 8;
    weights[at] = vec4(score[0], score[1], score[2], score[3]);
    weights[at + 16 * WEIGHT_STRIDE] = vec4(score[4], score[5], score[6], score[7]);
}

// acc[r] += weight(row r, column) * pool(column): a pair that the mask hides adds nothing, not even 0 * NaN.
void add_products(inout vec4 acc[SUMS], int id, int slice) {
    int row0 = 4 * (id / SLICE);
    int c = 0;
    do {
        vec4 w[4];
        [[unroll]] for (int r = 0; r < 4; ++r) {
            w[r] = weights[(row0 + r) * WEIGHT_STRIDE + c];
        }
        [[unroll]] for (int u = 0; u < 4; ++u) {
            vec4 value = pool[(c + 8 * u) * SLICE + id % SLICE];
            [[unroll]] for (int r = 0; r < 4; ++r) {
                acc[4 * slice + r] += mix(vec4(0.0), w[r][u] * value, bvec4(SEEN(row0 + r, c + 8 * u)));
            }
        }
    } while (++c < 8);
}
