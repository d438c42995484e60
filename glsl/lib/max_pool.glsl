// lib/max_pool: the largest values of a window and the taps that they are at. The includer declares SIDE, STRIDE,
// `x_tex` and the push constants `p.height, width, channels4`.

// First texel of the pixel (x, y) of an image.
uint pixel_texel(uint x, uint y, uint image) {
    return ((image * p.height + y) * p.width + x) * p.channels4;
}

// Of the window (column, row, image): per component the largest value and the first tap that has it, row by row. As in
// PyTorch a NaN beats every number, and the last of several counts.
void largest(uvec3 window, uint channel, out vec4 most, out uvec4 where) {
    most = vec4(0.0);
    where = uvec4(0);
    [[unroll]] for (uint tap = 0; tap < SIDE * SIDE; ++tap) {
        uvec2 at = window.xy * STRIDE + uvec2(tap % SIDE, tap / SIDE);
        vec4 v = texel_load(x_tex, int(pixel_texel(at.x, at.y, window.z) + channel));
        [[unroll]] for (int q = 0; q < 4; ++q) {
            bool better = tap == 0 || v[q] > most[q] || isnan(v[q]);
            most[q] = better ? v[q] : most[q];
            where[q] = better ? tap : where[q];
        }
    }
}
