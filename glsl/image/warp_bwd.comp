#version 460
// image/warp_bwd: the exact adjoint of image/warp_fwd, gathered: each input pixel visits the output pixels that can
// have read it.
//   in   v_y [F,H,W,4]
//   out  v_x [F,H,W,4] (=); fourth channel 0
//   twin kernels/src/reference/image/warp.rs   one invocation per input pixel; groups: x = H * W, yz = frames
//   inverse_* map input positions back to output positions; reach_* is how far around there an output pixel can lie.
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint BILINEAR = 1;
layout(push_constant) uniform Params {
    int frames, height, width;
    float xx, xy, x0;
    float yx, yy, y0;
    float inverse_xx, inverse_xy, inverse_x0;
    float inverse_yx, inverse_yy, inverse_y0;
    float reach_x, reach_y;
} p;
#include "lib/affine.glsl"
TEXELS_F32(0, v_y);
layout(set = 0, binding = 1) writeonly buffer VX { vec4 v_x[]; };

void main() {
    int frame = int(gl_WorkGroupID.y + gl_WorkGroupID.z * gl_NumWorkGroups.y);
    int i = int(gl_GlobalInvocationID.x);
    if (i >= p.height * p.width || frame >= p.frames) return;
    vec2 here = vec2(float(i % p.width), float(i / p.width));
    vec2 centre = vec2(p.inverse_xx * here.x + p.inverse_xy * here.y + p.inverse_x0,
                       p.inverse_yx * here.x + p.inverse_yy * here.y + p.inverse_y0);
    vec2 size = vec2(float(p.width), float(p.height));
    vec2 low = clamp(ceil(centre - vec2(p.reach_x, p.reach_y)), vec2(0.0), size);
    vec2 high = clamp(floor(centre + vec2(p.reach_x, p.reach_y)), vec2(-1.0), size - 1.0);
    vec3 sum = vec3(0.0);
    for (float row = low.y; row <= high.y; row++) {
        for (float column = low.x; column <= high.x; column++) {
            vec2 source = warp_source(column, row);
            vec2 near = BILINEAR != 0 ? max(1.0 - abs(source - here), vec2(0.0))
                                      : vec2(equal(floor(source + 0.5), here));
            float weight = near.x * near.y;
            vec3 v = texel_load(v_y, (frame * p.height + int(row)) * p.width + int(column)).rgb;
            sum += mix(vec3(0.0), weight * v, bvec3(weight > 0.0));
        }
    }
    v_x[frame * p.height * p.width + i] = vec4(sum, 0.0);
}
