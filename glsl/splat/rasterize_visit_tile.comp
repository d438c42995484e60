#version 460
// splat/rasterize_visit_tile: splat/rasterize_visit for GPUs. One workgroup per 8x8 tile, one invocation per pixel.
//   in   geom [N,8]   tile_offsets [tiles+1]   tile_order [tiles] active ones first   slot_from_isect [I]
//     splat_from_slot [I]
//   out  kept_isect, kept_slot [I] = 1 when some pixel of the tile takes alpha > 0 or stops there, else 0 (=)
//   Splats come in batches of 64 through 2.25 KiB of shared memory.
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 64) in;
layout(constant_id = 0) const uint PLAIN = 1;
#include "lib/raster.glsl"
#include "lib/blend.glsl"
layout(push_constant) uniform Params {
    uint width, height, tiles_x, num_active, tile_stride;
    float min_alpha, max_alpha, span, foot;
    uint behind;
} p;
layout(set = 0, binding = 0) readonly buffer Geom { vec4 geom[]; };
layout(set = 0, binding = 1) readonly buffer SlotFromIsect { uint slot_from_isect[]; };
layout(set = 0, binding = 2) readonly buffer SplatFromSlot { uint splat_from_slot[]; };
layout(set = 0, binding = 3) readonly buffer TileOffsets { uint tile_offsets[]; };
layout(set = 0, binding = 6) readonly buffer TileOrder { uint tile_order[]; };
layout(set = 0, binding = 4) buffer KeptIsect { uint kept_isect[]; };
layout(set = 0, binding = 5) buffer KeptSlot { uint kept_slot[]; };

const uint BATCH = 64u;
shared vec4 batch_shape[BATCH];
shared vec2 batch_rest[BATCH];
shared uint batch_kept[BATCH];

void main() {
    uint id = gl_LocalInvocationID.x;
    if (workgroup_index() >= p.num_active) return;
    Rules rules = Rules(p.min_alpha, p.max_alpha, p.span, p.foot, p.behind);
    uint tile = tile_order[interleaved(workgroup_index(), p.tile_stride, p.num_active)];
    uint x = (tile % p.tiles_x) * 8u + id % 8u, y = (tile / p.tiles_x) * 8u + id / 8u;
    uint at = tile_offsets[tile], end = tile_offsets[tile + 1u];
    // A pixel outside the image starts stopped.
    float t = x < p.width && y < p.height ? 1.0 : -1.0;
    do {
        bool valid = at + id < end;
        uint slot = valid ? slot_from_isect[at + id] : 0u;
        uint splat = splat_from_slot[slot];
        batch_shape[id] = valid ? geom[2u * splat] : vec4(0.0);
        vec4 rest = geom[2u * splat + 1u];
        batch_rest[id] = vec2(rest.x, valid ? log2(rest.y) : NO_SPLAT);
        batch_kept[id] = 0u;
        barrier();
        uint j = 0u;
        do {
            [[unroll]] for (uint u = 0u; u < 8u; ++u) {
                vec4 shape = batch_shape[j + u];
                vec2 rest = batch_rest[j + u];
                float dx = shape.x - float(x);
                float peak = shape.z * dx * dx + rest.y;
                float alpha = splat_alpha(rules, peak, shape.w * dx, rest.x, rest.y, shape.y - float(y));
                if (t > 0.0 && alpha > 0.0) atomicOr(batch_kept[j + u], 1u);
                blend_weight(rules, alpha, t);
            }
            j += 8u;
        } while (j < min(BATCH, end - at));
        barrier();
        if (valid) {
            kept_isect[at + id] = batch_kept[id];
            kept_slot[slot] = batch_kept[id];
        }
        at += BATCH;
    } while (at < end);
}
