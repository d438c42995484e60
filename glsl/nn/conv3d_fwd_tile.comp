#version 460
// nn/conv3d_fwd_tile: nn/conv3d_fwd for GPUs; implicit GEMM over channels-last tiles.
//   in   x [F,H,W,Ci]   weight [27,Ci/4,Co,4] and, with BIAS, [Co] behind it
//   out  y [F,H,W,Co] (=), max(0, y) with RELU
//   twin kernels/src/reference/nn/conv3d.rs   groups: x = 32-pixel spans, y = 16 rows, z = frame, output block
#extension GL_EXT_control_flow_attributes : require
layout(local_size_x = 128) in;
layout(constant_id = 0) const uint DEPTH4 = 4;
layout(constant_id = 1) const uint WIDTH4 = 4;
layout(constant_id = 2) const uint BLOCK4 = 4;
layout(constant_id = 3) const uint PAD_T = 0;
layout(constant_id = 4) const uint PAD_XY = 0;
layout(constant_id = 5) const uint BIAS = 0;
layout(constant_id = 6) const uint RELU = 0;
layout(push_constant) uniform Params { int frames, height, width; } p;
layout(set = 0, binding = 0) readonly buffer X { vec4 x[]; };
layout(set = 0, binding = 1) readonly buffer Weight { vec4 weight[]; };
layout(set = 0, binding = 2) writeonly buffer Y { vec4 y[]; };
#include "lib/conv3d.glsl"
#include "lib/keep_nan.glsl"
#define CONV3D_GATHER(column, row, dx, dy) halo[((row) + (dy)) * HALO_W + (column) + (dx)]
#include "lib/conv3d_halo.glsl"

// A position that no tap of a pixel inside reads may be any; it must only lie inside, or be left out.
#define PADDED_X(c) ((c) > p.width ? -1 : pad_index(c, p.width, PAD_XY))
#define PADDED_Y(c) ((c) > p.height ? -1 : pad_index(c, p.height, PAD_XY))

void main() {
    int id = int(gl_LocalInvocationID.x);
    int left = int(gl_WorkGroupID.x) * TILE_W;
    int top = int(gl_WorkGroupID.y) * TILE_H;
    int blocks = int(WIDTH4 / BLOCK4);
    int frame = int(gl_WorkGroupID.z) / blocks;
    int first = int(gl_WorkGroupID.z) % blocks * int(BLOCK4);

    float acc[PIXELS][MAX_CHANNELS];
    [[unroll]] for (int c = 0; c < int(BLOCK4) * 4; ++c) {
        float bias = BIAS == 0 ? 0.0 : weight[27 * int(DEPTH4 * WIDTH4) * 4 + first + c / 4][c % 4];
        [[unroll]] for (int b = 0; b < PIXELS; ++b) {
            acc[b][c] = bias;
        }
    }
    int stage = 0;
    do {
        int dt = stage / int(DEPTH4);
        int q = stage % int(DEPTH4);
        int st = pad_index(frame + dt - 1, p.frames, PAD_T);
        if (st >= 0) {
            LOAD_HALO(x, PADDED_X, PADDED_Y, st, q)
            LOAD_TAPS(weight, dt * 9, q, first)
            barrier();
            ADD_TAPS(acc)
            barrier();
        }
    } while (++stage < 3 * int(DEPTH4));
    [[unroll]] for (int b = 0; b < PIXELS; ++b) {
        int column = left + id % TILE_W;
        int row = top + id / TILE_W + 4 * b;
        if (column < p.width && row < p.height) {
            int at = ((frame * p.height + row) * p.width + column) * int(WIDTH4) + first;
            [[unroll]] for (int c = 0; c < int(BLOCK4); ++c) {
                vec4 v = vec4(acc[b][c * 4], acc[b][c * 4 + 1], acc[b][c * 4 + 2], acc[b][c * 4 + 3]);
                y[at + c] = RELU == 0 ? v : keep_nan(v, max(v, vec4(0.0)));
            }
        }
    }
}
