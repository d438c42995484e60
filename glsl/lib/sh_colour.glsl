// Bases up to `degree`.
uint sh_bases(uint degree) {
    return (degree + 1u) * (degree + 1u);
}

// Texels that hold their coefficients.
uint sh_texels(uint degree) {
    return (3u * sh_bases(degree) + 3u) / 4u;
}

// Colour before the clamp: 1/2 + sum_j y_j h_j up to `degree`; `h` holds h_0.rgb, h_1.rgb, ... in sequence.
vec3 sh_raw_colour(vec4 h[12], float y[16], uint degree) {
    vec3 sum = vec3(0.5);
    [[unroll]] for (int j = 0; j < 16; ++j) {
        int f = 3 * j;
        vec3 coefficient = vec3(h[f / 4][f % 4], h[(f + 1) / 4][(f + 1) % 4], h[(f + 2) / 4][(f + 2) % 4]);
        // 0 times NaN is NaN: what lies above the degree is left out, not multiplied by zero.
        if (j < int(sh_bases(degree))) sum += y[j] * coefficient;
    }
    return sum;
}

// `v` where the colour before the clamp lets it pass: not below zero, as in Kerbl et al. 2023. NaN passes, so that it
// shows.
vec3 sh_unclamped(vec3 raw, vec3 v) {
    vec3 above = mix(v, vec3(0.0), lessThan(raw, vec3(0.0)));
    return mix(above, v, isnan(raw));
}

// Colour from what it is before the clamp, at most `most`.
vec3 sh_clamped(vec3 raw, float most) {
    return sh_unclamped(raw, mix(raw, vec3(most), greaterThan(raw, vec3(most))));
}

// Gradient of the colour before the clamp from that of the colour.
vec3 sh_v_raw(vec3 raw, vec3 v, float most) {
    return sh_unclamped(raw, mix(v, vec3(0.0), greaterThan(raw, vec3(most))));
}
