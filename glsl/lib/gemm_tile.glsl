// lib/gemm_tile: one 16 x (8*BLOCKS) tile of A*W^T, kept by one subgroup of eight lanes.
// The including shader names its operands a_tex (row-major [m, 4*k4]) and w_tex (packed [n/8][k4][8 lanes] vec4)
// and defines BLOCKS, the lane-blocks of eight columns. With FIXED16 w_tex is [n/16][k4][8 lanes] uvec4: signed 16-bit
// codes, of an even lane-block in the low halves and of the next one in the high halves; BLOCKS is even.
// Lane l loads rows l and l+8 of A and column l of every block of W; rows are broadcast by constant shuffles,
// so acc[row*BLOCKS + block] of lane l is the element (row, 8*block + l). A row past the end repeats the last one.
// Each accumulator takes its four products in a row: it then lives in a register for them, although 96 do not fit.
const int TILE_ROWS = 16;
float acc[TILE_ROWS * BLOCKS];

void gemm_tile(int lane, int row0, int block0, int last_row, int k4) {
    int a0 = min(row0 + lane, last_row) * k4;
    int a1 = min(row0 + 8 + lane, last_row) * k4;
#ifdef FIXED16
    int w0 = block0 / 2 * k4 * 8 + lane;
#else
    int w0 = block0 * k4 * 8 + lane;
#endif
    [[unroll]] for (int i = 0; i < TILE_ROWS * BLOCKS; ++i) {
        acc[i] = 0.0;
    }
    int t = 0;
    do {
        vec4 w[BLOCKS];
#ifdef FIXED16
        [[unroll]] for (int b = 0; b < BLOCKS; b += 2) {
            ivec4 codes = ivec4(texel_load(w_tex, w0 + (b / 2 * k4 + t) * 8));
            w[b] = vec4(codes << 16 >> 16);
            w[b + 1] = vec4(codes >> 16);
        }
#else
        [[unroll]] for (int b = 0; b < BLOCKS; ++b) {
            w[b] = texel_load(w_tex, w0 + (b * k4 + t) * 8);
        }
#endif
        vec4 rows[2] = vec4[2](texel_load(a_tex, a0 + t), texel_load(a_tex, a1 + t));
        [[unroll]] for (int r = 0; r < TILE_ROWS; ++r) {
            vec4 a = lane_shuffle(rows[r / 8], r % 8);
            [[unroll]] for (int b = 0; b < BLOCKS; ++b) {
                [[unroll]] for (int q = 0; q < 4; ++q) {
                    acc[r * BLOCKS + b] += a[q] * w[b][q];
                }
            }
        }
    } while (++t < k4);
}

// Eight rows of one lane-block, transposed: lane l gets row l's eight columns.
void transpose_block(inout float v[8], int lane) {
    [[unroll]] for (int stage = 0; stage < 3; ++stage) {
        int bit = 1 << stage;
        bool upper = (lane & bit) != 0;
        [[unroll]] for (int r = 0; r < 8; ++r) {
            if ((r & bit) == 0) {
                float other = lane_shuffle_xor(upper ? v[r] : v[r + bit], bit);
                v[r] = upper ? other : v[r];
                v[r + bit] = upper ? v[r + bit] : other;
            }
        }
    }
}
