#version 460
// loss/lpips_step: one tap of LPIPS (Zhang et al. 2018, eq. 1): features of unit length, their squared difference,
// weighted by channel. One invocation per pixel of the tap.
//   in   features, reference [rows, channels], behind a ReLU: of the image, and of what it is compared with   weight
//     [channels]
//        v_before: v_features as texels, read with ACCUMULATE
//   out  v_features [rows, channels] (=), the gradient of the ReLU's input: (v_before + scale * own gradient) where the
//        feature is above 0, else 0
//   out  partial [groups * 8] (=); eight lanes share one
//   twin kernels/src/reference/loss/lpips.rs   a feature x becomes x / (|x| + EPS)
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
layout(constant_id = 0) const uint ACCUMULATE = 0;
layout(constant_id = 1) const float EPS = 1e-10;
layout(push_constant) uniform Params { int rows, channels; float scale; } p;
TEXELS_F32(0, features);
TEXELS_F32(1, weight);
TEXELS_F32(2, v_before);
TEXELS_F32(5, reference);
layout(set = 0, binding = 3) writeonly buffer VFeatures { vec4 v_features[]; };
layout(set = 0, binding = 4) writeonly buffer Partial { float partial[]; };

void main() {
    uint lane = gl_LocalInvocationID.x;
    int row = int(gl_WorkGroupID.x * 64u + lane);
    int texels = p.channels / 4;
    int image = min(row, p.rows - 1) * texels;
    float image_sq = 0.0;
    float reference_sq = 0.0;
    int t = 0;
    do {
        vec4 a = texel_load(features, image + t);
        vec4 b = texel_load(reference, image + t);
        image_sq += dot(a, a);
        reference_sq += dot(b, b);
    } while (++t < texels);
    float norm = sqrt(image_sq);
    float shift = norm + EPS;
    float reference_shift = sqrt(reference_sq) + EPS;
    float value = 0.0;
    float along = 0.0;
    t = 0;
    do {
        vec4 a = texel_load(features, image + t);
        vec4 d = a / shift - texel_load(reference, image + t) / reference_shift;
        vec4 slope = texel_load(weight, t) * d;
        value += dot(slope, d);
        along += dot(slope, a);
    } while (++t < texels);
    // d/dx of x / (|x| + EPS) is (1 - x x^T / (|x| (|x| + EPS))) / (|x| + EPS); a row of zeros is gated below.
    float pull = norm > 0.0 ? along / (norm * shift) : along;
    float scale = 2.0 * p.scale / shift;
    t = 0;
    do {
        vec4 a = texel_load(features, image + t);
        vec4 d = a / shift - texel_load(reference, image + t) / reference_shift;
        vec4 v = scale * (texel_load(weight, t) * d - pull * a);
        if (ACCUMULATE != 0u) v += texel_load(v_before, image + t);
        if (row < p.rows) {
            v_features[image + t] = mix(v, vec4(0.0), lessThanEqual(a, vec4(0.0)));
        }
    } while (++t < texels);
    value = row < p.rows ? value : 0.0;
    value += lane_shuffle_xor(value, 1);
    value += lane_shuffle_xor(value, 2);
    value += lane_shuffle_xor(value, 4);
    if (lane % 8u == 0u) {
        partial[gl_WorkGroupID.x * 8u + lane / 8u] = value;
    }
}
