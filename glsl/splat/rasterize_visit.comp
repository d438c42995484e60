#version 460
// splat/rasterize_visit: which (tile, splat) pairs reach a pixel that has not stopped, for pruning a plan.
//   in   geom [N,8]   tile_offsets [tiles+1]   tile_order [tiles] active ones first   slot_from_isect [I, padded by 8]
//     splat_from_slot [I]
//   out  kept_isect, kept_slot [I] = 1 when some pixel of the tile takes alpha > 0 or stops there, else 0 (=)
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
#include "lib/lanes.glsl"
layout(constant_id = 0) const uint PLAIN = 1;
#include "lib/raster.glsl"
#include "lib/blend.glsl"
layout(push_constant) uniform Params {
    uint width, height, tiles_x, num_active, tile_stride;
    float min_alpha, max_alpha, span, foot;
    uint behind;
} p;
TEXELS_F32(0, geom);
TEXELS_U32(1, slot_from_isect);
TEXELS_U32(2, splat_from_slot);
TEXELS_U32(3, tile_offsets);
TEXELS_U32(6, tile_order);
layout(set = 0, binding = 4) buffer KeptIsect { uint kept_isect[]; };
layout(set = 0, binding = 5) buffer KeptSlot { uint kept_slot[]; };

void main() {
    uint lane = gl_LocalInvocationID.x;
    if (workgroup_index() >= p.num_active) return;
    Rules rules = Rules(p.min_alpha, p.max_alpha, p.span, p.foot, p.behind);
    uint tile = texel_pick(tile_order, interleaved(workgroup_index(), p.tile_stride, p.num_active));
    uint x = (tile % p.tiles_x) * 8u + lane, y = (tile / p.tiles_x) * 8u;
    float px = float(x), py = float(y);
    uint at = texel_pick(tile_offsets, tile), end = texel_pick(tile_offsets, tile + 1u);
    float t[8];
    [[unroll]] for (int k = 0; k < 8; ++k) {
        // A pixel outside the image starts stopped.
        t[k] = x < p.width && y + uint(k) < p.height ? 1.0 : -1.0;
    }
    do {
        uint i = at + lane;
        bool valid = i < end;
        uint slot = texel_pick(slot_from_isect, i);
        slot = valid ? slot : 0u;
        uint splat = texel_pick(splat_from_slot, slot);
        vec4 shape = texel_load(geom, int(2u * splat));
        vec4 rest = texel_load(geom, int(2u * splat + 1u));
        float log_opacity = valid ? log2(rest.y) : NO_SPLAT;
        float hits[8];
        [[unroll]] for (int j = 0; j < 8; ++j) {
            float dx = lane_shuffle(shape.x, j) - px;
            float top = lane_shuffle(shape.y, j) - py;
            float lo = lane_shuffle(log_opacity, j);
            float peak = lane_shuffle(shape.z, j) * dx * dx + lo;
            float bx = lane_shuffle(shape.w, j) * dx;
            float c = lane_shuffle(rest.x, j);
            hits[j] = 0.0;
            [[unroll]] for (int k = 0; k < 8; ++k) {
                float alpha = splat_alpha(rules, peak, bx, c, lo, top - float(k));
                hits[j] += alpha > 0.0 && t[k] > 0.0 ? 1.0 : 0.0;
                blend_weight(rules, alpha, t[k]);
            }
        }
        uint kept = transposed_sum(hits, lane) > 0.0 ? 1u : 0u;
        if (valid) {
            kept_isect[i] = kept;
            kept_slot[slot] = kept;
        }
        at += 8u;
    } while (at < end);
}
