// Sine and cosine to a few units in the last place for angles up to some thousands: those of a driver may be wrong by
// 2^-11 (Vulkan, "Precision and Operation of SPIR-V Instructions"). NaN and infinities give NaN.

// pi/2 in three parts (Cody & Waite 1980): the first has 8 bits and the second 11, so that thousands of quadrants times
// each are exact.
const float QUARTER_HIGH = 1.5703125;
const float QUARTER_MIDDLE = 4.8375129699707031e-4;
const float QUARTER_LOW = 7.5497899487686342e-8;

// (sin, cos) of `angle`.
vec2 sin_cos(float angle) {
    float quadrants = floor(angle * 0.63661977 + 0.5);
    precise float r = ((angle - quadrants * QUARTER_HIGH) - quadrants * QUARTER_MIDDLE) - quadrants * QUARTER_LOW;
    // Taylor series: what follows their last terms is below 2e-9 up to |r| = pi/4.
    float s = r * r;
    float sine = r + r * s * (-1.6666667e-1 + s * (8.3333333e-3 + s * (-1.9841270e-4 + s * 2.7557319e-6)));
    float cosine = 1.0 + s * (-0.5 + s * (4.1666667e-2 + s * (-1.3888889e-3 + s * 2.4801587e-5)));
    float quadrant = quadrants - 4.0 * floor(quadrants * 0.25);
    bool swap = quadrant == 1.0 || quadrant == 3.0;
    vec2 pair = swap ? vec2(cosine, sine) : vec2(sine, cosine);
    return vec2(quadrant >= 2.0 ? -pair.x : pair.x, quadrant == 1.0 || quadrant == 2.0 ? -pair.y : pair.y);
}
