#version 460
// loss/pixel_step: sums of absolute and of squared differences of colours, and the gradient of both; |0| has slope 0.
//   in   image [.,4] and reference [.,4], n pixels from image_px and reference_px on   v_before: v_image as texels
//   out  v_image [.,4] at image_px (=), or (+=) with ACCUMULATE; fourth channel 0; not touched without GRADIENT
//   out  partial [2, groups * 8] (=): squares, absolute values; eight lanes share one
//   twin kernels/src/reference/loss/pixel.rs   groups: 64 * PIXELS pixels each
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
layout(constant_id = 0) const uint ACCUMULATE = 0;
layout(constant_id = 1) const uint PIXELS = 16;
layout(constant_id = 2) const uint GRADIENT = 1;
layout(push_constant) uniform Params { uint n, image_px, reference_px; float square_scale, absolute_scale; } p;
TEXELS_F32(0, image);
TEXELS_F32(1, reference);
TEXELS_F32(2, v_before);
layout(set = 0, binding = 3) writeonly buffer VImage { vec4 v_image[]; };
layout(set = 0, binding = 4) writeonly buffer Partial { float partial[]; };

// -1, 0 or 1; NaN stays.
vec3 slope(vec3 d) {
    return mix(mix(d, vec3(1.0), greaterThan(d, vec3(0.0))), vec3(-1.0), lessThan(d, vec3(0.0)));
}

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint i = gl_WorkGroupID.x * 64 * PIXELS + lane;
    uint end = min(p.n, (gl_WorkGroupID.x + 1) * 64 * PIXELS);
    vec3 squares = vec3(0.0);
    vec3 absolutes = vec3(0.0);
    uint left = PIXELS;
    do {
        if (i < end) {
            vec3 d = texel_load(image, int(p.image_px + i)).rgb - texel_load(reference, int(p.reference_px + i)).rgb;
            squares += d * d;
            absolutes += abs(d);
            if (GRADIENT != 0) {
                vec3 v = p.square_scale * (2.0 * d) + p.absolute_scale * slope(d);
                if (ACCUMULATE != 0) v += texel_load(v_before, int(p.image_px + i)).rgb;
                v_image[p.image_px + i] = vec4(v, 0.0);
            }
        }
        i += 64;
        left--;
    } while (left > 0);
    vec2 total = vec2(squares.r + squares.g + squares.b, absolutes.r + absolutes.g + absolutes.b);
    total += lane_shuffle_xor(total, 1);
    total += lane_shuffle_xor(total, 2);
    total += lane_shuffle_xor(total, 4);
    uint at = gl_WorkGroupID.x * 8 + lane / 8;
    if (lane % 8 == 0) {
        partial[at] = total.x;
        partial[gl_NumWorkGroups.x * 8 + at] = total.y;
    }
}
