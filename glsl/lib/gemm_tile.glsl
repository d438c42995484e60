// lib/gemm_tile: one 16 x (8*BLOCKS) tile of A*W^T, kept by one subgroup of eight lanes.
// The including shader names its operands a_tex (row-major [m, 4*k4]) and w_tex (packed [n/8][k4][8 lanes] vec4)
// and defines BLOCKS, the lane-blocks of eight columns. With FIXED16 w_tex is [n/16][k4][8 lanes] uvec4: signed 16-bit
// codes, of an even lane-block in the low halves and of the next one in the high halves; BLOCKS is even.
// Lane l loads rows l and l+8 of A and column l of every block of W; rows are broadcast by constant shuffles,
// so acc[row*BLOCKS + block] of lane l is the element (row, 8*block + l). A row past the end repeats the last one.
// Each accumulator takes its four products in a row: it then lives in a register for them, although 96 do not fit.
// With WINDOWS the rows of A are the windows of an image (lib/windows): A is never written out.
const int TILE_ROWS = 16;
float acc[TILE_ROWS * BLOCKS];

// Adds the products of texel `t` of k: texel `a0` or `a1` of a lane's rows, and a texel of each block of W, which
// starts at `w`.
void multiply_texel(int a0, int a1, int w, int t, int k4) {
    vec4 columns[BLOCKS];
#ifdef FIXED16
    [[unroll]] for (int b = 0; b < BLOCKS; b += 2) {
        ivec4 codes = ivec4(texel_load(w_tex, w + (b / 2 * k4 + t) * 8));
        columns[b] = vec4(codes << 16 >> 16);
        columns[b + 1] = vec4(codes >> 16);
    }
#else
    [[unroll]] for (int b = 0; b < BLOCKS; ++b) {
        columns[b] = texel_load(w_tex, w + (b * k4 + t) * 8);
    }
#endif
    vec4 rows[2] = vec4[2](texel_load(a_tex, a0), texel_load(a_tex, a1));
    [[unroll]] for (int r = 0; r < TILE_ROWS; ++r) {
        vec4 a = lane_shuffle(rows[r / 8], r % 8);
        [[unroll]] for (int b = 0; b < BLOCKS; ++b) {
            [[unroll]] for (int q = 0; q < 4; ++q) {
                acc[r * BLOCKS + b] += a[q] * columns[b][q];
            }
        }
    }
}

void gemm_tile(int lane, int row0, int block0, int last_row, int k4) {
    int first = min(row0 + lane, last_row);
    int second = min(row0 + 8 + lane, last_row);
#ifdef FIXED16
    int w = block0 / 2 * k4 * 8 + lane;
#else
    int w = block0 * k4 * 8 + lane;
#endif
    [[unroll]] for (int i = 0; i < TILE_ROWS * BLOCKS; ++i) {
        acc[i] = 0.0;
    }
#ifdef WINDOWS
    ivec3 corner0 = window_corner(first);
    ivec3 corner1 = window_corner(second);
    ivec2 tap = ivec2(0);
    int t = 0;
    do {
        tap.x = 0;
        do {
            int a0 = window_texel(corner0, tap);
            int a1 = window_texel(corner1, tap);
            int c = 0;
            do {
                multiply_texel(a0 + c, a1 + c, w, t, k4);
                t++;
            } while (++c < p.channels4);
        } while (++tap.x < p.taps);
    } while (++tap.y < p.taps);
#else
    int a0 = first * k4;
    int a1 = second * k4;
    int t = 0;
    do {
        multiply_texel(a0 + t, a1 + t, w, t, k4);
    } while (++t < k4);
#endif
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
