#version 460
// nn/conv3d_fwd_coop: nn/conv3d_fwd by cooperative matrices, operands rounded to f16, sums in f32; implicit GEMM.
//   in   x [F,H,W,Ci]   weight [27,Ci/4,Co,4] and, with BIAS, [Co] behind it
//   out  y [F,H,W,Co] (=), max(0, y) with RELU
//   twin kernels/src/reference/nn/conv3d.rs on rounded operands   groups: x = 32-pixel spans, y = 8 rows, z = frame, 16
//     outputs
//   Per workgroup and 16 -> 16 channels: 3.5 million operations; 3 x (21.3 KiB of pixels + 9 KiB of weights) read, 16
//     KiB
//   written: 33 operations a byte of cache, 108 of memory. Matrices of 16 x 16 x 16: 27 loads of 512 bytes from shared
//     memory
//   per 36 products of 8192 operations. So the cache is what should limit it. Four channels take 16 of K for three
//     taps,
//   four outputs a quarter of N. 27 KiB shared.
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
layout(constant_id = 8) const uint BIAS = 0;
layout(constant_id = 9) const uint RELU = 0;
layout(push_constant) uniform Params { int frames, height, width; } p;
layout(set = 0, binding = 0) readonly buffer X { vec4 x[]; };
layout(set = 0, binding = 1) readonly buffer Weight { vec4 weight[]; };
layout(set = 0, binding = 2) writeonly buffer Y { vec4 y[]; };

#ifdef INTERFACE_ONLY
// For compilers that do not know the extension; names everything that the host binds, and is never run.
void main() {
    uint names = TM + TN + TK + SUBGROUPS + DEPTH4 + WIDTH4 + PAD_T + PAD_XY + BIAS + RELU;
    y[names] = x[p.frames] + weight[p.height + p.width];
}
#else
#include "lib/conv3d.glsl"
#include "lib/keep_nan.glsl"
#define CONV3D_TAP(oy, ox) ((oy) * 3 + (ox))
#define FOLD_ROWS(acc)
#include "lib/conv3d_coop.glsl"

// A position that no tap of a pixel inside reads may be any; it must only lie inside, or be left out.
#define PADDED_X(c) ((c) > p.width ? -1 : pad_index(c, p.width, PAD_XY))
#define PADDED_Y(c) ((c) > p.height ? -1 : pad_index(c, p.height, PAD_XY))

// Stage s of those of a frame's neighbours that exist; whether there is one.
bool fetch(int id, int s, int frame, int first) {
    int dt = s / STAGES_PER_FRAME;
    int texel = s % STAGES_PER_FRAME * (CHANNELS / 4);
    int st = dt < 3 ? pad_index(frame + dt - 1, p.frames, PAD_T) : -1;
    if (st < 0) {
        return false;
    }
    FETCH_HALO(x, PADDED_X, PADDED_Y, st, texel)
    FETCH_TAPS(weight, dt * 9, texel, first)
    return true;
}

void store(uint lane, uint patch0, ivec3 pixel, int first) {
    for (uint e = lane; e < TM * TN / 4; e += gl_SubgroupSize) {
        int column = pixel.x + int(e / (TN / 4));
        int texel = first + int(e % (TN / 4));
        if (column < p.width && pixel.y < p.height && texel < int(WIDTH4)) {
            vec4 v = patch_texel(patch0 + e * 4);
            v += BIAS == 0 ? vec4(0.0) : weight[27 * int(DEPTH4 * WIDTH4) * 4 + texel];
            int at = ((pixel.z * p.height + pixel.y) * p.width + column) * int(WIDTH4) + texel;
            y[at] = RELU == 0 ? v : keep_nan(v, max(v, vec4(0.0)));
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
    coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator> acc[ROWS * COLUMN_BLOCKS];
    [[unroll]] for (uint i = 0; i < ROWS * COLUMN_BLOCKS; ++i) {
        acc[i] = coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator>(0.0);
    }
    int s = 0;
    bool fetched = fetch(id, 0, frame, first);
    do {
        bool staged = fetched;
        if (staged) {
            stage_operands(id, 1.0);
        }
        barrier();
        fetched = fetch(id, s + 1, frame, first);
        if (staged) {
            ADD_POSITIONS(acc)
        }
        barrier();
    } while (++s < 3 * STAGES_PER_FRAME);
    // The layout of a matrix in registers is the device's secret: the bias and the borders meet it through shared
    // memory.
    uint patch0 = gl_SubgroupID * TM * TN;
    [[unroll]] for (uint i = 0; i < ROWS * COLUMN_BLOCKS; ++i) {
        coopMatStore(acc[i], patch_of_subgroup, patch0, TN, gl_CooperativeMatrixLayoutRowMajor);
        barrier();
        ivec3 pixel = ivec3(left + int(first_column), top + int(first_row + i / COLUMN_BLOCKS), frame);
        store(gl_SubgroupInvocationID, patch0, pixel, first + int(i % COLUMN_BLOCKS * TN) / 4);
        barrier();
    }
}
#endif
