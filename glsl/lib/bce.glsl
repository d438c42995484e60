#include "lib/sigmoid.glsl"
// Codes of the objectives on message logits; the host's `Objective` has the same order.
const uint OBJECTIVE_BCE = 0;
const uint OBJECTIVE_MARGIN = 1;
const uint OBJECTIVE_INVERSE = 2;
const uint OBJECTIVE_HINGE = 3;
const uint OBJECTIVE_CHANCE = 4;
const float LN2 = 0.69314718;
