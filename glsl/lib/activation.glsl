// lib/activation: pointwise activations and their derivatives.
// `kind` must be a (specialisation) constant: then only the chosen branch is left after compilation.
// Codes are those of `Activation::code` in kernels/src/nn/activation.rs.
#include "lib/keep_nan.glsl"

// Normal distribution function; erfc by Abramowitz & Stegun 1964, 7.1.26: absolute error 1.5e-7, none left far below 0.
float normal_cdf(float x) {
    float z = abs(x) * 0.70710678;
    float t = 1.0 / (1.0 + 0.3275911 * z);
    float poly = ((((1.061405429 * t - 1.453152027) * t + 1.421413741) * t - 0.284496736) * t + 0.254829592) * t;
    float tail = 0.5 * poly * exp(-z * z);
    return x < 0.0 ? tail : 1.0 - tail;
}

float activate(uint kind, float x) {
    if (kind == 1u) {
        return keep_nan(x, max(x, 0.0));
    }
    if (kind == 2u) {
        return x / (1.0 + exp(-1.702 * x));
    }
    if (kind == 3u) {
        return x * normal_cdf(x);
    }
    return x;
}

float activate_grad(uint kind, float x) {
    if (kind == 1u) {
        return x > 0.0 || isnan(x) ? 1.0 : 0.0;
    }
    if (kind == 2u) {
        float s = 1.0 / (1.0 + exp(-1.702 * x));
        return s + 1.702 * x * s * (1.0 - s);
    }
    if (kind == 3u) {
        return normal_cdf(x) + x * 0.39894228 * exp(-0.5 * x * x);
    }
    return 1.0;
}

vec4 activate4(uint kind, vec4 x) {
    return vec4(activate(kind, x.x), activate(kind, x.y), activate(kind, x.z), activate(kind, x.w));
}

vec4 activate_grad4(uint kind, vec4 x) {
    return vec4(activate_grad(kind, x.x), activate_grad(kind, x.y), activate_grad(kind, x.z), activate_grad(kind, x.w));
}
