#version 460
// image/chroma420_apply: B P A x, where P replaces the second and third component by their mean over the pixel's 2 x 2
// quad.
//   in   x [F,H,W,4], fourth channel ignored   a_*, b_*: rows of A and B
//   out  y [F,H,W,4] (=); fourth channel 0
//   twin kernels/src/reference/image/chroma420.rs   one invocation per pixel; groups: x = H * W, yz = frames
//   A quad at an odd border is the mean of what is there, as after repeating the border. P is symmetric, so that the
//     adjoint is
//   this kernel too, with the transposed maps in the other order.
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params {
    int frames, height, width;
    float a_xx, a_xy, a_xz, a_yx, a_yy, a_yz, a_zx, a_zy, a_zz;
    float b_xx, b_xy, b_xz, b_yx, b_yy, b_yz, b_zx, b_zy, b_zz;
} p;
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

void main() {
    int frame = int(gl_WorkGroupID.y + gl_WorkGroupID.z * gl_NumWorkGroups.y);
    int i = int(gl_GlobalInvocationID.x);
    if (i >= p.height * p.width || frame >= p.frames) return;
    int column = i % p.width / 2 * 2;
    int row = i / p.width / 2 * 2;
    int right = min(column + 1, p.width - 1);
    int below = min(row + 1, p.height - 1);
    int first = frame * p.height * p.width;
    vec3 mean = 0.25 * (texel_load(x, first + row * p.width + column).rgb +
                        texel_load(x, first + row * p.width + right).rgb +
                        texel_load(x, first + below * p.width + column).rgb +
                        texel_load(x, first + below * p.width + right).rgb);
    float luma = dot(vec3(p.a_xx, p.a_xy, p.a_xz), texel_load(x, first + i).rgb);
    vec3 t = vec3(luma, dot(vec3(p.a_yx, p.a_yy, p.a_yz), mean), dot(vec3(p.a_zx, p.a_zy, p.a_zz), mean));
    y[first + i] = vec4(dot(vec3(p.b_xx, p.b_xy, p.b_xz), t), dot(vec3(p.b_yx, p.b_yy, p.b_yz), t),
                        dot(vec3(p.b_zx, p.b_zy, p.b_zz), t), 0.0);
}
