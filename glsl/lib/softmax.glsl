// lib/softmax: base-2 exponentials of scores, as the attention kernels over tiles and cooperative matrices take them.
const float LOG2_E = 1.44269504;
const float MASKED = -1.0e30; // the score of a pair that does not count

// exp2 that hands on a NaN, which drivers may lose.
float exp2_or_nan(float x) {
    return isnan(x) ? x : exp2(x);
}

vec4 exp2_or_nan(vec4 x) {
    return mix(exp2(x), x, isnan(x));
}
