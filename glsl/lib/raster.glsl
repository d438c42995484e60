// Blending rules of the 3DGS rasteriser (Kerbl et al. 2023), shared by every traversal of a tile.
const float MAX_ALPHA = 0.99;
const float MIN_ALPHA = 1.0 / 255.0;
const float MIN_LOG_ALPHA = log2(MIN_ALPHA);
const float STOP_TRANSMITTANCE = 1e-4;
// log2 of the opacity of a splat that is none.
const float NO_SPLAT = -1e30;

// Opacity of a splat at dy = centre.y - pixel.y, 0 when skipped. The conic carries -log2(e)/2, so peak + dy (bx + c dy)
// is the base-2 logarithm of opacity times falloff, with peak = log_opacity + a dx^2 and bx = b dx.
float splat_alpha(float peak, float bx, float c, float log_opacity, float dy) {
    float log_alpha = peak + dy * (bx + c * dy);
    float alpha = min(MAX_ALPHA, exp2(log_alpha));
    return log_alpha >= MIN_LOG_ALPHA && log_alpha <= log_opacity ? alpha : 0.0;
}

// Weight of the splat in the pixel. A pixel that would fall below the stop threshold stops without
// this splat; the sign bit of `t` then marks it, |t| stays its final transmittance.
float blend_weight(float alpha, inout float t) {
    float weight = alpha * t;
    float next = t - weight;
    bool stop = next < STOP_TRANSMITTANCE;
    t = stop ? uintBitsToFloat(floatBitsToUint(t) | 0x80000000u) : next;
    return stop ? 0.0 : weight;
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
