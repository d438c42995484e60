#version 460
// loss/mse_step: mean squared difference of colours and its gradient.
//   in   image [.,4] and reference [.,4], n pixels from image_px and reference_px on
//   out  v_image [.,4] at image_px (=), or (+=) with ACCUMULATE; fourth channel 0   partial [groups * 8] (=)
//   twin kernels/src/reference/loss/mse.rs   groups: 64 * PIXELS pixels each
#extension GL_KHR_shader_subgroup_shuffle : require
#define TERM(d) ((d) * (d))
#define SLOPE(d) (2.0 * (d))
#include "lib/loss_pixels.glsl"
