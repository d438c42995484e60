#version 460
// nn/conv3d_bwd_coop: nn/conv3d_bwd by cooperative matrices, operands rounded to f16 with a common scale, sums in f32.
//   in   v_y [F,H,W,Co]   weight_t [27,Co/4,Ci,4]   gate [F,H,W,Ci], read with GATE only
//   out  v_x [F,H,W,Ci] (=), with GATE zero where gate <= 0: the derivative of the ReLU that made the input
//   twin kernels/src/reference/nn/conv3d.rs on rounded operands   groups: x = 32-pixel spans, y = 8 rows, z = frame, 16
//     inputs
//   As conv3d_fwd_coop with the taps of a frame in reverse. What padding read at a border is added where it came from:
//     along
//   frames in more stages, along rows by more products of whole rows, along columns, which are single rows of a matrix,
//     by
//   plain sums: 2 x 8 pixels x 16 channels of 48 products each, 2 % of a tile's, in tiles that have such a column.
//   Operations, bytes and limit as there; 28 KiB shared.
#extension GL_EXT_control_flow_attributes : require
#ifndef INTERFACE_ONLY
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#extension GL_KHR_cooperative_matrix : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_KHR_shader_subgroup_basic : require
#endif

layout(local_size_x = 128) in;
layout(constant_id = 0) const uint TM = 16;
layout(constant_id = 1) const uint TN = 16;
layout(constant_id = 2) const uint TK = 16;
layout(constant_id = 3) const uint SUBGROUPS = 4;
layout(constant_id = 4) const uint DEPTH4 = 4;
layout(constant_id = 5) const uint WIDTH4 = 4;
layout(constant_id = 6) const uint PAD_T = 0;
layout(constant_id = 7) const uint PAD_XY = 0;
layout(constant_id = 8) const uint GATE = 0;
layout(push_constant) uniform Params { int frames, height, width; } p;
layout(set = 0, binding = 0) readonly buffer VY { vec4 v_y[]; };
layout(set = 0, binding = 1) readonly buffer WeightT { vec4 weight_t[]; };
layout(set = 0, binding = 2) readonly buffer Gate { vec4 gate[]; };
layout(set = 0, binding = 3) writeonly buffer VX { vec4 v_x[]; };

#ifdef INTERFACE_ONLY
// For compilers that do not know the extension; names everything that the host binds, and is never run.
void main() {
    uint names = TM + TN + TK + SUBGROUPS + DEPTH4 + WIDTH4 + PAD_T + PAD_XY + GATE;
    v_x[names] = v_y[p.frames] + weight_t[p.height] + gate[p.width];
}
#else
#include "lib/conv3d.glsl"
#include "lib/block_scale.glsl"
#define CONV3D_TAP(oy, ox) ((2 - (oy)) * 3 + 2 - (ox))
#define FOLD_ROWS(acc)                                                                                          \
    [[unroll]] for (uint i = 0; i < 2 * ROWS; ++i) {                                                            \
        if (top + int(first_row + i / 2) == fold_y[i % 2]) {                                                    \
            uint column = ((border_row[i % 2] * HALO_W) + first_column + ox) * STRIDE4 + k4;                    \
            coopmat<float16_t, gl_ScopeSubgroup, TM, TK, gl_MatrixUseA> border;                                 \
            coopMatLoad(border, halo, column, STRIDE4, gl_CooperativeMatrixLayoutRowMajor);                     \
            [[unroll]] for (uint j = 0; j < COLUMN_BLOCKS; ++j) {                                               \
                uint sum = i / 2 * COLUMN_BLOCKS + j;                                                           \
                acc[sum] = coopMatMulAdd(border, right[(2 - i % 2 * 2) * COLUMN_BLOCKS + j], acc[sum]);         \
            }                                                                                                   \
        }                                                                                                       \
    }
ivec2 fold_x;
ivec2 fold_y;
uvec2 border_row;
#include "lib/conv3d_coop.glsl"
const int FOLD = TILE_H * CHANNELS;
shared float folded_columns[2 * FOLD];

#define PLAIN_X(c) ((c) < p.width ? (c) : -1)
#define PLAIN_Y(c) ((c) < p.height ? (c) : -1)

// One position of a pixel in the halo, for one output channel.
float position_sum(int row, int column, int oy, int ox, int channel) {
    int pixel = (row * HALO_W + column) * STRIDE4;
    int weight = ((PACKED ? oy : oy * 3 + ox) * CHANNELS + channel) * STRIDE4;
    if (PACKED) {
        return dot(vec4(halo[pixel]), vec4(taps[weight + ox]));
    }
    float sum = 0.0;
    [[unroll]] for (int part = 0; part < CHANNELS / 4; ++part) {
        sum += dot(vec4(halo[pixel + part]), vec4(taps[weight + part]));
    }
    return sum;
}

// What the border columns add to the columns that padding copied there: row and channel of this invocation.
void add_folded_columns(int id, inout float folded[2]) {
    int row = id / CHANNELS;
    int channel = id % CHANNELS;
    [[unroll]] for (int side = 0; side < 2; ++side) {
        if (fold_x[side] >= left && fold_x[side] < left + TILE_W) {
            int column = side == 0 ? 1 - left : p.width - left;
            int ox = 2 - 2 * side;
            for (int oy = 0; oy < 3; ++oy) {
                folded[side] += position_sum(row + oy, column, oy, ox, channel);
            }
            [[unroll]] for (int end = 0; end < 2; ++end) {
                if (top + row == fold_y[end]) {
                    folded[side] += position_sum(int(border_row[end]), column, 2 - 2 * end, ox, channel);
                }
            }
        }
    }
}

