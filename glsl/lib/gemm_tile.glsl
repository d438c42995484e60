// lib/gemm_tile: one 16 x (8*BLOCKS) tile of A*W^T, kept in registers by one subgroup of eight lanes.
// The including shader names its operands a_tex (row-major [m, 4*k4]) and w_tex (packed [n/8][k4][8 lanes] vec4),
// and its constants BLOCKS (lane-blocks of eight columns) and UNROLL (divides k4).
// Lane l loads rows l and l+8 of A and column l of every block of W; rows are broadcast by constant shuffles,
// so acc[row*BLOCKS + block] of lane l is the element (row, 8*block + l). A row past the end repeats the last one.
const int TILE_ROWS = 16;
float acc[TILE_ROWS * BLOCKS];

void gemm_tile(int lane, int row0, int block0, int last_row, int k4) {
    int a0 = min(row0 + lane, last_row) * k4;
    int a1 = min(row0 + 8 + lane, last_row) * k4;
    int w0 = block0 * k4 * 8 + lane;
    [[unroll]] for (int i = 0; i < TILE_ROWS * BLOCKS; ++i) {
        acc[i] = 0.0;
    }
    int t = 0;
    do {
        [[unroll]] for (int u = 0; u < UNROLL; ++u) {
            vec4 rows0 = imageLoad(a_tex, a0 + t + u);
            vec4 rows1 = imageLoad(a_tex, a1 + t + u);
            vec4 w[BLOCKS];
            [[unroll]] for (int b = 0; b < BLOCKS; ++b) {
                w[b] = imageLoad(w_tex, w0 + (b * k4 + t + u) * 8);
            }
            [[unroll]] for (int r = 0; r < 8; ++r) {
                vec4 low = subgroupShuffle(rows0, r);
                vec4 high = subgroupShuffle(rows1, r);
                [[unroll]] for (int b = 0; b < BLOCKS; ++b) {
                    [[unroll]] for (int q = 0; q < 4; ++q) {
                        acc[r * BLOCKS + b] += low[q] * w[b][q];
                    }
                    [[unroll]] for (int q = 0; q < 4; ++q) {
                        acc[(r + 8) * BLOCKS + b] += high[q] * w[b][q];
                    }
                }
            }
        }
        t += UNROLL;
    } while (t < k4);
}
