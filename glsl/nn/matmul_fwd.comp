#version 460
// nn/matmul_fwd: C = epilogue(A*W^T + bias). One subgroup of eight lanes per tile of 16 rows x 8*BLOCKS columns.
//   in   a [m, k]   w packed by nn/pack [n/8][k/4][8] vec4   bias [n]   aux [m, n], read if MODE > 0
//        FIXED16: w packed [n/16][k/4][8] uvec4 of 16-bit codes, times scale [n]
//        WINDOWS: a holds images, whose windows are the rows of A (lib/windows)
//   out  c [m, n] (=)   MODE 0: act(s)   MODE 1: s + aux   MODE 2: s * act'(aux), for s = A*W^T + bias
//   twin kernels/src/reference/nn/matmul.rs   sums run over k in order, so the result is deterministic
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
layout(constant_id = 0) const int BLOCKS = 6;
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
TEXELS_F32(0, a_tex);
#ifdef FIXED16
TEXELS_U32(1, w_tex);
TEXELS_F32(5, scale);
#else
TEXELS_F32(1, w_tex);
#endif
TEXELS_F32(2, bias);
TEXELS_F32(3, aux_tex);
layout(set = 0, binding = 4) writeonly buffer C { vec4 c[]; };

#include "lib/activation.glsl"
#include "lib/gemm_tile.glsl"

vec4 epilogue(vec4 s, int at) {
    if (MODE == 1u) {
        return s + texel_load(aux_tex, at);
    }
    if (MODE == 2u) {
        return s * activate_grad4(ACTIVATION, texel_load(aux_tex, at));
    }
    return activate4(ACTIVATION, s);
}

void main() {
    int lane = int(gl_LocalInvocationID.x);
    int row0 = int(gl_WorkGroupID.x) * TILE_ROWS;
    int block0 = int(gl_WorkGroupID.y) * BLOCKS;
    gemm_tile(lane, row0, block0, p.m - 1, p.k / 4);
    [[unroll]] for (int half_tile = 0; half_tile < 2; ++half_tile) {
        int row = row0 + 8 * half_tile + lane;
        int row_texel = min(row, p.m - 1) * (p.n / 4);
        [[unroll]] for (int b = 0; b < BLOCKS; ++b) {
            int column = (block0 + b) * 8 + lane;
            float shift = texel_pick(bias, column);
#ifdef FIXED16
            float unit = texel_pick(scale, column);
#else
            const float unit = 1.0;
#endif
            float v[8];
            [[unroll]] for (int r = 0; r < 8; ++r) {
                v[r] = acc[(8 * half_tile + r) * BLOCKS + b] * unit + shift;
            }
            transpose_block(v, lane);
            int at = row_texel + (block0 + b) * 2;
            vec4 left = epilogue(vec4(v[0], v[1], v[2], v[3]), at);
            vec4 right = epilogue(vec4(v[4], v[5], v[6], v[7]), at + 1);
            if (row < p.m) {
                c[at] = left;
                c[at + 1] = right;
            }
        }
    }
}
