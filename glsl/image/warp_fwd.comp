#version 460
// image/warp_fwd: samples every frame at affinely mapped positions; what lies outside has the colour `fill`.
//   in   x [F,H,W,4]
//   out  y [F,H,W,4] (=); fourth channel 0
//   twin kernels/src/reference/image/warp.rs   one invocation per output pixel; groups: x = H * W, yz = frames
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint BILINEAR = 1;
layout(push_constant) uniform Params {
    int frames, height, width;
    float xx, xy, x0;
    float yx, yy, y0;
    float fill_r, fill_g, fill_b;
} p;
#include "lib/affine.glsl"
TEXELS_F32(0, x);
layout(set = 0, binding = 1) writeonly buffer Y { vec4 y[]; };

vec3 at(int frame, int column, int row) {
    bool inside = column >= 0 && row >= 0 && column < p.width && row < p.height;
    vec3 colour = texel_load(x, inside ? (frame * p.height + row) * p.width + column : 0).rgb;
    return mix(vec3(p.fill_r, p.fill_g, p.fill_b), colour, bvec3(inside));
}

void main() {
    int frame = int(gl_WorkGroupID.y + gl_WorkGroupID.z * gl_NumWorkGroups.y);
    int i = int(gl_GlobalInvocationID.x);
    if (i >= p.height * p.width || frame >= p.frames) return;
    vec2 source = warp_source(float(i % p.width), float(i / p.width));
    // Far outside everything is fill; whole numbers stay whole numbers.
    source = clamp(source, vec2(-2.0), vec2(float(p.width), float(p.height)) + 1.0);
    vec3 colour;
    if (BILINEAR != 0) {
        vec2 first = floor(source);
        vec2 part = source - first;
        int column = int(first.x);
        int row = int(first.y);
        // A neighbour of no weight has no say, not even by a NaN.
        vec3 zero = vec3(0.0);
        bvec3 right = bvec3(part.x > 0.0);
        bvec3 below = bvec3(part.y > 0.0);
        vec3 top = (1.0 - part.x) * at(frame, column, row) + mix(zero, part.x * at(frame, column + 1, row), right);
        vec3 low = (1.0 - part.x) * at(frame, column, row + 1) +
                   mix(zero, part.x * at(frame, column + 1, row + 1), right);
        colour = (1.0 - part.y) * top + mix(zero, part.y * low, below);
    } else {
        colour = at(frame, int(floor(source.x + 0.5)), int(floor(source.y + 0.5)));
    }
    y[frame * p.height * p.width + i] = vec4(colour, 0.0);
}
