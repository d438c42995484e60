#version 460
// splat/rasterize_bwd: dL/d(colour) of each (tile, splat) pair, the front-to-back traversal of rasterize_fwd.
//   in   geom [V,8]   tile_offsets [tiles+1]   tile_order [tiles] active ones first   splat_from_isect, slot_from_isect
//     [I, padded by 8], as in lib/isect.glsl   slot_ranges [V,2] first, end
//        v_image [..,H,W,4] = dL/d(image), 4th channel unread, from pixel `in_offset` on
//   out  v_slots [I,4] = sum over the tile's pixels of weight * v_image (=), at the pair's slot
//   eq   v_colour = sum_p alpha_p T_p v_image_p; geometry and opacity are constants
//   every pair takes all pixels of its tile, with weight 0 where it is skipped: a v_image that is not finite makes
//     those NaN
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
#include "lib/lanes.glsl"
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
TEXELS_F32(0, geom);
TEXELS_F32(1, v_image);
TEXELS_U32(2, splat_from_isect);
TEXELS_U32(3, slot_from_isect);
TEXELS_U32(4, tile_offsets);
TEXELS_U32(6, tile_order);
TEXELS_U32(7, slot_ranges);
layout(set = 0, binding = 5) buffer VSlots { vec4 v_slots[]; };

void main() {
    uint lane = gl_LocalInvocationID.x;
    if (workgroup_index() >= p.num_active) return;
    Rules rules = Rules(p.min_alpha, p.max_alpha, p.span, p.foot, p.behind);
    uint tile = texel_pick(tile_order, interleaved(workgroup_index(), p.tile_stride, p.num_active));
    uint x = (tile % p.tiles_x) * 8u + lane, y = (tile / p.tiles_x) * 8u;
    float px = float(x), py = float(y);
    uint at = texel_pick(tile_offsets, tile), end = texel_pick(tile_offsets, tile + 1u);
    float t[8];
    vec3 v[8];
    [[unroll]] for (int k = 0; k < 8; ++k) {
        t[k] = 1.0;
        uint row = y + uint(k);
        bool inside = x < p.width && row < p.height;
        vec3 value = texel_load(v_image, int(inside ? p.in_offset + row * p.width + x : p.in_offset)).xyz;
        v[k] = inside ? value : vec3(0.0);
    }
    do {
        uint i = at + lane;
        bool valid = i < end;
        uint word = texel_pick(splat_from_isect, i);
        uint splat = valid ? isect_splat(word) : 0u;
        uint slot;
        if (PACKED == 1u) slot = texel_pick(slot_ranges, 2u * splat) + isect_place(word);
        else slot = texel_pick(slot_from_isect, i);
        vec4 shape = texel_load(geom, int(2u * splat));
        vec4 rest = texel_load(geom, int(2u * splat + 1u));
        float log_opacity = valid ? log2(rest.y) : NO_SPLAT;
        float sr[8], sg[8], sb[8];
        [[unroll]] for (int j = 0; j < 8; ++j) {
            float dx = lane_shuffle(shape.x, j) - px;
            float top = lane_shuffle(shape.y, j) - py;
            float lo = lane_shuffle(log_opacity, j);
            float peak = lane_shuffle(shape.z, j) * dx * dx + lo;
            float bx = lane_shuffle(shape.w, j) * dx;
            float c = lane_shuffle(rest.x, j);
            sr[j] = sg[j] = sb[j] = 0.0;
            [[unroll]] for (int k = 0; k < 8; ++k) {
                float weight = blend_weight(rules, splat_alpha(rules, peak, bx, c, lo, top - float(k)), t[k]);
                sr[j] += weight * v[k].x;
                sg[j] += weight * v[k].y;
                sb[j] += weight * v[k].z;
            }
        }
        float vr = transposed_sum(sr, lane);
        float vg = transposed_sum(sg, lane);
        float vb = transposed_sum(sb, lane);
        if (valid) v_slots[slot] = vec4(vr, vg, vb, 0.0);
        at += 8u;
    } while (at < end);
}
