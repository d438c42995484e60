#version 460
// nn/max_pool_fwd: largest value of each square window, per channel. One invocation per texel of the output.
//   in   x [F, height, width, 4*channels4]
//   out  y [F, out_height, out_width, 4*channels4] (=); NaN where the window has one
//   twin kernels/src/reference/nn/max_pool.rs   windows lie whole inside the image, `stride` pixels apart
#extension GL_EXT_control_flow_attributes : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint SIDE = 2;
layout(constant_id = 1) const uint STRIDE = 2;
layout(push_constant) uniform Params { uint total, height, width, out_height, out_width, channels4; } p;
TEXELS_F32(0, x_tex);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };
#include "lib/max_pool.glsl"

void main() {
    uint i = global_index();
    if (i < p.total) {
        uint cell = i / p.channels4;
        uint line = cell / p.out_width;
        uvec3 window = uvec3(cell % p.out_width, line % p.out_height, line / p.out_height);
        vec4 most;
        uvec4 where;
        largest(window, i % p.channels4, most, where);
        y[i] = most;
    }
}
