// lib/attention_tile: products of a tile of 16 rows with 16 keys or queries, held by one subgroup of eight lanes.
// Lane l holds rows l and l+8 of the left operand, rows l and l+8 of the right one; a score (row, 8*b + l) is
// element row + 16*b of lane l's array. Includers define HEAD_DIM and need subgroup shuffles.
const int TILE = 16;
const int TEXELS = HEAD_DIM / 4;
const int SLICES = (TEXELS + 7) / 8;
const float LOG2_E = 1.44269504;
const float MASKED = -1.0e30;

// score[row + 16*b] += left(row) . right(8*b + lane), four components at a time
#define ADD_SCORES(score, left0, left1, right0, right1)                  \
    [[unroll]] for (int r = 0; r < TILE; ++r) {                          \
        vec4 row = r < 8 ? lane_shuffle(left0, r) : lane_shuffle(left1, r - 8); \
        [[unroll]] for (int q = 0; q < 4; ++q) {                         \
            score[r] += row[q] * right0[q];                              \
        }                                                                \
        [[unroll]] for (int q = 0; q < 4; ++q) {                         \
            score[r + 16] += row[q] * right1[q];                         \
        }                                                                \
    }

// The texel, or zeros behind the last row: its weight is 0, but 0 * infinity is NaN.
vec4 texel_or_zero(bool exists, vec4 texel) {
    return mix(vec4(0.0), texel, bvec4(exists));
}

// w * v, or 0 where the mask hides the pair: there w is 0, but v may be NaN, and 0 * NaN is NaN.
vec4 masked_term(bool seen, float w, vec4 v) {
    return mix(vec4(0.0), w * v, bvec4(seen));
}

float lanes_max(float x) {
    x = max(x, lane_shuffle_xor(x, 1u));
    x = max(x, lane_shuffle_xor(x, 2u));
    return max(x, lane_shuffle_xor(x, 4u));
}

float lanes_sum(float x) {
    x += lane_shuffle_xor(x, 1u);
    x += lane_shuffle_xor(x, 2u);
    return x + lane_shuffle_xor(x, 4u);
}
