#version 460
// nn/matmul_fwd_coop: nn/matmul_fwd by cooperative matrices, operands rounded to f16, sums in f32. One workgroup per 64
// x 64 tile.
//   in   a [m, k]   w in f16, packed by nn/pack [n/8][k/4][8] uvec2   bias [n]   aux [m, n], read if MODE > 0
//   out  c [m, n] (=), epilogue(f16(A)*W^T + bias)
//   twin kernels/src/reference/nn/matmul.rs on rounded operands   the device orders the sums over one panel's k, not
//     the panels
//   Panels of 32 k lie in shared memory, rows 40 halves apart: a multiple of 16 bytes, as cooperative loads want, and
//     off the
//   banks of the row before. Each of SUBGROUPS subgroups owns a block of the tile's TM x TN matrices; ROW_BLOCKS of
//     them lie
//   below each other. The next panel is fetched before this one is multiplied. 14 KiB shared.
//   SCALED = 1: A is a gradient, and rounded with a scale that the tile's panels have in common.
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
layout(constant_id = 4) const uint ROW_BLOCKS = 2;
layout(constant_id = 5) const uint MODE = 0;
layout(constant_id = 6) const uint ACTIVATION = 0;
layout(constant_id = 7) const uint SCALED = 0;
layout(push_constant) uniform Params { int m; int n; int k; } p;
layout(set = 0, binding = 0) readonly buffer A { vec4 a[]; };
layout(set = 0, binding = 1) readonly buffer W { uvec2 w[]; };
layout(set = 0, binding = 2) readonly buffer Bias { vec4 bias[]; };
layout(set = 0, binding = 3) readonly buffer Aux { vec4 aux[]; };
layout(set = 0, binding = 4) writeonly buffer C { vec4 c[]; };

#ifdef INTERFACE_ONLY
// For compilers that do not know the extension; names everything that the host binds, and is never run.
void main() {
    uint names = TM + TN + TK + SUBGROUPS + ROW_BLOCKS + MODE + ACTIVATION + SCALED;
    c[names] = a[p.m] + vec4(w[p.n], w[p.k]) + bias[0] + aux[0];
}
#else
#include "lib/block_scale.glsl"
#include "lib/epilogue.glsl"

const int TILE = 64;
const int GROUP = 128;
const int DEPTH = 32;
const int DEPTH4 = DEPTH / 4;
const int STRIDE4 = DEPTH4 + 2;
const int FETCHES = TILE * DEPTH4 / GROUP;
const int PATCH = 1024; // at least SUBGROUPS * TM * TN, which the host checks
const uint DOWN = uint(TILE) / TM / ROW_BLOCKS;
const uint ACROSS = uint(TILE) / TN / (SUBGROUPS / ROW_BLOCKS);
shared f16vec4 panel_left[TILE * STRIDE4];
shared f16vec4 panel_right[TILE * STRIDE4];
shared float patch_of_subgroup[PATCH];

float scale = 1.0;
vec4 next_left[FETCHES];
uvec2 next_right[FETCHES];

// Rows of A by texels, and W in the order in which it is packed; zero outside.
void fetch(int id, int row0, int column0, int texel0) {
    int k4 = p.k / 4;
    [[unroll]] for (int q = 0; q < FETCHES; ++q) {
        int i = id + q * GROUP;
        int row = row0 + i / DEPTH4;
        int texel = texel0 + i % DEPTH4;
        next_left[q] = row < p.m && texel < k4 ? a[row * k4 + texel] : vec4(0.0);
        int column = column0 + i / (8 * DEPTH4) * 8 + i % 8;
        texel = texel0 + i / 8 % DEPTH4;
        next_right[q] = column < p.n && texel < k4 ? w[((column / 8) * k4 + texel) * 8 + column % 8] : uvec2(0u);
    }
}

void tell_fetched() {
    uint bits = 0u;
    [[unroll]] for (int q = 0; q < FETCHES; ++q) {
        bits = max(bits, finite_bits(next_left[q]));
    }
    tell_block_scale(bits);
}

