#version 460
// splat/rasterize_fwd_tile: splat/rasterize_fwd for GPUs. One workgroup per 8x8 tile, one invocation per pixel.
//   in   geom [V,8] = mean2d.xy, conic.ab | conic.c, opacity, depth, -   colours [V,4]   tile_offsets [tiles+1]
//     tile_order [tiles] active ones first
//        splat_from_isect [I] front to back inside a tile, as in lib/isect.glsl
//   out  image [..,H,W,4] = rgb over the background, final transmittance (=), from pixel `out_offset` on
//   Splats come in batches of 64 through 2.5 KiB of shared memory; a tile ends with the batch in which its last pixel
//     stops.
//   a splat meets all pixels of its tiles, with weight 0 where it is skipped: a colour that is not finite makes those
//     NaN
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 64) in;
layout(constant_id = 0) const uint PACKED = 1;
#include "lib/isect.glsl"
layout(constant_id = 1) const uint PLAIN = 1;
#include "lib/raster.glsl"
#include "lib/blend.glsl"
layout(push_constant) uniform Params {
    uint width, height, tiles_x, num_active, tile_stride, out_offset;
    float background_r, background_g, background_b;
    float min_alpha, max_alpha, span, foot;
    uint behind;
} p;
layout(set = 0, binding = 0) readonly buffer Geom { vec4 geom[]; };
layout(set = 0, binding = 1) readonly buffer Colours { vec4 colours[]; };
layout(set = 0, binding = 2) readonly buffer SplatFromIsect { uint splat_from_isect[]; };
layout(set = 0, binding = 3) readonly buffer TileOffsets { uint tile_offsets[]; };
layout(set = 0, binding = 5) readonly buffer TileOrder { uint tile_order[]; };
layout(set = 0, binding = 4) buffer Image { vec4 image[]; };

const uint BATCH = 64u;
shared vec4 batch_shape[BATCH];
shared vec2 batch_rest[BATCH];
shared vec4 batch_colour[BATCH];
shared uint live;

void main() {
    uint id = gl_LocalInvocationID.x;
    if (workgroup_index() >= p.num_active) return;
    Rules rules = Rules(p.min_alpha, p.max_alpha, p.span, p.foot, p.behind);
    uint tile = tile_order[interleaved(workgroup_index(), p.tile_stride, p.num_active)];
    uint x = (tile % p.tiles_x) * 8u + id % 8u, y = (tile / p.tiles_x) * 8u + id / 8u;
    bool inside = x < p.width && y < p.height;
    uint at = tile_offsets[tile], end = tile_offsets[tile + 1u];
    // A pixel outside the image starts stopped.
    float t = inside ? 1.0 : -1.0;
    vec3 sum = vec3(0.0);
    do {
        bool valid = at + id < end;
        uint splat = valid ? isect_splat(splat_from_isect[at + id]) : 0u;
        batch_shape[id] = valid ? geom[2u * splat] : vec4(0.0);
        vec4 rest = geom[2u * splat + 1u];
        batch_rest[id] = vec2(rest.x, valid ? log2(rest.y) : NO_SPLAT);
        batch_colour[id] = valid ? colours[splat] : vec4(0.0);
        if (id == 0u) live = 0u;
        barrier();
        uint j = 0u;
        do {
            [[unroll]] for (uint u = 0u; u < 8u; ++u) {
                vec4 shape = batch_shape[j + u];
                vec2 rest = batch_rest[j + u];
                float dx = shape.x - float(x);
                float peak = shape.z * dx * dx + rest.y;
                float alpha = splat_alpha(rules, peak, shape.w * dx, rest.x, rest.y, shape.y - float(y));
                sum += blend_weight(rules, alpha, t) * batch_colour[j + u].rgb;
            }
            j += 8u;
        } while (j < min(BATCH, end - at));
        if (t > 0.0) atomicOr(live, 1u);
        barrier();
        bool stopped = live == 0u;
        barrier();
        at = stopped ? end : at + BATCH;
    } while (at < end);
    if (inside) {
        float final_t = abs(t);
        vec3 background = vec3(p.background_r, p.background_g, p.background_b);
        image[p.out_offset + y * p.width + x] = vec4(sum + final_t * background, final_t);
    }
}
