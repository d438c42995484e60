#version 460
// nn/matmul_fwd_tile: nn/matmul_fwd for GPUs. One workgroup per tile of 8*ROWS rows x 64 columns.
//   in   a [m, k]   w packed by nn/pack [n/8][k/4][8] vec4   bias [n]   aux [m, n], read if MODE > 0
//        FIXED16: w packed [n/16][k/4][8] uvec4 of 16-bit codes, times scale [n]
//        WINDOWS: a holds images, whose windows are the rows of A (lib/windows)
//   out  c [m, n] (=), epilogue(A*W^T + bias)
//   twin kernels/src/reference/nn/matmul.rs   sums run over k in order, so the result is deterministic
//   An invocation fetches 4 x 4 blocks of A and W and transposes them in registers on their way to shared memory. The
//     next
//   blocks are fetched before this panel is multiplied, so that their latency hides behind 1024*ROWS/8 multiply-adds.
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 128) in;
layout(constant_id = 0) const int ROWS = 8;
layout(constant_id = 1) const uint MODE = 0;
layout(constant_id = 2) const uint ACTIVATION = 0;
#ifdef WINDOWS
layout(push_constant) uniform Params {
    int m, n, k, height, width, out_height, out_width, channels4, taps, padding;
} p;
#include "lib/windows.glsl"
#else
layout(push_constant) uniform Params { int m; int n; int k; } p;
#endif
layout(set = 0, binding = 0) readonly buffer A { vec4 a[]; };
#ifdef FIXED16
layout(set = 0, binding = 1) readonly buffer W { uvec4 w[]; };
layout(set = 0, binding = 5) readonly buffer Scale { vec4 scale[]; };
#else
layout(set = 0, binding = 1) readonly buffer W { vec4 w[]; };
#endif
layout(set = 0, binding = 2) readonly buffer Bias { vec4 bias[]; };
layout(set = 0, binding = 3) readonly buffer Aux { vec4 aux[]; };
layout(set = 0, binding = 4) writeonly buffer C { vec4 c[]; };

#include "lib/epilogue.glsl"
#include "lib/matmul_tile.glsl"

vec4 next_left[4];
vec4 next_right[4];
#ifdef WINDOWS
// Of the four rows that this invocation fetches.
ivec3 corners[4];
#endif

// Column j of W at one texel of k; codes of two lane-blocks share their words.
vec4 column_texel(int j, int texel) {
    int k4 = p.k / 4;
#ifdef FIXED16
    ivec4 codes = ivec4(w[((j / 16) * k4 + texel) * 8 + j % 8]);
    return vec4(j / 8 % 2 == 0 ? codes << 16 >> 16 : codes >> 16);
#else
    return w[((j / 8) * k4 + texel) * 8 + j % 8];
#endif
}

#ifdef WINDOWS
// One texel of k of row `corners[q]` of A, for the tap and the channel that it belongs to.
vec4 row_texel(int q, ivec2 tap, int channel) {
    int at = window_texel(corners[q], tap);
    return at == OUTSIDE ? vec4(0.0) : a[at + channel];
}
#endif

// Four rows of A and four columns of W at one texel of k; zero outside, where both factors of a product are zero then.
void fetch(int row, int column, int texel) {
    int k4 = p.k / 4;
#ifdef WINDOWS
    int tap_number = texel / p.channels4;
    ivec2 tap = ivec2(tap_number % p.taps, tap_number / p.taps);
    int channel = texel % p.channels4;
#endif
    [[unroll]] for (int q = 0; q < 4; ++q) {
        int j = column + q;
#ifdef WINDOWS
        next_left[q] = row + q < p.m && texel < k4 ? row_texel(q, tap, channel) : vec4(0.0);
#else
        next_left[q] = row + q < p.m && texel < k4 ? a[(row + q) * k4 + texel] : vec4(0.0);
#endif
        next_right[q] = j < p.n && texel < k4 ? column_texel(j, texel) : vec4(0.0);
    }
}

void main() {
    int x = int(gl_LocalInvocationID.x) % COLUMN_TEXELS;
    int y = int(gl_LocalInvocationID.x) / COLUMN_TEXELS;
    int row0 = int(gl_WorkGroupID.x) * 8 * ROWS;
    int column = (int(gl_WorkGroupID.y) * COLUMN_TEXELS + x) * 4;
    // Invocations beyond the rows of a lower tile fetch nothing.
    int fetched_row = x < ROW_TEXELS ? row0 + 4 * x : p.m;
#ifdef WINDOWS
    [[unroll]] for (int q = 0; q < 4; ++q) {
        corners[q] = window_corner(min(fetched_row + q, p.m - 1));
    }
#endif
    clear_tile();
    int texel = 0;
    fetch(fetched_row, column, y);
    do {
        [[unroll]] for (int q = 0; q < 4; ++q) {
            if (x < ROW_TEXELS) {
                panel_left[(4 * y + q) * ROW_TEXELS + x] =
                    vec4(next_left[0][q], next_left[1][q], next_left[2][q], next_left[3][q]);
            }
            panel_right[(4 * y + q) * COLUMN_TEXELS + x] =
                vec4(next_right[0][q], next_right[1][q], next_right[2][q], next_right[3][q]);
        }
        barrier();
        texel += DEPTH / 4;
        fetch(fetched_row, column, texel + y);
        multiply_panels(x, y);
        barrier();
    } while (texel < p.k / 4);
    if (column < p.n) {
        vec4 shift = bias[column / 4];
#ifdef FIXED16
        vec4 unit = scale[column / 4];
#else
        const vec4 unit = vec4(1.0);
#endif
        [[unroll]] for (int r = 0; r < ROWS; ++r) {
            int row = row0 + y * ROWS + r;
            if (row < p.m) {
                int at = (row * p.n + column) / 4;
                c[at] = epilogue(acc[r] * unit + shift, MODE > 0u ? aux[at] : vec4(0.0));
            }
        }
    }
}
