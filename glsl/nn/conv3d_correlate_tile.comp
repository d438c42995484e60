#version 460
// nn/conv3d_correlate_tile: nn/conv3d_correlate for GPUs, one partial sum per chunk of tiles of 32 x 4 pixels.
//   in   x [F,H,W,Ci]   v_y [F,H,W,Co]
//   out  partial [chunks, 27*(Ci/4)*Co, 4] (=) in weight order, with BIAS Co more behind each
//   twin kernels/src/reference/nn/conv3d.rs   groups: x = chunk, y = frame tap, z = input texel, output block
//   An invocation owns the 4 x 4 weights of one of nine taps and one output texel; 128/(9*OUT_BLOCK4) of them share
//     these
//   and every so many pixels, and are added in a fixed order. Per pixel: two vec4 from shared memory, 16 multiply-adds.
#extension GL_EXT_control_flow_attributes : require
layout(local_size_x = 128) in;
layout(constant_id = 0) const uint IN4 = 4;
layout(constant_id = 1) const uint OUT4 = 4;
layout(constant_id = 2) const uint OUT_BLOCK4 = 4;
layout(constant_id = 3) const uint PAD_T = 0;
layout(constant_id = 4) const uint PAD_XY = 0;
layout(constant_id = 5) const uint BIAS = 0;
layout(push_constant) uniform Params { int frames, height, width, chunk_tiles; } p;
layout(set = 0, binding = 0) readonly buffer X { vec4 x[]; };
layout(set = 0, binding = 1) readonly buffer VY { vec4 v_y[]; };
layout(set = 0, binding = 2) writeonly buffer Partial { vec4 partial[]; };
#include "lib/conv3d.glsl"

const int TILE_W = 32;
const int TILE_H = 4;
const int HALO_W = TILE_W + 2;
const int HALO_H = TILE_H + 2;
const int GROUP = 128;
const int OWNERS = 9 * int(OUT_BLOCK4);
const int SHARES = GROUP / OWNERS;
shared vec4 halo[HALO_W * HALO_H];
shared vec4 gradient[TILE_W * TILE_H * MAX_CHANNELS / 4]; // and at the end the sums of each invocation

// Pixels of a span of the tile whose tap d lies inside the axis, or anywhere where padding gives it a source.
ivec2 reading(int first, int span, int n, int d) {
    int end = min(span, n - first);
    if (PAD_XY != PAD_ZERO) {
        return ivec2(0, end);
    }
    return ivec2(max(0, 1 - d - first), min(end, n + 1 - d - first));
}

void main() {
    int id = int(gl_LocalInvocationID.x);
    int dt = int(gl_WorkGroupID.y);
    int blocks = int(OUT4 / OUT_BLOCK4);
    int in_texel = int(gl_WorkGroupID.z) / blocks;
    int out_first = int(gl_WorkGroupID.z) % blocks * int(OUT_BLOCK4);
    int owner = id % OWNERS;
    int share = id / OWNERS;
    int tap = owner / int(OUT_BLOCK4);
    int out_texel = owner % int(OUT_BLOCK4);
    int dx = tap % 3;
    int dy = tap / 3;
    int tiles_x = (p.width + TILE_W - 1) / TILE_W;
    int tiles_y = (p.height + TILE_H - 1) / TILE_H;
    vec4 acc[4] = vec4[4](vec4(0.0), vec4(0.0), vec4(0.0), vec4(0.0));
    vec4 bias = vec4(0.0);
    int tile = int(gl_WorkGroupID.x) * p.chunk_tiles;
    int end = min(tile + p.chunk_tiles, p.frames * tiles_x * tiles_y);
    do {
        int frame = tile / (tiles_x * tiles_y);
        int left = tile % tiles_x * TILE_W;
        int top = tile / tiles_x % tiles_y * TILE_H;
        int st = pad_index(frame + dt - 1, p.frames, PAD_T);
        for (int i = id; i < HALO_W * HALO_H; i += GROUP) {
            int sx = pad_index(min(left + i % HALO_W - 1, p.width), p.width, PAD_XY);
            int sy = pad_index(min(top + i / HALO_W - 1, p.height), p.height, PAD_XY);
            bool outside = st < 0 || sy < 0 || sx < 0;
            halo[i] = outside ? vec4(0.0) : x[((st * p.height + sy) * p.width + sx) * int(IN4) + in_texel];
        }
        for (int i = id; i < TILE_W * TILE_H * int(OUT_BLOCK4); i += GROUP) {
            int column = left + i / int(OUT_BLOCK4) % TILE_W;
            int row = top + i / int(OUT_BLOCK4) / TILE_W;
            int at = ((frame * p.height + row) * p.width + column) * int(OUT4) + out_first + i % int(OUT_BLOCK4);
            gradient[i] = column < p.width && row < p.height ? v_y[at] : vec4(0.0);
        }
        barrier();
        // Pixels without a source are left out, not multiplied by zero: their gradient may be NaN.
        ivec2 rows = reading(top, TILE_H, p.height, dy);
        ivec2 columns = reading(left, TILE_W, p.width, dx);
        int row_end = st < 0 || share >= SHARES ? 0 : rows.y;
        for (int row = rows.x; row < row_end; ++row) {
            for (int column = columns.x + share; column < columns.y; column += SHARES) {
                vec4 a = halo[(row + dy) * HALO_W + column + dx];
                vec4 g = gradient[(row * TILE_W + column) * int(OUT_BLOCK4) + out_texel];
                [[unroll]] for (int c = 0; c < 4; ++c) {
                    acc[c] += a * g[c];
                }
                bias += g;
            }
        }
        barrier();
    } while (++tile < end);

    uint texels = 27 * IN4 * OUT4 * 4;
    uint base = gl_WorkGroupID.x * (texels + (BIAS != 0 ? OUT4 : 0));
    uint at = base + ((uint(dt * 9 + tap) * IN4 + uint(in_texel)) * OUT4 + uint(out_first + out_texel)) * 4;
    [[unroll]] for (int c = 0; c < 5; ++c) {
        gradient[id] = c < 4 ? acc[min(c, 3)] : bias;
        barrier();
        vec4 sum = vec4(0.0);
        for (int s = 0; s < SHARES; ++s) {
            sum += gradient[owner + s * OWNERS];
        }
        // The tap in the middle meets every pixel, so its gradients add up to that of the bias.
        bool writes_bias = BIAS != 0 && dt == 1 && tap == 4 && in_texel == 0;
        if (share == 0 && c < 4) {
            partial[at + c] = sum;
        }
        if (share == 0 && c == 4 && writes_bias) {
            partial[base + texels + out_first + out_texel] = sum;
        }
        barrier();
    }
}
