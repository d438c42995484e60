// lib/chacha8: a block of sixteen words of the stream cipher ChaCha with eight rounds (Bernstein 2008), with a counter
// of 64 bits, of which the high half and the nonce are 0.
#define CHACHA_QUARTER(a, b, c, d) \
    a += b; d ^= a; d = d << 16 | d >> 16; \
    c += d; b ^= c; b = b << 12 | b >> 20; \
    a += b; d ^= a; d = d << 8 | d >> 24; \
    c += d; b ^= c; b = b << 7 | b >> 25;

// Rows of the state: a constant, the key's halves, and the counter. Columns are mixed, then diagonals. The rows that
// come out hold the block's words in order.
void chacha8(uvec4 first, uvec4 second, uint block, out uvec4 a, out uvec4 b, out uvec4 c, out uvec4 d) {
    const uvec4 constant = uvec4(0x61707865u, 0x3320646eu, 0x79622d32u, 0x6b206574u);
    a = constant; b = first; c = second; d = uvec4(block, 0u, 0u, 0u);
    int round = 0;
    do {
        CHACHA_QUARTER(a, b, c, d)
        b = b.yzwx; c = c.zwxy; d = d.wxyz;
        CHACHA_QUARTER(a, b, c, d)
        b = b.wxyz; c = c.zwxy; d = d.yzwx;
    } while (++round < 4);
    a += constant; b += first; c += second; d.x += block;
}