// Stage s of the frames that meet this one; whether there is one.
bool fetch(int id, int s, int frame, int first) {
    ivec2 fold_t = fold_targets(p.frames, PAD_T);
    int pair = s / STAGES_PER_FRAME;
    int texel = s % STAGES_PER_FRAME * (CHANNELS / 4);
    ivec2 st = fold_source(pair, frame, frame, frame, p.frames, fold_t);
    if (pair >= fold_count(frame, frame, fold_t) || st.y < 0) {
        return false;
    }
    FETCH_HALO(v_y, PLAIN_X, PLAIN_Y, st.y, texel)
    FETCH_TAPS(weight_t, (st.x + 1) * 9, texel, first)
    return true;
}

void tell_fetched() {
    uint bits = 0u;
    [[unroll]] for (int f = 0; f < HALO_FETCHES; ++f) {
        bits = max(bits, finite_bits(next_halo[f]));
    }
    tell_block_scale(bits);
}

vec4 folded_texel(int side, int row, int channel) {
    int from = side * FOLD + row * CHANNELS + channel;
    return vec4(folded_columns[from], folded_columns[from + 1], folded_columns[from + 2], folded_columns[from + 3]);
}

// `texels`: the first of the workgroup, and which of its own this matrix starts at.
void store(uint lane, uint patch0, ivec3 pixel, ivec2 texels, float scale) {
    for (uint e = lane; e < TM * TN / 4; e += gl_SubgroupSize) {
        int column = pixel.x + int(e / (TN / 4));
        int texel = texels.y + int(e % (TN / 4));
        if (column < p.width && pixel.y < p.height && texels.x + texel < int(WIDTH4)) {
            vec4 v = patch_texel(patch0 + e * 4);
            [[unroll]] for (int side = 0; side < 2; ++side) {
                if (column == fold_x[side]) {
                    v += folded_texel(side, pixel.y - top, texel * 4);
                }
            }
            v *= unscale(scale);
            int at = ((pixel.z * p.height + pixel.y) * p.width + column) * int(WIDTH4) + texels.x + texel;
            v_x[at] = GATE == 0 ? v : mix(v, vec4(0.0), lessThanEqual(gate[at], vec4(0.0)));
        }
    }
}

void main() {
    int id = int(gl_LocalInvocationID.x);
    left = int(gl_WorkGroupID.x) * TILE_W;
    top = int(gl_WorkGroupID.y) * TILE_H;
    int blocks = (int(WIDTH4) * 4 + CHANNELS - 1) / CHANNELS;
    int frame = int(gl_WorkGroupID.z) / blocks;
    int first = int(gl_WorkGroupID.z) % blocks * (CHANNELS / 4);
    uint first_column = gl_SubgroupID % STRIPS * TM;
    uint first_row = gl_SubgroupID / STRIPS * ROWS;
    fold_x = fold_targets(p.width, PAD_XY);
    fold_y = fold_targets(p.height, PAD_XY);
    border_row = uvec2(1 - top, p.height - top);
    coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator> acc[ROWS * COLUMN_BLOCKS];
    [[unroll]] for (uint i = 0; i < ROWS * COLUMN_BLOCKS; ++i) {
        acc[i] = coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator>(0.0);
    }
    float folded[2] = float[2](0.0, 0.0);
    float scale = 1.0;
    start_block_scale(id);
    barrier();
    int stages = fold_count(frame, frame, fold_targets(p.frames, PAD_T)) * STAGES_PER_FRAME;
    int s = 0;
    bool fetched = fetch(id, 0, frame, first);
    do {
        bool staged = fetched;
        if (staged) {
            tell_fetched();
        }
        barrier();
        float ratio = block_scale() * unscale(scale);
        scale = block_scale();
        [[unroll]] for (uint i = 0; i < ROWS * COLUMN_BLOCKS; ++i) {
            acc[i] *= ratio;
        }
        folded[0] *= ratio;
        folded[1] *= ratio;
        if (staged) {
            stage_operands(id, scale);
        }
        barrier();
        fetched = fetch(id, s + 1, frame, first);
        if (staged) {
            ADD_POSITIONS(acc)
            add_folded_columns(id, folded);
        }
        barrier();
    } while (++s < stages);
    folded_columns[id] = folded[0];
    folded_columns[FOLD + id] = folded[1];
    // The layout of a matrix in registers is the device's secret: the gate and the borders meet it through shared
    // memory.
    uint patch0 = gl_SubgroupID * TM * TN;
    [[unroll]] for (uint i = 0; i < ROWS * COLUMN_BLOCKS; ++i) {
        coopMatStore(acc[i], patch_of_subgroup, patch0, TN, gl_CooperativeMatrixLayoutRowMajor);
        barrier();
        ivec3 pixel = ivec3(left + int(first_column), top + int(first_row + i / COLUMN_BLOCKS), frame);
        store(gl_SubgroupInvocationID, patch0, pixel, ivec2(first, int(i % COLUMN_BLOCKS * TN) / 4), scale);
        barrier();
    }
}
#endif
