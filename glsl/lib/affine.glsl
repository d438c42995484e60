// Where the warps of image/warp_* sample: the input position, in pixels from the centre of the first, of output pixel
// (column, row).
vec2 warp_source(float column, float row) {
    return vec2(p.xx * column + p.xy * row + p.x0, p.yx * column + p.yy * row + p.y0);
}
