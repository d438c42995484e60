// lib/conv3d_coop: 32 x 8 pixels of a frame x 16 output channels by cooperative matrices, held by 128 invocations. A
// stage is one frame tap and 16 source channels: the pixels with their halo and the weights of nine positions lie in
// shared memory as f16, 24 halves apart: a multiple of 16 bytes, as cooperative loads want, and on other banks than the
// neighbour's. A position (oy, ox) is where in the halo a pixel finds its source. Matrix A is TM neighbours of a row at
// one position, so that nothing is copied per tap; with PACKED the three positions of a row lie side by side in place
// of 16 channels. A subgroup owns TM columns and ROWS rows: a row of the halo is loaded once per ox for the three rows
// of pixels it reaches. Includers define CONV3D_TAP(oy, ox), the tap within a frame; and FOLD_ROWS, what else they add
// while `right` is at hand.
const int TILE_W = 32;
const int TILE_H = 8;
const int HALO_W = TILE_W + 2;
const int HALO_H = TILE_H + 2;
const int GROUP = 128;
const int CHANNELS = 16; // of a stage, and of the outputs of a workgroup
const int STRIDE4 = CHANNELS / 4 + 2;
const int HALO_FETCHES = (HALO_W * HALO_H * CHANNELS / 4 + GROUP - 1) / GROUP;
const int TAP_FETCHES = (9 * CHANNELS * CHANNELS / 4 + GROUP - 1) / GROUP;
const int PATCH = 1024; // at least SUBGROUPS * TM * TN, which the host checks
const bool PACKED = DEPTH4 == 1u;
const int STAGES_PER_FRAME = (int(DEPTH4) * 4 + CHANNELS - 1) / CHANNELS;
const uint OFFSETS_X = PACKED ? 1u : 3u;
const uint STRIPS = uint(TILE_W) / TM;
const uint ROWS = uint(TILE_H) / (SUBGROUPS / STRIPS);
const uint COLUMN_BLOCKS = uint(CHANNELS) / TN;
shared f16vec4 halo[HALO_W * HALO_H * STRIDE4];
shared f16vec4 taps[9 * CHANNELS * STRIDE4];
shared float patch_of_subgroup[PATCH];

int left;
int top;
vec4 next_halo[HALO_FETCHES];
vec4 next_taps[TAP_FETCHES];

// Texels from `first_texel` on of frame `st`; `from_x(c)`, `from_y(c)` say which pixel a position reads, -1 = zero.
#define FETCH_HALO(source, from_x, from_y, st, first_texel)                                                     \
    [[unroll]] for (int f = 0; f < HALO_FETCHES; ++f) {                                                         \
        int entry = (id + f * GROUP) / 4;                                                                       \
        int part = id % 4;                                                                                      \
        int texel = PACKED ? 0 : (first_texel) + part;                                                          \
        int sx = from_x(left + entry % HALO_W - 1 + (PACKED ? part : 0));                                       \
        int sy = from_y(top + entry / HALO_W - 1);                                                              \
        bool inside = sx >= 0 && sy >= 0 && entry < HALO_W * HALO_H && (PACKED ? part < 3 : texel < int(DEPTH4)); \
        next_halo[f] = inside ? source[(((st) * p.height + sy) * p.width + sx) * int(DEPTH4) + texel] : vec4(0.0); \
    }

// Weights [27, DEPTH4, WIDTH4 * 4] of the same texels, nine taps from `first_tap` on, outputs from texel `first` on.
#define FETCH_TAPS(source, first_tap, first_texel, first)                                                       \
    [[unroll]] for (int f = 0; f < TAP_FETCHES; ++f) {                                                          \
        int position = (id + f * GROUP) / (4 * CHANNELS);                                                       \
        int channel = (first) * 4 + (id + f * GROUP) / 4 % CHANNELS;                                            \
        int part = id % 4;                                                                                      \
        int texel = PACKED ? 0 : (first_texel) + part;                                                          \
        int tap = (first_tap) + (PACKED ? CONV3D_TAP(position, part) : CONV3D_TAP(position / 3, position % 3)); \
        bool exists = PACKED ? position < 3 && part < 3 : position < 9 && texel < int(DEPTH4);                  \
        next_taps[f] = exists && channel < int(WIDTH4) * 4                                                      \
                           ? source[(tap * int(DEPTH4) + texel) * int(WIDTH4) * 4 + channel]                    \
                           : vec4(0.0);                                                                         \
    }

// What was fetched, pixels times `scale`.
void stage_operands(int id, float scale) {
    [[unroll]] for (int f = 0; f < HALO_FETCHES; ++f) {
        int entry = (id + f * GROUP) / 4;
        if (entry < HALO_W * HALO_H) {
            halo[entry * STRIDE4 + id % 4] = f16vec4(next_halo[f] * scale);
        }
    }
    [[unroll]] for (int f = 0; f < TAP_FETCHES; ++f) {
        int entry = (id + f * GROUP) / 4;
        if (entry < 9 * CHANNELS) {
            taps[entry * STRIDE4 + id % 4] = f16vec4(next_taps[f]);
        }
    }
}

// The loop over steps of K is not unrolled: some drivers take a minute to compile what comes of it.
#define ADD_POSITIONS(acc)                                                                                      \
    {                                                                                                           \
        uint at_step = 0;                                                                                       \
        do {                                                                                                    \
            uint ox = at_step / (uint(CHANNELS) / TK);                                                          \
            uint k4 = at_step % (uint(CHANNELS) / TK) * TK / 4;                                                 \
            coopmat<float16_t, gl_ScopeSubgroup, TK, TN, gl_MatrixUseB> right[3 * COLUMN_BLOCKS];               \
            [[unroll]] for (uint b = 0; b < 3 * COLUMN_BLOCKS; ++b) {                                           \
                uint column = (b / COLUMN_BLOCKS * OFFSETS_X + ox) * uint(CHANNELS) + b % COLUMN_BLOCKS * TN;   \
                coopMatLoad(right[b], taps, column * STRIDE4 + k4, STRIDE4, gl_CooperativeMatrixLayoutColumnMajor); \
            }                                                                                                   \
            [[unroll]] for (uint h = 0; h < ROWS + 2; ++h) {                                                    \
                coopmat<float16_t, gl_ScopeSubgroup, TM, TK, gl_MatrixUseA> row_of_halo;                        \
                uint at = ((first_row + h) * HALO_W + first_column + ox) * STRIDE4 + k4;                        \
                coopMatLoad(row_of_halo, halo, at, STRIDE4, gl_CooperativeMatrixLayoutRowMajor);                \
                [[unroll]] for (uint oy = 0; oy < 3; ++oy) {                                                    \
                    if (h >= oy && h < ROWS + oy) {                                                             \
                        [[unroll]] for (uint j = 0; j < COLUMN_BLOCKS; ++j) {                                   \
                            uint sum = (h - oy) * COLUMN_BLOCKS + j;                                            \
                            acc[sum] = coopMatMulAdd(row_of_halo, right[oy * COLUMN_BLOCKS + j], acc[sum]);     \
                        }                                                                                       \
                    }                                                                                           \
                }                                                                                               \
            }                                                                                                   \
            FOLD_ROWS(acc)                                                                                      \
        } while (++at_step < OFFSETS_X * (uint(CHANNELS) / TK));                                                \
    }

// Four neighbouring sums of the matrix that this subgroup put into its patch.
vec4 patch_texel(uint from) {
    return vec4(patch_of_subgroup[from], patch_of_subgroup[from + 1], patch_of_subgroup[from + 2],
                patch_of_subgroup[from + 3]);
}
