// The padding of 3-tap axes and the register block of 3x3x3 convolutions, shared by both directions.
// One subgroup of 8 lanes owns 32 consecutive pixels of a row (4 per lane) x BLOCK4 output texels.
const uint PAD_ZERO = 0;
const uint PAD_REPLICATE = 1;
const uint PAD_REFLECT = 2;
const int PIXELS = 4;
const int MAX_CHANNELS = 16; // of one block; a narrower BLOCK4 leaves the rest unused

// Index that coordinate c (one step outside at most) reads on an axis of n entries; -1 = zero.
int pad_index(int c, int n, uint padding) {
    int inside = padding == PAD_REFLECT ? (c < 0 ? -c : (c >= n ? 2 * n - 2 - c : c)) : clamp(c, 0, n - 1);
    return padding == PAD_ZERO && inside != c ? -1 : inside;
}

// Coordinates next to the border that receive what the padding read: below and above.
ivec2 fold_targets(int n, uint padding) {
    if (padding == PAD_ZERO) return ivec2(-1);
    return padding == PAD_REFLECT ? ivec2(1, n - 2) : ivec2(0, n - 1);
}

// Number of (tap, source) pairs of the adjoint for coordinates lo..=hi of one axis: three taps, and
// one more for each fold target among them.
int fold_count(int lo, int hi, ivec2 targets) {
    return 3 + int(targets.x >= lo && targets.x <= hi) + int(targets.y >= lo && targets.y <= hi);
}

// Pair s of the adjoint: tap -1..=1 in x; in y the entry read for coordinate c, -1 = none.
ivec2 fold_source(int s, int c, int lo, int hi, int n, ivec2 targets) {
    bool below = s == 3 && targets.x >= lo && targets.x <= hi;
    ivec2 fold = below ? ivec2(-1, c == targets.x ? 0 : -1) : ivec2(1, c == targets.y ? n - 1 : -1);
    int plain = c - (s - 1);
    return s < 3 ? ivec2(s - 1, plain >= 0 && plain < n ? plain : -1) : fold;
}
