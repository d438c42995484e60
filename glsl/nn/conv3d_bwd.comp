#version 460
// nn/conv3d_bwd: gradient to the input of nn/conv3d_fwd, the exact adjoint of convolution and padding.
//   in   v_y [F,H,W,Co]   weight_t [27,Co/4,Ci,4]   gate [F,H,W,Ci], read with GATE only
//   out  v_x [F,H,W,Ci] (=), with GATE zero where gate <= 0: the derivative of the ReLU that made the input
//   twin kernels/src/reference/nn/conv3d.rs   groups: x = 32-pixel spans, y = rows, z = frame, input block
#extension GL_EXT_control_flow_attributes : require
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
layout(constant_id = 0) const uint DEPTH4 = 4;
layout(constant_id = 1) const uint WIDTH4 = 4;
layout(constant_id = 2) const uint BLOCK4 = 4;
layout(constant_id = 3) const uint PAD_T = 0;
layout(constant_id = 4) const uint PAD_XY = 0;
layout(constant_id = 5) const uint GATE = 0;
layout(push_constant) uniform Params { int frames, height, width; } p;
TEXELS_F32(0, v_y);
TEXELS_F32(1, weight_t);
TEXELS_F32(2, gate);
layout(set = 0, binding = 3) writeonly buffer VX { vec4 v_x[]; };
#define CONV3D_SOURCE(i) texel_load(v_y, i)
#define CONV3D_WEIGHT(i) texel_load(weight_t, i)
#include "lib/conv3d.glsl"
#include "lib/conv3d_block.glsl"

void main() {
    int left = int(gl_WorkGroupID.x * 32);
    int column = left + int(gl_LocalInvocationID.x);
    int row = int(gl_WorkGroupID.y);
    uint blocks = WIDTH4 / BLOCK4;
    int frame = int(gl_WorkGroupID.z / blocks);
    uint first = gl_WorkGroupID.z % blocks * BLOCK4;
    ivec2 fold_t = fold_targets(p.frames, PAD_T);
    ivec2 fold_y = fold_targets(p.height, PAD_XY);
    ivec2 fold_x = fold_targets(p.width, PAD_XY);
    int count_t = fold_count(frame, frame, fold_t);
    int count_y = fold_count(row, row, fold_y);
    int count_x = fold_count(left, left + 31, fold_x);

    float acc[PIXELS][MAX_CHANNELS];
    [[unroll]] for (uint c = 0; c < BLOCK4 * 4; c++) {
        [[unroll]] for (int b = 0; b < PIXELS; b++) acc[b][c] = 0.0;
    }
    ivec3 s = ivec3(0); // pair of each axis, counted up like digits
    do {
        ivec2 st = fold_source(s.z, frame, frame, frame, p.frames, fold_t);
        ivec2 sy = fold_source(s.y, row, row, row, p.height, fold_y);
        int index[PIXELS];
        int dx;
        [[unroll]] for (int b = 0; b < PIXELS; b++) {
            ivec2 sx = fold_source(s.x, column + b * 8, left, left + 31, p.width, fold_x);
            dx = sx.x;
            index[b] = min(min(st.y, sy.y), sx.y) < 0 ? -1 : (st.y * p.height + sy.y) * p.width + sx.y;
        }
        conv3d_tap(acc, index, uint((st.x + 1) * 9 + (sy.x + 1) * 3 + dx + 1), first);
        s.x++;
        s.y += int(s.x == count_x);
        s.x = s.x == count_x ? 0 : s.x;
        s.z += int(s.y == count_y);
        s.y = s.y == count_y ? 0 : s.y;
    } while (s.z < count_t);
    [[unroll]] for (int b = 0; b < PIXELS; b++) {
        if (column + b * 8 < p.width) {
            uint at = uint((frame * p.height + row) * p.width + column + b * 8) * WIDTH4 + first;
            [[unroll]] for (uint c = 0; c < BLOCK4; c++) {
                vec4 v = vec4(acc[b][c * 4], acc[b][c * 4 + 1], acc[b][c * 4 + 2], acc[b][c * 4 + 3]);
                if (GATE != 0) v = mix(v, vec4(0.0), lessThanEqual(texel_load(gate, int(at + c)), vec4(0.0)));
                v_x[at + c] = v;
            }
        }
    }
}
