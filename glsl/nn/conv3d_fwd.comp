#version 460
// nn/conv3d_fwd: 3x3x3 convolution, stride 1, channels last; implicit GEMM, one subgroup per 32 pixels of a row.
//   in   x [F,H,W,Ci]   weight [27,Ci/4,Co,4] and, with BIAS, [Co] behind it
//   out  y [F,H,W,Co] (=), max(0, y) with RELU
//   twin kernels/src/reference/nn/conv3d.rs   groups: x = 32-pixel spans, y = rows, z = frame, output block
#extension GL_EXT_control_flow_attributes : require
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
layout(constant_id = 0) const uint DEPTH4 = 4;
layout(constant_id = 1) const uint WIDTH4 = 4;
layout(constant_id = 2) const uint BLOCK4 = 4;
layout(constant_id = 3) const uint PAD_T = 0;
layout(constant_id = 4) const uint PAD_XY = 0;
layout(constant_id = 5) const uint BIAS = 0;
layout(constant_id = 6) const uint RELU = 0;
layout(push_constant) uniform Params { int frames, height, width; } p;
TEXELS_F32(0, x);
TEXELS_F32(1, weight);
layout(set = 0, binding = 2) writeonly buffer Y { vec4 y[]; };
#define CONV3D_SOURCE(i) texel_load(x, i)
#define CONV3D_WEIGHT(i) texel_load(weight, i)
#include "lib/conv3d.glsl"
#include "lib/keep_nan.glsl"
#include "lib/conv3d_block.glsl"

void main() {
    int column = int(gl_WorkGroupID.x * 32 + gl_LocalInvocationID.x);
    int row = int(gl_WorkGroupID.y);
    uint blocks = WIDTH4 / BLOCK4;
    int frame = int(gl_WorkGroupID.z / blocks);
    uint first = gl_WorkGroupID.z % blocks * BLOCK4;

    float acc[PIXELS][MAX_CHANNELS];
    [[unroll]] for (uint c = 0; c < BLOCK4 * 4; c++) {
        float bias = BIAS == 0 ? 0.0 : texel_load(weight, int(27 * DEPTH4 * WIDTH4 * 4 + first + c / 4))[c % 4];
        [[unroll]] for (int b = 0; b < PIXELS; b++) acc[b][c] = bias;
    }
    uint tap = 0;
    do {
        int st = pad_index(frame + int(tap / 9) - 1, p.frames, PAD_T);
        int sy = pad_index(row + int(tap / 3 % 3) - 1, p.height, PAD_XY);
        int index[PIXELS];
        [[unroll]] for (int b = 0; b < PIXELS; b++) {
            int sx = pad_index(min(column + b * 8, p.width - 1) + int(tap % 3) - 1, p.width, PAD_XY);
            index[b] = st < 0 || sy < 0 || sx < 0 ? -1 : (st * p.height + sy) * p.width + sx;
        }
        conv3d_tap(acc, index, tap, first);
        tap++;
    } while (tap < 27);
    [[unroll]] for (int b = 0; b < PIXELS; b++) {
        if (column + b * 8 < p.width) {
            uint at = uint((frame * p.height + row) * p.width + column + b * 8) * WIDTH4 + first;
            [[unroll]] for (uint c = 0; c < BLOCK4; c++) {
                vec4 v = vec4(acc[b][c * 4], acc[b][c * 4 + 1], acc[b][c * 4 + 2], acc[b][c * 4 + 3]);
                y[at + c] = RELU == 0 ? v : keep_nan(v, max(v, vec4(0.0)));
            }
        }
    }
}
