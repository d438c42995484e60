// How a splat meets a pixel. Where PLAIN is 1 by the rules of the 3DGS rasteriser (Kerbl et al. 2023), else by those
// that the dispatch brings.
const float MIN_LOG_ALPHA = log2(MIN_ALPHA);
const float STOP_TRANSMITTANCE = 1e-4;
// log2 of the opacity of a splat that is none.
const float NO_SPLAT = -1e30;

struct Rules {
    float min_alpha, max_alpha;
    float span;      // exponent of base 2 at which falloff ends
    float foot;      // what falloff loses before it is made 1 in the middle again
    uint behind;     // 1: a pixel ends behind the splat that leaves it too little, 0: before it
};

// Opacity of a splat at dy = centre.y - pixel.y, 0 when skipped. The conic carries -log2(e)/2, so peak + dy (bx + c dy)
// is the base-2 logarithm of opacity times falloff, with peak = log_opacity + a dx^2 and bx = b dx.
float splat_alpha(Rules rules, float peak, float bx, float c, float log_opacity, float dy) {
    float log_alpha = peak + dy * (bx + c * dy);
    if (PLAIN == 1u) {
        float alpha = min(MAX_ALPHA, exp2(log_alpha));
        return log_alpha >= MIN_LOG_ALPHA && log_alpha <= log_opacity ? alpha : 0.0;
    }
    float bent = (exp2(log_alpha) - rules.foot * exp2(log_opacity)) / (1.0 - rules.foot);
    float alpha = min(rules.max_alpha, bent);
    bool within = log_alpha <= log_opacity && log_alpha >= log_opacity - rules.span;
    return within && alpha >= rules.min_alpha ? alpha : 0.0;
}

// Weight of the splat in the pixel. A pixel that would fall below the stop threshold stops, without this splat or with
// it; the sign bit of `t` then marks it, |t| stays its final transmittance.
float blend_weight(Rules rules, float alpha, inout float t) {
    bool behind = PLAIN == 0u && rules.behind == 1u;
    float weight = alpha * (behind ? max(t, 0.0) : t);
    float next = t - weight;
    bool stop = next < STOP_TRANSMITTANCE;
    if (behind) {
        t = stop ? uintBitsToFloat(floatBitsToUint(next) | 0x80000000u) : next;
        return weight;
    }
    t = stop ? uintBitsToFloat(floatBitsToUint(t) | 0x80000000u) : next;
    return stop ? 0.0 : weight;
}
