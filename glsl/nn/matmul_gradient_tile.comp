#version 460
// nn/matmul_gradient_tile: gradient of A*W^T to W on GPUs. One workgroup per tile of 8*ROWS rows x 64 columns.
//   in   v_c [m, n]   a [m, k]
//   out  v_w [n, k] (=), v_c^T * A
//   twin kernels/src/reference/nn/matmul.rs   sums run over m in order, so the result is deterministic
//   Rows of both operands are panels as they lie, so neither is transposed or packed first. Loads as in
//     nn/matmul_fwd_tile.
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 128) in;
layout(constant_id = 0) const int ROWS = 8;
layout(push_constant) uniform Params { int m; int n; int k; } p;
layout(set = 0, binding = 0) readonly buffer VC { vec4 v_c[]; };
layout(set = 0, binding = 1) readonly buffer A { vec4 a[]; };
layout(set = 0, binding = 2) writeonly buffer VW { vec4 v_w[]; };

#include "lib/matmul_tile.glsl"

const int FETCHES = 4;
vec4 next_left[FETCHES];
vec4 next_right[FETCHES];

// Texels of eight rows apart, one for each invocation; zero outside.
void fetch(int left, int right, int row) {
    [[unroll]] for (int q = 0; q < FETCHES; ++q) {
        int r = row + q * (DEPTH / FETCHES);
        next_left[q] = r < p.m && left < p.n / 4 ? v_c[r * (p.n / 4) + left] : vec4(0.0);
        next_right[q] = r < p.m && right < p.k / 4 ? a[r * (p.k / 4) + right] : vec4(0.0);
    }
}

void main() {
    int x = int(gl_LocalInvocationID.x) % COLUMN_TEXELS;
    int y = int(gl_LocalInvocationID.x) / COLUMN_TEXELS;
    int row0 = int(gl_WorkGroupID.x) * 8 * ROWS;
    int left = x < ROW_TEXELS ? row0 / 4 + x : p.n / 4;
    int right = int(gl_WorkGroupID.y) * COLUMN_TEXELS + x;
    clear_tile();
    int first = 0;
    fetch(left, right, y);
    do {
        [[unroll]] for (int q = 0; q < FETCHES; ++q) {
            int at = y + q * (DEPTH / FETCHES);
            if (x < ROW_TEXELS) {
                panel_left[at * ROW_TEXELS + x] = next_left[q];
            }
            panel_right[at * COLUMN_TEXELS + x] = next_right[q];
        }
        barrier();
        first += DEPTH;
        fetch(left, right, first + y);
        multiply_panels(x, y);
        barrier();
    } while (first < p.m);
    [[unroll]] for (int r = 0; r < ROWS; ++r) {
        int row = row0 + y * ROWS + r;
        if (row < p.n && right < p.k / 4) {
            v_w[row * (p.k / 4) + right] = acc[r];
        }
    }
}
