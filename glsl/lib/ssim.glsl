// The separable 11-tap window of SSIM with zero padding; G0 is the weight of the centre, G5 of both ends.
layout(constant_id = 0) const float G0 = 1.0;
layout(constant_id = 1) const float G1 = 0.0;
layout(constant_id = 2) const float G2 = 0.0;
layout(constant_id = 3) const float G3 = 0.0;
layout(constant_id = 4) const float G4 = 0.0;
layout(constant_id = 5) const float G5 = 0.0;
// Outputs per invocation along the window; they need RUN + 10 inputs.
layout(constant_id = 6) const int RUN = 8;

// Output r of a run from its inputs v[RUN + 10]; a macro, because of the array's size.
#define window(v, r) \
    (G0 * v[(r) + 5] + G1 * (v[(r) + 4] + v[(r) + 6]) + G2 * (v[(r) + 3] + v[(r) + 7]) \
     + G3 * (v[(r) + 2] + v[(r) + 8]) + G4 * (v[(r) + 1] + v[(r) + 9]) + G5 * (v[r] + v[(r) + 10]))
