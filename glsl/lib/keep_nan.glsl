// lib/keep_nan: `bounded` where `v` is a number, and else the NaN. A comparison does not do that: compilers for GPUs
// turn `v < 0 ? 0 : v` into max(), which drops a NaN (seen on NVIDIA 580), unless isnan() asks for it.
float keep_nan(float v, float bounded) {
    return isnan(v) ? v : bounded;
}

vec3 keep_nan(vec3 v, vec3 bounded) {
    return mix(bounded, v, isnan(v));
}

vec4 keep_nan(vec4 v, vec4 bounded) {
    return mix(bounded, v, isnan(v));
}
