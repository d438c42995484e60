// lib/matmul_tile: a tile of 8*ROWS x 64 sums of products, held by 128 invocations in registers. Two panels of DEPTH k
// go through 16 KiB of shared memory; with ROWS = 4 half of the left one is unused. Invocation (x, y) = (id % 16, id /
// 16) holds the rows ROWS*y.. and the columns 4x..: for one k it reads ROWS/4 + 1 vec4 and does 4*ROWS multiply-adds. A
// vec4 of a panel spans four rows or columns, so all these reads are free of bank conflicts. Each sum runs over k in
// order.
const int DEPTH = 32;
const int COLUMN_TEXELS = 16;
const int MAX_ROW_TEXELS = 16;
const int ROW_TEXELS = 2 * ROWS;
shared vec4 panel_left[DEPTH * MAX_ROW_TEXELS];
shared vec4 panel_right[DEPTH * COLUMN_TEXELS];
vec4 acc[ROWS];

void clear_tile() {
    [[unroll]] for (int r = 0; r < ROWS; ++r) {
        acc[r] = vec4(0.0);
    }
}

void multiply_panels(int x, int y) {
    int k = 0;
    do {
        [[unroll]] for (int u = 0; u < 4; ++u) {
            vec4 right = panel_right[(k + u) * COLUMN_TEXELS + x];
            [[unroll]] for (int g = 0; g < ROWS / 4; ++g) {
                vec4 left = panel_left[(k + u) * ROW_TEXELS + y * (ROWS / 4) + g];
                [[unroll]] for (int q = 0; q < 4; ++q) {
                    acc[4 * g + q] += left[q] * right;
                }
            }
        }
        k += 4;
    } while (k < DEPTH);
}
