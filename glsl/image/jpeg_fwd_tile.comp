#version 460
// image/jpeg_fwd_tile: image/jpeg_fwd for GPUs. One workgroup per 16 x 16 pixels, whose six blocks lie in 1.5 KiB of
// shared memory; an invocation transforms a line of eight at a time.
//   in   x [F,H,W,4] in [0, 1]   quant [2, 64]: quantisation steps of luma, then of chroma, row by row
//   out  y [F,H,W,4] (=), neither clamped nor rounded; fourth channel 0
//   twin kernels/src/reference/image/jpeg.rs   groups: x = blocks of a frame, yz = frames
layout(local_size_x = 64) in;
#include "lib/dct8.glsl"
layout(push_constant) uniform Params {
    int frames, height, width;
    float a_xx, a_xy, a_xz, a_yx, a_yy, a_yz, a_zx, a_zy, a_zz;
    float b_xx, b_xy, b_xz, b_yx, b_yy, b_yz, b_zx, b_zy, b_zz;
} p;
layout(set = 0, binding = 0) readonly buffer X { vec4 x[]; };
layout(set = 0, binding = 1) readonly buffer Quant { float quant[]; };
layout(set = 0, binding = 2) writeonly buffer Y { vec4 y[]; };

const float LEVELS = 255.0;
const float LEVEL_SHIFT = 128.0;
const int LUMA = 4;
const int BLOCKS = 6;

// Four blocks of luma, one of blue, one of red.
shared float blocks[BLOCKS * 64];

void load_line(out float line[8], int first, int stride) {
    for (int i = 0; i < 8; i++) line[i] = blocks[first + i * stride];
}

void store_line(float line[8], int first, int stride) {
    for (int i = 0; i < 8; i++) blocks[first + i * stride] = line[i];
}

// DCT, rounding to multiples of the steps, and back.
void lose(int id) {
    bool has_line = id < BLOCKS * 8;
    int block = id / 8, k = id % 8;
    int row = block * 64 + k * 8, column = block * 64 + k, steps = block < LUMA ? k : 64 + k;
    float line[8];
    if (has_line) {
        load_line(line, row, 1);
        dct8(line);
        store_line(line, row, 1);
    }
    barrier();
    if (has_line) {
        load_line(line, column, 8);
        dct8(line);
        for (int i = 0; i < 8; i++) {
            float step = quant[steps + i * 8];
            float magnitude = floor(abs(line[i]) / step + 0.5) * step;
            line[i] = line[i] < 0.0 ? -magnitude : magnitude;
        }
        dct8_inverse(line);
        store_line(line, column, 8);
    }
    barrier();
    if (has_line) {
        load_line(line, row, 1);
        dct8_inverse(line);
        store_line(line, row, 1);
    }
    barrier();
}

// The colour at a place of the frame; beyond its border the last pixel's.
vec3 colour_at(int first, int row, int column) {
    return x[first + min(row, p.height - 1) * p.width + min(column, p.width - 1)].rgb;
}

void main() {
    int frame = int(gl_WorkGroupID.y + gl_WorkGroupID.z * gl_NumWorkGroups.y);
    int across = (p.width + 15) / 16;
    int unit = int(gl_WorkGroupID.x), id = int(gl_LocalInvocationID.x);
    if (unit >= across * ((p.height + 15) / 16) || frame >= p.frames) return;
    int left = unit % across * 16;
    int top = unit / across * 16;
    int first = frame * p.height * p.width;

    vec3 sum = vec3(0.0);
    for (int q = 0; q < 4; q++) sum += colour_at(first, top + id / 8 * 2 + q / 2, left + id % 8 * 2 + q % 2);
    blocks[LUMA * 64 + id] = LEVELS / 4.0 * dot(vec3(p.a_yx, p.a_yy, p.a_yz), sum);
    blocks[(LUMA + 1) * 64 + id] = LEVELS / 4.0 * dot(vec3(p.a_zx, p.a_zy, p.a_zz), sum);
    for (int q = 0; q < LUMA; q++) {
        vec3 colour = colour_at(first, top + q / 2 * 8 + id / 8, left + q % 2 * 8 + id % 8);
        blocks[q * 64 + id] = LEVELS * dot(vec3(p.a_xx, p.a_xy, p.a_xz), colour) - LEVEL_SHIFT;
    }
    barrier();
    lose(id);
    for (int q = 0; q < LUMA; q++) {
        int within_x = q % 2 * 8 + id % 8, within_y = q / 2 * 8 + id / 8;
        int chroma = within_y / 2 * 8 + within_x / 2;
        vec3 t = vec3(blocks[q * 64 + id] + LEVEL_SHIFT, blocks[LUMA * 64 + chroma], blocks[(LUMA + 1) * 64 + chroma]);
        t /= LEVELS;
        vec3 colour = vec3(dot(vec3(p.b_xx, p.b_xy, p.b_xz), t), dot(vec3(p.b_yx, p.b_yy, p.b_yz), t),
                           dot(vec3(p.b_zx, p.b_zy, p.b_zz), t));
        int column = left + within_x, row = top + within_y;
        if (column < p.width && row < p.height) y[first + row * p.width + column] = vec4(colour, 0.0);
    }
}
