#version 460
// nn/conv3d_correlate: gradient to the weights of nn/conv3d_fwd, one partial sum per chunk of rows. Lanes run along x.
//   in   x [F,H,W,Ci]   v_y [F,H,W,Co]
//   out  partial [chunks, 27*(Ci/4)*Co, 4] (=) in weight order, with BIAS Co more behind each
//   twin kernels/src/reference/nn/conv3d.rs   groups: x = chunk, y = tap, z = input block, output block
#extension GL_EXT_control_flow_attributes : require
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
layout(constant_id = 0) const uint IN4 = 4;
layout(constant_id = 1) const uint OUT4 = 4;
layout(constant_id = 2) const uint IN_BLOCK4 = 4;
layout(constant_id = 3) const uint OUT_BLOCK4 = 4;
layout(constant_id = 4) const uint PAD_T = 0;
layout(constant_id = 5) const uint PAD_XY = 0;
layout(constant_id = 6) const uint BIAS = 0;
layout(constant_id = 7) const int UNROLL = 4;
layout(push_constant) uniform Params { int frames, height, width, chunk_rows; } p;
TEXELS_F32(0, x);
TEXELS_F32(1, v_y);
layout(set = 0, binding = 2) writeonly buffer Partial { vec4 partial[]; };
#include "lib/conv3d.glsl"

vec4 lane_sum(vec4 v) {
    v += lane_shuffle_xor(v, 1);
    v += lane_shuffle_xor(v, 2);
    return v + lane_shuffle_xor(v, 4);
}

void main() {
    int tap = int(gl_WorkGroupID.y);
    uint out_blocks = OUT4 / OUT_BLOCK4;
    uint in_first = gl_WorkGroupID.z / out_blocks * IN_BLOCK4;
    uint out_first = gl_WorkGroupID.z % out_blocks * OUT_BLOCK4;
    vec4 acc[IN_BLOCK4][OUT_BLOCK4 * 4];
    vec4 bias[OUT_BLOCK4];
    [[unroll]] for (uint c = 0; c < OUT_BLOCK4 * 4; c++) {
        bias[c / 4] = vec4(0.0);
        [[unroll]] for (uint i = 0; i < IN_BLOCK4; i++) acc[i][c] = vec4(0.0);
    }
    int row = int(gl_WorkGroupID.x) * p.chunk_rows;
    int end = min(row + p.chunk_rows, p.frames * p.height);
    do {
        int st = pad_index(row / p.height + tap / 9 - 1, p.frames, PAD_T);
        int sy = pad_index(row % p.height + tap / 3 % 3 - 1, p.height, PAD_XY);
        int column = int(gl_LocalInvocationID.x);
        int spans = (p.width + 8 * UNROLL - 1) / (8 * UNROLL);
        do {
            [[unroll]] for (int u = 0; u < UNROLL; u++) {
                int here = min(column, p.width - 1);
                int sx = pad_index(here + tap % 3 - 1, p.width, PAD_XY);
                bool inside = column < p.width;
                bool reads = inside && st >= 0 && sy >= 0 && sx >= 0;
                vec4 g[OUT_BLOCK4];
                [[unroll]] for (uint c = 0; c < OUT_BLOCK4; c++) {
                    vec4 texel = texel_load(v_y, (row * p.width + here) * int(OUT4) + int(out_first + c));
                    if (BIAS != 0) bias[c] += mix(vec4(0.0), texel, bvec4(inside));
                    g[c] = mix(vec4(0.0), texel, bvec4(reads));
                }
                int from = reads ? (st * p.height + sy) * p.width + sx : 0;
                [[unroll]] for (uint i = 0; i < IN_BLOCK4; i++) {
                    // Both factors become 0: the texel read instead may hold a NaN that this tap never meets.
                    vec4 a = mix(vec4(0.0), texel_load(x, from * int(IN4) + int(in_first + i)), bvec4(reads));
                    [[unroll]] for (uint c = 0; c < OUT_BLOCK4 * 4; c++) acc[i][c] += a * g[c / 4][c % 4];
                }
                column += 8;
            }
            spans--;
        } while (spans > 0);
        row++;
    } while (row < end);

    uint texels = 27 * IN4 * OUT4 * 4;
    uint base = gl_WorkGroupID.x * (texels + (BIAS != 0 ? OUT4 : 0));
    [[unroll]] for (uint i = 0; i < IN_BLOCK4; i++) {
        uint at = base + ((uint(tap) * IN4 + in_first + i) * OUT4 + out_first) * 4;
        [[unroll]] for (uint c = 0; c < OUT_BLOCK4 * 4; c++) {
            vec4 sum = lane_sum(acc[i][c]);
            if (gl_LocalInvocationID.x == 0) partial[at + c] = sum;
        }
    }
    if (BIAS != 0) {
        bool owns_bias = tap == 13 && in_first == 0 && gl_LocalInvocationID.x == 0;
        [[unroll]] for (uint c = 0; c < OUT_BLOCK4; c++) {
            vec4 sum = lane_sum(bias[c]);
            if (owns_bias) partial[base + texels + out_first + c] = sum;
        }
    }
}
