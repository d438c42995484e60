#version 460
// loss/l1_step: mean absolute difference of colours and its gradient, 0 at equality.
//   in   image [.,4] and reference [.,4], n pixels from image_px and reference_px on
//   out  v_image [.,4] at image_px (=), or (+=) with ACCUMULATE; fourth channel 0   partial [groups * 8] (=)
//   twin kernels/src/reference/loss/l1.rs   groups: 64 * PIXELS pixels each
#extension GL_KHR_shader_subgroup_shuffle : require
#define TERM(d) abs(d)
#define SLOPE(d) mix(mix(d, vec3(1.0), greaterThan(d, vec3(0.0))), vec3(-1.0), lessThan(d, vec3(0.0)))
#include "lib/loss_pixels.glsl"
