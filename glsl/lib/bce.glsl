// Codes of the objectives on message logits; the host's `Objective` has the same order.
const uint OBJECTIVE_BCE = 0;
const uint OBJECTIVE_MARGIN = 1;
const uint OBJECTIVE_INVERSE = 2;
const uint OBJECTIVE_HINGE = 3;
const uint OBJECTIVE_CHANCE = 4;
const float LN2 = 0.69314718;

// log(1 + e^x) without overflow. Drivers may lose a NaN in max and exp, so both functions hand it on themselves.
float softplus(float x) { return isnan(x) ? x : max(x, 0.0) + log(1.0 + exp(-abs(x))); }

float sigmoid(float x) { return isnan(x) ? x : 1.0 / (1.0 + exp(-x)); }
