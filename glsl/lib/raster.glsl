// Blending rules of the 3DGS rasteriser (Kerbl et al. 2023), shared by every traversal of a tile.
const float MAX_ALPHA = 0.99;
const float MIN_ALPHA = 1.0 / 255.0;
const float STOP_TRANSMITTANCE = 1e-4;

// Opacity of a splat at dy = centre.y - pixel.y, 0 when skipped. The conic carries -log2(e)/2, so
// ax + dy (bx + c dy) is the base-2 logarithm of the falloff, with ax = a dx^2 and bx = b dx.
float splat_alpha(float ax, float bx, float c, float opacity, float dy) {
    float falloff = ax + dy * (bx + c * dy);
    float alpha = min(MAX_ALPHA, opacity * exp2(falloff));
    return (falloff > 0.0 || alpha < MIN_ALPHA) ? 0.0 : alpha;
}

// Weight of the splat in the pixel. A pixel that would fall below the stop threshold stops without
// this splat; the sign bit of `t` then marks it, |t| stays its final transmittance.
float blend_weight(float alpha, inout float t) {
    float next = t * (1.0 - alpha);
    bool stop = next < STOP_TRANSMITTANCE;
    float weight = stop ? 0.0 : alpha * t;
    t = stop ? -abs(t) : next;
    return weight;
}

// Index of the workgroup in a dispatch that may spill into y.
uint workgroup_index() {
    return gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x;
}

// A permutation of 0..count: neighbours in time lie apart in the list, so that a static split of the
// grid between workers is even. `stride` is coprime to `count`.
uint interleaved(uint index, uint stride, uint count) {
    return (index * stride) % count;
}
