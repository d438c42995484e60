#version 460
// nn/conv3d_bwd_tile: nn/conv3d_bwd for GPUs, the exact adjoint of convolution and padding.
//   in   v_y [F,H,W,Co]   weight_t [27,Co/4,Ci,4]   gate [F,H,W,Ci], read with GATE only
//   out  v_x [F,H,W,Ci] (=), with GATE zero where gate <= 0: the derivative of the ReLU that made the input
//   twin kernels/src/reference/nn/conv3d.rs   groups: x = 32-pixel spans, y = 16 rows, z = frame, input block
//   Padding reads one pixel of an axis, its fold target, from outside too; the adjoint then adds, at the outer taps of
//     that
//   pixel, the gradient of the border pixel, which lies in the same halo. Along frames it is one more stage instead.
#extension GL_EXT_control_flow_attributes : require
layout(local_size_x = 128) in;
layout(constant_id = 0) const uint DEPTH4 = 4;
layout(constant_id = 1) const uint WIDTH4 = 4;
layout(constant_id = 2) const uint BLOCK4 = 4;
layout(constant_id = 3) const uint PAD_T = 0;
layout(constant_id = 4) const uint PAD_XY = 0;
layout(constant_id = 5) const uint GATE = 0;
layout(push_constant) uniform Params { int frames, height, width; } p;
layout(set = 0, binding = 0) readonly buffer VY { vec4 v_y[]; };
layout(set = 0, binding = 1) readonly buffer WeightT { vec4 weight_t[]; };
layout(set = 0, binding = 2) readonly buffer Gate { vec4 gate[]; };
layout(set = 0, binding = 3) writeonly buffer VX { vec4 v_x[]; };
#include "lib/conv3d.glsl"
#define CONV3D_GATHER(column, row, dx, dy) gather(column, row, dx, dy)
vec4 gather(int column, int row, int dx, int dy);
#include "lib/conv3d_halo.glsl"

int left;
int top;

#define PLAIN_X(c) ((c) < p.width ? (c) : -1)
#define PLAIN_Y(c) ((c) < p.height ? (c) : -1)

// Halo position of the border entry that coordinate c also gets at this tap, -1 = none. `first` is the tile's first.
int folded(int c, int tap, int first, int n) {
    ivec2 targets = fold_targets(n, PAD_XY);
    int low = tap == 0 && c == targets.x ? 1 - first : -1;
    return tap == 2 && c == targets.y ? n - first : low;
}

vec4 gather(int column, int row, int dx, int dy) {
    int at_x = column + 2 - dx;
    int at_y = row + 2 - dy;
    vec4 sum = halo[at_y * HALO_W + at_x];
    if (PAD_XY != PAD_ZERO) {
        int also_x = folded(left + column, dx, left, p.width);
        int also_y = folded(top + row, dy, top, p.height);
        if (also_x >= 0) {
            sum += halo[at_y * HALO_W + also_x];
        }
        if (also_y >= 0) {
            sum += halo[also_y * HALO_W + at_x];
        }
        if (also_x >= 0 && also_y >= 0) {
            sum += halo[also_y * HALO_W + also_x];
        }
    }
    return sum;
}

void main() {
    int id = int(gl_LocalInvocationID.x);
    left = int(gl_WorkGroupID.x) * TILE_W;
    top = int(gl_WorkGroupID.y) * TILE_H;
    int blocks = int(WIDTH4 / BLOCK4);
    int frame = int(gl_WorkGroupID.z) / blocks;
    int first = int(gl_WorkGroupID.z) % blocks * int(BLOCK4);
    ivec2 fold_t = fold_targets(p.frames, PAD_T);
    int stages = fold_count(frame, frame, fold_t) * int(DEPTH4);

    float acc[PIXELS][MAX_CHANNELS];
    [[unroll]] for (int c = 0; c < int(BLOCK4) * 4; ++c) {
        [[unroll]] for (int b = 0; b < PIXELS; ++b) {
            acc[b][c] = 0.0;
        }
    }
    int stage = 0;
    do {
        int q = stage % int(DEPTH4);
        ivec2 st = fold_source(stage / int(DEPTH4), frame, frame, frame, p.frames, fold_t);
        if (st.y >= 0) {
            LOAD_HALO(v_y, PLAIN_X, PLAIN_Y, st.y, q)
            LOAD_TAPS(weight_t, (st.x + 1) * 9, q, first)
            barrier();
            ADD_TAPS(acc)
            barrier();
        }
    } while (++stage < stages);
    [[unroll]] for (int b = 0; b < PIXELS; ++b) {
        int column = left + id % TILE_W;
        int row = top + id / TILE_W + 4 * b;
        if (column < p.width && row < p.height) {
            int at = ((frame * p.height + row) * p.width + column) * int(WIDTH4) + first;
            [[unroll]] for (int c = 0; c < int(BLOCK4); ++c) {
                vec4 v = vec4(acc[b][c * 4], acc[b][c * 4 + 1], acc[b][c * 4 + 2], acc[b][c * 4 + 3]);
                if (GATE != 0) {
                    v = mix(v, vec4(0.0), lessThanEqual(gate[at + c], vec4(0.0)));
                }
                v_x[at + c] = v;
            }
        }
    }
}
