#version 460
// image/crop_bwd: gradient of crop_fwd. One invocation per pixel of the window.
//   in   v_y [., grid_height, grid_width, 4*texels]   v_before: v_x as texels
//   out  v_x [F, full_height, full_width, 4] (+=) inside the window, fourth channel 0 there
//   twin kernels/src/reference/image/crop.rs   pixels outside of every cell get nothing
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const int PATCH = 1;
layout(push_constant) uniform Params {
    uint total;
    int frame, top, left, height, width, full_height, full_width, grid_height, grid_width, texels, padding;
    float std_r, std_g, std_b;
} p;
TEXELS_F32(0, v_y);
TEXELS_F32(1, v_before);
layout(set = 0, binding = 2) writeonly buffer VX { vec4 v_x[]; };

void main() {
    uint i = global_index();
    if (i < p.total) {
        int line = int(i) / p.width;
        int row = line % p.height + p.padding;
        int column = int(i) % p.width + p.padding;
        int frame = line / p.height;
        ivec2 cell = ivec2(column / PATCH, row / PATCH);
        bool inside = cell.x < p.grid_width && cell.y < p.grid_height;
        int inner = row % PATCH * PATCH + column % PATCH;
        int from = ((frame * p.grid_height + cell.y) * p.grid_width + cell.x) * p.texels + inner;
        vec3 v = texel_load(v_y, inside ? from : -1).rgb / vec3(p.std_r, p.std_g, p.std_b);
        int to = ((p.frame + frame) * p.full_height + p.top + line % p.height) * p.full_width + p.left +
                 int(i) % p.width;
        v_x[to] = vec4(texel_load(v_before, to).rgb + v, 0.0);
    }
}
