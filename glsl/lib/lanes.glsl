// Lane kernels: one workgroup of 8 invocations works on one tile of 8 x 8 pixels, lane = column.
// Shuffles take constants 0..7 only, so they also hold where a subgroup has more lanes.

// Lane l receives the sum over lanes of v[l]: three butterfly rounds, 7 shuffles.
float transposed_sum(float v[8], uint lane) {
    bool b4 = (lane & 4u) != 0u, b2 = (lane & 2u) != 0u, b1 = (lane & 1u) != 0u;
    float h[4], q[2];
    [[unroll]] for (int i = 0; i < 4; ++i)
        h[i] = (b4 ? v[i + 4] : v[i]) + lane_shuffle_xor(b4 ? v[i] : v[i + 4], 4);
    [[unroll]] for (int i = 0; i < 2; ++i)
        q[i] = (b2 ? h[i + 2] : h[i]) + lane_shuffle_xor(b2 ? h[i] : h[i + 2], 2);
    return (b1 ? q[1] : q[0]) + lane_shuffle_xor(b1 ? q[0] : q[1], 1);
}

// Largest value over the 8 lanes.
float lanes_max(float v) {
    v = max(v, lane_shuffle_xor(v, 4));
    v = max(v, lane_shuffle_xor(v, 2));
    return max(v, lane_shuffle_xor(v, 1));
}
