// Exact culling of 8x8 tiles: whether some point of the tile can be reached.

// What the test needs of one splat.
struct TileTest {
    vec2 mean2d;
    vec3 conic;    // a, b, c of a dx^2 + b dx dy + c dy^2, non-negative, base-2 exponent
    vec2 slope;    // -b / 2c and -b / 2a: where an edge of the tile is nearest
    float reach;   // largest exponent that still counts
};

TileTest tile_test(vec4 shape, vec4 rest) {
    precise vec3 conic = -vec3(shape.zw, rest.x);
    precise vec2 slope = -0.5 * conic.y / vec2(conic.z, conic.x);
    return TileTest(shape.xy, conic, slope, rest.w);
}

// Smallest exponent over the edge point `d`, less what f32 rounding of its terms can amount to.
float tile_edge(TileTest s, vec2 d) {
    precise float xx = s.conic.x * d.x * d.x, xy = s.conic.y * d.x * d.y, yy = s.conic.z * d.y * d.y;
    precise float exponent = xx + xy + yy;
    precise float slack = 1e-6 * (xx + abs(xy) + yy);
    return exponent - slack;
}

// The exponent is convex, so its minimum over the tile is at the mean or on an edge that faces it.
bool tile_reached(TileTest s, uvec2 tile) {
    precise vec2 low = vec2(tile * 8u) - s.mean2d;
    precise vec2 high = low + 7.0;
    precise vec2 near = clamp(vec2(0.0), low, high);
    precise vec2 on_x = vec2(near.x, clamp(s.slope.x * near.x, low.y, high.y));
    precise vec2 on_y = vec2(clamp(s.slope.y * near.y, low.x, high.x), near.y);
    bool beside_x = near.x != 0.0, beside_y = near.y != 0.0;
    bool hit_x = beside_x && tile_edge(s, on_x) <= s.reach;
    bool hit_y = beside_y && tile_edge(s, on_y) <= s.reach;
    return !(beside_x || beside_y) || hit_x || hit_y;
}
