// lib/windows: the square windows of images [F, height, width, 4*channels4] as rows of a matrix
// [F*out_height*out_width, k]. A row runs over taps, row by row, and within a tap over channels; what lies in the
// border of `padding` pixels is zero. The includer's push constants are `p.height, width, out_height, out_width,
// channels4, taps, padding`.

// Index of a texel outside of every image, and still outside with the number of a channel added.
const int OUTSIDE = -1048576;

// Column, row and image of a window's first pixel.
ivec3 window_corner(int row) {
    int line = row / p.out_width;
    return ivec3(row % p.out_width - p.padding, line % p.out_height - p.padding, line / p.out_height);
}

// First texel of the pixel at one tap of a window.
int window_texel(ivec3 corner, ivec2 tap) {
    int x = corner.x + tap.x;
    int y = corner.y + tap.y;
    bool inside = x >= 0 && x < p.width && y >= 0 && y < p.height;
    return inside ? ((corner.z * p.height + y) * p.width + x) * p.channels4 : OUTSIDE;
}
