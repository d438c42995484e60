#version 460
// image/colour_map_apply: M x at every pixel; with M transposed the gradient to x. One invocation per pixel.
//   in   x [n,4], fourth channel ignored
//   out  y [n,4] (=); fourth channel 0
//   twin kernels/src/reference/image/colour_map.rs
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params {
    uint n;
    float rr, rg, rb;
    float gr, gg, gb;
    float br, bg, bb;
} p;
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec3 c = texel_load(x, int(i)).rgb;
    y[i] = vec4(dot(vec3(p.rr, p.rg, p.rb), c), dot(vec3(p.gr, p.gg, p.gb), c), dot(vec3(p.br, p.bg, p.bb), c), 0.0);
}
