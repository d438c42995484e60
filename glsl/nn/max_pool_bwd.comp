#version 460
// nn/max_pool_bwd: gradient of max_pool_fwd; a window's gradient goes to its largest value. One invocation per texel of
// x.
//   in   x [F, height, width, 4*channels4], frames beyond those of v_y are not read   v_y [F, out_height, out_width,
//     4*channels4]
//   out  v_x [F, height, width, 4*channels4] (=), zero where no window's largest value is
//   twin kernels/src/reference/nn/max_pool.rs   the windows over a pixel are visited in order: no atomics
#extension GL_EXT_control_flow_attributes : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint SIDE = 2;
layout(constant_id = 1) const uint STRIDE = 2;
layout(push_constant) uniform Params { uint total, height, width, out_height, out_width, channels4; } p;
TEXELS_F32(0, x_tex);
TEXELS_F32(1, v_y_tex);
layout(set = 0, binding = 2) writeonly buffer VX { vec4 v_x[]; };
#include "lib/max_pool.glsl"

// Windows that a pixel lies in, along one axis.
const uint REACH = (SIDE + STRIDE - 1) / STRIDE;

void main() {
    uint i = global_index();
    if (i < p.total) {
        uint pixel = i / p.channels4;
        uint line = pixel / p.width;
        uvec3 own = uvec3(pixel % p.width, line % p.height, line / p.height);
        uint channel = i % p.channels4;
        vec4 sum = vec4(0.0);
        [[unroll]] for (uint back = 0; back < REACH * REACH; ++back) {
            // Counted back from the last window that begins at or before the pixel; what wraps around is no window.
            uvec2 window = own.xy / STRIDE - uvec2(REACH - 1) + uvec2(back % REACH, back / REACH);
            uvec2 tap = own.xy - window * STRIDE;
            if (window.x < p.out_width && window.y < p.out_height && tap.x < SIDE && tap.y < SIDE) {
                vec4 most;
                uvec4 where;
                largest(uvec3(window, own.z), channel, most, where);
                uint cell = (own.z * p.out_height + window.y) * p.out_width + window.x;
                vec4 v = texel_load(v_y_tex, int(cell * p.channels4 + channel));
                sum += mix(vec4(0.0), v, equal(where, uvec4(tap.y * SIDE + tap.x)));
            }
        }
        v_x[i] = sum;
    }
}
