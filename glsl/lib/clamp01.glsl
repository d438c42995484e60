// Clamp to [0, 1] that keeps NaN, and its derivative: 1 inside and at both ends, 0 outside and for NaN.
#include "lib/keep_nan.glsl"

vec3 clamp01(vec3 v) {
    return keep_nan(v, clamp(v, vec3(0.0), vec3(1.0)));
}

vec3 clamp01_gate(vec3 v, vec3 v_clamped) {
    bvec3 low = greaterThanEqual(v, vec3(0.0));
    bvec3 high = lessThanEqual(v, vec3(1.0));
    return mix(vec3(0.0), mix(vec3(0.0), v_clamped, low), high);
}
