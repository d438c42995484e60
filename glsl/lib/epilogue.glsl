// lib/epilogue: what nn/matmul does to four sums s before it stores them. MODE and ACTIVATION are specialisation
// constants of the includer; `other` is what it loads where MODE > 0.
//   MODE 0: act(s)   MODE 1: s + other   MODE 2: s * act'(other)
#include "lib/activation.glsl"

vec4 epilogue(vec4 s, vec4 other) {
    if (MODE == 1u) {
        return s + other;
    }
    if (MODE == 2u) {
        return s * activate_grad4(ACTIVATION, other);
    }
    return activate4(ACTIVATION, s);
}