void stage(int id) {
    [[unroll]] for (int q = 0; q < FETCHES; ++q) {
        int i = id + q * GROUP;
        panel_left[i / DEPTH4 * STRIDE4 + i % DEPTH4] = f16vec4(next_left[q] * scale);
        panel_right[(i / (8 * DEPTH4) * 8 + i % 8) * STRIDE4 + i / 8 % DEPTH4] =
            f16vec4(unpackFloat2x16(next_right[q].x), unpackFloat2x16(next_right[q].y));
    }
}

void store(uint lane, uint patch0, int row0, int column0) {
    for (uint e = lane; e < TM * TN / 4; e += gl_SubgroupSize) {
        int row = row0 + int(e / (TN / 4));
        int column = column0 + int(e % (TN / 4)) * 4;
        if (row < p.m && column < p.n) {
            uint from = patch0 + e * 4;
            vec4 s = vec4(patch_of_subgroup[from], patch_of_subgroup[from + 1], patch_of_subgroup[from + 2],
                          patch_of_subgroup[from + 3]);
            int at = (row * p.n + column) / 4;
            c[at] = epilogue(s * unscale(scale) + bias[column / 4], MODE > 0u ? aux[at] : vec4(0.0));
        }
    }
}

void main() {
    int id = int(gl_LocalInvocationID.x);
    int row0 = int(gl_WorkGroupID.x) * TILE;
    int column0 = int(gl_WorkGroupID.y) * TILE;
    uint first_row = gl_SubgroupID % ROW_BLOCKS * DOWN * TM;
    uint first_column = gl_SubgroupID / ROW_BLOCKS * ACROSS * TN;
    coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator> acc[DOWN * ACROSS];
    [[unroll]] for (uint i = 0; i < DOWN * ACROSS; ++i) {
        acc[i] = coopmat<float, gl_ScopeSubgroup, TM, TN, gl_MatrixUseAccumulator>(0.0);
    }
    int texel = 0;
    fetch(id, row0, column0, 0);
    if (SCALED > 0u) {
        start_block_scale(id);
        barrier();
        tell_fetched();
        barrier();
        scale = block_scale();
    }
    do {
        stage(id);
        barrier();
        texel += DEPTH4;
        fetch(id, row0, column0, texel);
        [[unroll]] for (uint k = 0; k < uint(DEPTH); k += TK) {
            coopmat<float16_t, gl_ScopeSubgroup, TK, TN, gl_MatrixUseB> right[ACROSS];
            [[unroll]] for (uint j = 0; j < ACROSS; ++j) {
                uint at = (first_column + j * TN) * STRIDE4 + k / 4;
                coopMatLoad(right[j], panel_right, at, STRIDE4, gl_CooperativeMatrixLayoutColumnMajor);
            }
            [[unroll]] for (uint i = 0; i < DOWN; ++i) {
                coopmat<float16_t, gl_ScopeSubgroup, TM, TK, gl_MatrixUseA> left;
                uint at = (first_row + i * TM) * STRIDE4 + k / 4;
                coopMatLoad(left, panel_left, at, STRIDE4, gl_CooperativeMatrixLayoutRowMajor);
                [[unroll]] for (uint j = 0; j < ACROSS; ++j) {
                    acc[i * ACROSS + j] = coopMatMulAdd(left, right[j], acc[i * ACROSS + j]);
                }
            }
        }
        if (SCALED > 0u) {
            tell_fetched();
        }
        barrier();
        if (SCALED > 0u) {
            float ratio = block_scale() * unscale(scale);
            scale = block_scale();
            [[unroll]] for (uint i = 0; i < DOWN * ACROSS; ++i) {
                acc[i] *= ratio;
            }
        }
    } while (texel < p.k / 4);
    // The layout of a matrix in registers is the device's secret: the epilogue meets it through shared memory.
    uint patch0 = gl_SubgroupID * TM * TN;
    [[unroll]] for (uint i = 0; i < DOWN * ACROSS; ++i) {
        coopMatStore(acc[i], patch_of_subgroup, patch0, TN, gl_CooperativeMatrixLayoutRowMajor);
        barrier();
        store(gl_SubgroupInvocationID, patch0, row0 + int(first_row + i / ACROSS * TM),
              column0 + int(first_column + i % ACROSS * TN));
        barrier();
    }
}
#endif
