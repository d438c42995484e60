// log(1 + e^x) without overflow. Drivers may lose a NaN in max and exp, so both functions hand it on themselves.
float softplus(float x) { return isnan(x) ? x : max(x, 0.0) + log(1.0 + exp(-abs(x))); }

float sigmoid(float x) { return isnan(x) ? x : 1.0 / (1.0 + exp(-x)); }
