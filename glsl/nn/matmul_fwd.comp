#version 460
// nn/matmul_fwd: C = epilogue(A*W^T + bias). One subgroup of eight lanes per tile of 16 rows x 8*BLOCKS columns.
//   in   a [m, k]   w packed by nn/pack [n/8][k/4][8] vec4   bias [n]   aux [m, n], read if MODE > 0
//   out  c [m, n] (=)   MODE 0: act(s)   MODE 1: s + aux   MODE 2: s * act'(aux), for s = A*W^T + bias
//   twin kernels/src/reference/nn/matmul.rs   sums run over k in order, so the result is deterministic
#extension GL_KHR_shader_subgroup_shuffle : require
#extension GL_EXT_control_flow_attributes : require

layout(local_size_x = 8) in;
layout(constant_id = 0) const int BLOCKS = 6;
layout(constant_id = 1) const int UNROLL = 2;
layout(constant_id = 2) const uint MODE = 0;
layout(constant_id = 3) const uint ACTIVATION = 0;
layout(push_constant) uniform Params { int m; int n; int k; } p;
layout(set = 0, binding = 0, rgba32f) uniform readonly imageBuffer a_tex;
layout(set = 0, binding = 1, rgba32f) uniform readonly imageBuffer w_tex;
layout(set = 0, binding = 2) readonly buffer Bias { float bias[]; };
layout(set = 0, binding = 3) readonly buffer Aux { float aux[]; };
layout(set = 0, binding = 4) writeonly buffer C { float c[]; };

#include "lib/activation.glsl"
#include "lib/gemm_tile.glsl"

void main() {
    int lane = int(gl_LocalInvocationID.x);
    int row0 = int(gl_WorkGroupID.x) * TILE_ROWS;
    int block0 = int(gl_WorkGroupID.y) * BLOCKS;
    gemm_tile(lane, row0, block0, p.m - 1, p.k / 4);
    [[unroll]] for (int b = 0; b < BLOCKS; ++b) {
        int col = (block0 + b) * 8 + lane;
        float shift = bias[col];
        [[unroll]] for (int r = 0; r < TILE_ROWS; ++r) {
            if (row0 + r < p.m) {
                int at = (row0 + r) * p.n + col;
                float s = acc[r * BLOCKS + b] + shift;
                if (MODE == 0u) {
                    s = activate(ACTIVATION, s);
                }
                if (MODE == 1u) {
                    s += aux[at];
                }
                if (MODE == 2u) {
                    s *= activate_grad(ACTIVATION, aux[at]);
                }
                c[at] = s;
            }
        }
    }
}
