#version 460
// image/jpeg_fwd: what a JPEG file with 4:2:0 chroma keeps of a frame, entropy coding left out: it loses nothing.
//   in   x [F,H,W,4] in [0, 1]   quant [2, 64]: quantisation steps of luma, then of chroma, row by row, as texels
//   out  y [F,H,W,4] (=), neither clamped nor rounded; fourth channel 0
//   twin kernels/src/reference/image/jpeg.rs   one invocation per 16 x 16 pixels; groups: x = blocks of a frame, yz =
//     frames
//   a_*, b_*: rows of the map to luma and two chroma, and of the way back. Borders repeat the last pixel. Chroma is
//     averaged over
//   2 x 2 pixels and repeated. Per block 64 KiB of loads at most and 3,072 products: the loads are the limit.
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/dct8.glsl"
layout(push_constant) uniform Params {
    int frames, height, width;
    float a_xx, a_xy, a_xz, a_yx, a_yy, a_yz, a_zx, a_zy, a_zz;
    float b_xx, b_xy, b_xz, b_yx, b_yy, b_yz, b_zx, b_zy, b_zz;
} p;
TEXELS_F32(0, x);
TEXELS_F32(1, quant);
layout(set = 0, binding = 2) writeonly buffer Y { vec4 y[]; };

const float LEVELS = 255.0;
const float LEVEL_SHIFT = 128.0;

float block[64];

// DCT, rounding to multiples of the steps in texels from `table` on, and back.
void lose(int table) {
    int k = 0;
    do {
        float line[8];
        for (int i = 0; i < 8; i++) line[i] = block[k * 8 + i];
        dct8(line);
        for (int i = 0; i < 8; i++) block[k * 8 + i] = line[i];
        k++;
    } while (k < 8);
    k = 0;
    do {
        float line[8];
        for (int i = 0; i < 8; i++) line[i] = block[i * 8 + k];
        dct8(line);
        for (int i = 0; i < 8; i++) {
            float step = pick(texel_load(quant, table + i * 2 + k / 4), uint(k));
            float magnitude = floor(abs(line[i]) / step + 0.5) * step;
            line[i] = line[i] < 0.0 ? -magnitude : magnitude;
        }
        dct8_inverse(line);
        for (int i = 0; i < 8; i++) block[i * 8 + k] = line[i];
        k++;
    } while (k < 8);
    k = 0;
    do {
        float line[8];
        for (int i = 0; i < 8; i++) line[i] = block[k * 8 + i];
        dct8_inverse(line);
        for (int i = 0; i < 8; i++) block[k * 8 + i] = line[i];
        k++;
    } while (k < 8);
}

void main() {
    int frame = int(gl_WorkGroupID.y + gl_WorkGroupID.z * gl_NumWorkGroups.y);
    int across = (p.width + 15) / 16;
    int i = int(gl_GlobalInvocationID.x);
    if (i >= across * ((p.height + 15) / 16) || frame >= p.frames) return;
    int left = i % across * 16;
    int top = i / across * 16;
    int first = frame * p.height * p.width;

    float blue[64];
    float red[64];
    int k = 0;
    do {
        vec3 sum = vec3(0.0);
        for (int q = 0; q < 4; q++) {
            int column = min(left + k % 8 * 2 + q % 2, p.width - 1);
            int row = min(top + k / 8 * 2 + q / 2, p.height - 1);
            sum += texel_load(x, first + row * p.width + column).rgb;
        }
        blue[k] = LEVELS / 4.0 * dot(vec3(p.a_yx, p.a_yy, p.a_yz), sum);
        red[k] = LEVELS / 4.0 * dot(vec3(p.a_zx, p.a_zy, p.a_zz), sum);
        k++;
    } while (k < 64);
    for (k = 0; k < 64; k++) block[k] = blue[k];
    lose(16);
    for (k = 0; k < 64; k++) blue[k] = block[k];
    for (k = 0; k < 64; k++) block[k] = red[k];
    lose(16);
    for (k = 0; k < 64; k++) red[k] = block[k];

    int quarter = 0;
    do {
        int x0 = quarter % 2 * 8;
        int y0 = quarter / 2 * 8;
        for (k = 0; k < 64; k++) {
            int column = min(left + x0 + k % 8, p.width - 1);
            int row = min(top + y0 + k / 8, p.height - 1);
            block[k] = LEVELS * dot(vec3(p.a_xx, p.a_xy, p.a_xz), texel_load(x, first + row * p.width + column).rgb) -
                       LEVEL_SHIFT;
        }
        lose(0);
        for (k = 0; k < 64; k++) {
            int column = left + x0 + k % 8;
            int row = top + y0 + k / 8;
            int chroma = (y0 + k / 8) / 2 * 8 + (x0 + k % 8) / 2;
            vec3 t = vec3(block[k] + LEVEL_SHIFT, blue[chroma], red[chroma]) / LEVELS;
            vec3 colour = vec3(dot(vec3(p.b_xx, p.b_xy, p.b_xz), t), dot(vec3(p.b_yx, p.b_yy, p.b_yz), t),
                               dot(vec3(p.b_zx, p.b_zy, p.b_zz), t));
            if (column < p.width && row < p.height) y[first + row * p.width + column] = vec4(colour, 0.0);
        }
        quarter++;
    } while (quarter < 4);
}
