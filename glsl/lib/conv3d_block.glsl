// Adds one tap to the register block. The includer defines CONV3D_SOURCE(i) and CONV3D_WEIGHT(i).
//   index  source pixel of each of the lane's pixels, -1 = zero
//   tap    0..27; weights are [27, DEPTH4, WIDTH4 * 4] texels over four source channels
void conv3d_tap(inout float acc[PIXELS][MAX_CHANNELS], int index[PIXELS], uint tap, uint first) {
    const uint fetches = (BLOCK4 * 4 + 7) / 8;
    uint lane = gl_LocalInvocationID.x;
    uint q = 0;
    uint row = tap * DEPTH4 * WIDTH4 * 4 + first * 4;
    do {
        vec4 w[fetches];
        [[unroll]] for (uint j = 0; j < fetches; j++) {
            w[j] = CONV3D_WEIGHT(int(row + min(j * 8 + lane, BLOCK4 * 4 - 1)));
        }
        vec4 a[PIXELS];
        [[unroll]] for (int b = 0; b < PIXELS; b++) {
            vec4 texel = CONV3D_SOURCE(max(index[b], 0) * int(DEPTH4) + int(q));
            a[b] = mix(vec4(0.0), texel, bvec4(index[b] >= 0));
        }
        [[unroll]] for (uint c = 0; c < BLOCK4 * 4; c++) {
            vec4 wc = lane_shuffle(w[c / 8], c % 8);
            [[unroll]] for (int b = 0; b < PIXELS; b++) {
                acc[b][c] += a[b].x * wc.x;
                acc[b][c] += a[b].y * wc.y;
                acc[b][c] += a[b].z * wc.z;
                acc[b][c] += a[b].w * wc.w;
            }
        }
        row += WIDTH4 * 4;
        q++;
    } while (q < DEPTH4);
}
