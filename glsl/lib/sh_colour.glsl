// Colour before the clamp: 1/2 + sum_j y_j h_j; `h` holds h_0.rgb, h_1.rgb, ... in sequence.
vec3 sh_raw_colour(vec4 h[12], float y[16]) {
    vec3 sum = vec3(0.5);
    [[unroll]] for (int j = 0; j < 16; ++j) {
        int f = 3 * j;
        sum += y[j] * vec3(h[f / 4][f % 4], h[(f + 1) / 4][(f + 1) % 4], h[(f + 2) / 4][(f + 2) % 4]);
    }
    return sum;
}

// Texels that hold the coefficients up to `degree`.
uint sh_texels(uint degree) {
    return (3u * (degree + 1u) * (degree + 1u) + 3u) / 4u;
}
