#version 460
// image/crop_fwd: a window of some frames, normalised, with PATCH x PATCH pixels side by side in a cell. One invocation
// per texel of y.
//   in   x [F, full_height, full_width, 4]
//   out  y [., grid_height, grid_width, 4*texels], `total` texels from `y_texel` on (=): (x - mean) / std, fourth
//     channel 0;
//        zero in the border of `padding` pixels, beyond the window, and in texels beyond PATCH * PATCH
//   twin kernels/src/reference/image/crop.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const int PATCH = 1;
layout(push_constant) uniform Params {
    uint total, y_texel;
    int frame, top, left, height, width, full_height, full_width, grid_height, grid_width, texels, padding;
    float mean_r, mean_g, mean_b, std_r, std_g, std_b;
} p;
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    uint i = global_index();
    if (i < p.total) {
        int inner = int(i) % p.texels;
        int cell = int(i) / p.texels;
        int line = cell / p.grid_width;
        int row = line % p.grid_height * PATCH + inner / PATCH - p.padding;
        int column = cell % p.grid_width * PATCH + inner % PATCH - p.padding;
        bool inside = inner < PATCH * PATCH && row >= 0 && row < p.height && column >= 0 && column < p.width;
        int frame = p.frame + line / p.grid_height;
        int at = (frame * p.full_height + p.top + row) * p.full_width + p.left + column;
        vec3 rgb = texel_load(x, inside ? at : -1).rgb;
        vec3 scaled = (rgb - vec3(p.mean_r, p.mean_g, p.mean_b)) / vec3(p.std_r, p.std_g, p.std_b);
        y[p.y_texel + i] = inside ? vec4(scaled, 0.0) : vec4(0.0);
    }
}
