#version 460
// splat/rasterize_bwd_tile: splat/rasterize_bwd for GPUs, dL/d(colour) of each (tile, splat) pair. One workgroup per
// 8x8 tile.
//   in   geom [V,8]   tile_offsets [tiles+1]   tile_order [tiles] active ones first   splat_from_isect, slot_from_isect
//     [I], as in lib/isect.glsl   slot_ranges [V,2] first, end
//        v_image [..,H,W,4] = dL/d(image), 4th channel unread, from pixel `in_offset` on
//   out  v_slots [I,4] = sum over the tile's pixels of weight * v_image (=), at the pair's slot
//   eq   v_colour = sum_p alpha_p T_p v_image_p; geometry and opacity are constants
//   By batches of 16 splats: first an invocation is a pixel and leaves its weights of all splats in shared memory, then
//     it is a splat and a quarter of the tile's pixels and adds them up. No atomics, so the order of every sum is
//     fixed. 6.5 KiB shared: of batches of 32, which take 10.5, a GPU holds too few to hide its waiting.
//   every pair takes all pixels of its tile, with weight 0 where it is skipped: a v_image that is not finite makes
//     those NaN
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 64) in;
layout(constant_id = 0) const uint PACKED = 1;
#include "lib/isect.glsl"
layout(constant_id = 1) const uint PLAIN = 1;
#include "lib/raster.glsl"
#include "lib/blend.glsl"
layout(push_constant) uniform Params {
    uint width, height, tiles_x, num_active, tile_stride, in_offset;
    float min_alpha, max_alpha, span, foot;
    uint behind;
} p;
layout(set = 0, binding = 0) readonly buffer Geom { vec4 geom[]; };
layout(set = 0, binding = 1) readonly buffer VImage { vec4 v_image[]; };
layout(set = 0, binding = 2) readonly buffer SplatFromIsect { uint splat_from_isect[]; };
layout(set = 0, binding = 3) readonly buffer SlotFromIsect { uint slot_from_isect[]; };
layout(set = 0, binding = 4) readonly buffer TileOffsets { uint tile_offsets[]; };
layout(set = 0, binding = 6) readonly buffer TileOrder { uint tile_order[]; };
layout(set = 0, binding = 7) readonly buffer SlotRanges { uint slot_ranges[]; };
layout(set = 0, binding = 5) buffer VSlots { vec4 v_slots[]; };

const uint PIXELS = 64u;
const uint BATCH = 16u;
const uint PARTS = PIXELS / BATCH;
// One more than the pixels, so that the weights of neighbouring splats fall into different banks.
const uint WEIGHT_STRIDE = PIXELS + 1u;
shared vec4 batch_shape[BATCH];
shared vec2 batch_rest[BATCH];
shared float weights[BATCH * WEIGHT_STRIDE];
shared vec4 v_pixel[PIXELS];
shared vec4 sum_of_part[PIXELS];

void main() {
    uint id = gl_LocalInvocationID.x;
    if (workgroup_index() >= p.num_active) return;
    Rules rules = Rules(p.min_alpha, p.max_alpha, p.span, p.foot, p.behind);
    uint tile = tile_order[interleaved(workgroup_index(), p.tile_stride, p.num_active)];
    uint x = (tile % p.tiles_x) * 8u + id % 8u, y = (tile / p.tiles_x) * 8u + id / 8u;
    bool inside = x < p.width && y < p.height;
    uint at = tile_offsets[tile], end = tile_offsets[tile + 1u];
    v_pixel[id] = inside ? vec4(v_image[p.in_offset + y * p.width + x].rgb, 0.0) : vec4(0.0);
    uint splat_of_batch = id % BATCH;
    uint part = id / BATCH;
    float t = 1.0;
    do {
        bool valid = at + splat_of_batch < end;
        if (part == 0u) {
            uint splat = valid ? isect_splat(splat_from_isect[at + id]) : 0u;
            batch_shape[id] = valid ? geom[2u * splat] : vec4(0.0);
            vec4 rest = geom[2u * splat + 1u];
            batch_rest[id] = vec2(rest.x, valid ? log2(rest.y) : NO_SPLAT);
        }
        barrier();
        uint j = 0u;
        do {
            [[unroll]] for (uint u = 0u; u < 8u; ++u) {
                vec4 shape = batch_shape[j + u];
                vec2 rest = batch_rest[j + u];
                float dx = shape.x - float(x);
                float peak = shape.z * dx * dx + rest.y;
                float alpha = splat_alpha(rules, peak, shape.w * dx, rest.x, rest.y, shape.y - float(y));
                weights[(j + u) * WEIGHT_STRIDE + id] = blend_weight(rules, alpha, t);
            }
            j += 8u;
        } while (j < BATCH);
        barrier();
        vec4 sum = vec4(0.0);
        uint first = part * (PIXELS / PARTS);
        uint pixel = 0u;
        do {
            [[unroll]] for (uint u = 0u; u < 8u; ++u) {
                sum += weights[splat_of_batch * WEIGHT_STRIDE + first + pixel + u] * v_pixel[first + pixel + u];
            }
            pixel += 8u;
        } while (pixel < PIXELS / PARTS);
        sum_of_part[id] = sum;
        barrier();
        if (part == 0u && valid) {
            uint word = splat_from_isect[at + id];
            uint slot;
            if (PACKED == 1u) slot = slot_ranges[2u * isect_splat(word)] + isect_place(word);
            else slot = slot_from_isect[at + id];
            [[unroll]] for (uint other = 1u; other < PARTS; ++other) {
                sum += sum_of_part[other * BATCH + id];
            }
            v_slots[slot] = sum;
        }
        at += BATCH;
    } while (at < end);
}
