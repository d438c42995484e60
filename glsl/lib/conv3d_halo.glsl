// lib/conv3d_halo: 32 x 16 pixels of a frame x 4*BLOCK4 channels, held by 128 invocations: pixels (id%32, id/32 + 4b)
// each. One texel of every pixel, its halo, and the weights of nine taps go through 12 KiB of shared memory at a time;
// per tap an invocation reads PIXELS + 4*BLOCK4 vec4 and does 16*PIXELS*BLOCK4 multiply-adds. Includers define
// CONV3D_GATHER(column, row, dx, dy): the texel that a pixel of the tile meets at a tap.
const int TILE_W = 32;
const int TILE_H = 16;
const int HALO_W = TILE_W + 2;
const int HALO_H = TILE_H + 2;
const int GROUP = 128;
shared vec4 halo[HALO_W * HALO_H];
shared vec4 taps[9 * MAX_CHANNELS];

// Texel q of pixels around the tile in frame `st`; `from_x(c)`, `from_y(c)` say which pixel a position reads, -1 =
// zero.
#define LOAD_HALO(source, from_x, from_y, st, q)                                                  \
    for (int i = id; i < HALO_W * HALO_H; i += GROUP) {                                           \
        int sx = from_x(left + i % HALO_W - 1);                                                   \
        int sy = from_y(top + i / HALO_W - 1);                                                    \
        halo[i] = sx < 0 || sy < 0 ? vec4(0.0)                                                    \
                                   : source[(((st) * p.height + sy) * p.width + sx) * int(DEPTH4) + (q)]; \
    }

// Weights [27, DEPTH4, WIDTH4 * 4] of one texel of source channels, nine taps from `first_tap` on.
#define LOAD_TAPS(source, first_tap, q, first)                                                    \
    for (int i = id; i < 9 * int(BLOCK4) * 4; i += GROUP) {                                       \
        int tap = (first_tap) + i / (int(BLOCK4) * 4);                                            \
        int channel = i % (int(BLOCK4) * 4);                                                      \
        taps[i] = source[((tap * int(DEPTH4) + (q)) * int(WIDTH4) + (first)) * 4 + channel];      \
    }

#define ADD_TAPS(acc)                                                                             \
    {                                                                                             \
        int dy = 0;                                                                               \
        do {                                                                                      \
            [[unroll]] for (int dx = 0; dx < 3; ++dx) {                                           \
                vec4 pixel[PIXELS];                                                               \
                [[unroll]] for (int b = 0; b < PIXELS; ++b) {                                     \
                    pixel[b] = CONV3D_GATHER(id % TILE_W, id / TILE_W + 4 * b, dx, dy);           \
                }                                                                                 \
                [[unroll]] for (int c = 0; c < int(BLOCK4) * 4; ++c) {                            \
                    vec4 w = taps[(dy * 3 + dx) * int(BLOCK4) * 4 + c];                           \
                    [[unroll]] for (int b = 0; b < PIXELS; ++b) {                                 \
                        [[unroll]] for (int i = 0; i < 4; ++i) {                                  \
                            acc[b][c] += pixel[b][i] * w[i];                                      \
                        }                                                                         \
                    }                                                                             \
                }                                                                                 \
            }                                                                                     \
        } while (++dy < 3);                                                                       \
    }
