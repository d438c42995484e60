#version 460
// splat/rasterize_fwd: front-to-back blending, Kerbl et al. 2023. One workgroup per 8x8 tile, one lane per column.
//   in   geom [V,8] = mean2d.xy, conic.ab | conic.c, opacity, depth, -   colours [V,4]   tile_offsets [tiles+1]
//     tile_order [tiles] active ones first
//        splat_from_isect [I, padded by 8] front to back inside a tile, as in lib/isect.glsl
//   out  image [..,H,W,4] = rgb over the background, final transmittance (=), from pixel `out_offset` on
//   a splat meets all pixels of its tiles, with weight 0 where it is skipped: a colour that is not finite makes those
//     NaN
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
#include "lib/lanes.glsl"
// 1 when no tile juts out of the image and no workgroup is one too many: then nothing is stored under a mask.
layout(constant_id = 0) const uint WHOLE = 0;
layout(constant_id = 1) const uint PACKED = 1;
#include "lib/isect.glsl"
layout(constant_id = 2) const uint PLAIN = 1;
#include "lib/raster.glsl"
#include "lib/blend.glsl"
layout(push_constant) uniform Params {
    uint width, height, tiles_x, num_active, tile_stride, out_offset;
    float background_r, background_g, background_b;
    float min_alpha, max_alpha, span, foot;
    uint behind;
} p;
TEXELS_F32(0, geom);
TEXELS_F32(1, colours);
TEXELS_U32(2, splat_from_isect);
TEXELS_U32(3, tile_offsets);
TEXELS_U32(5, tile_order);
layout(set = 0, binding = 4) buffer Image { vec4 image[]; };

void main() {
    uint lane = gl_LocalInvocationID.x;
    if (WHOLE == 0u && workgroup_index() >= p.num_active) return;
    Rules rules = Rules(p.min_alpha, p.max_alpha, p.span, p.foot, p.behind);
    uint tile = texel_pick(tile_order, interleaved(workgroup_index(), p.tile_stride, p.num_active));
    uint x = (tile % p.tiles_x) * 8u + lane, y = (tile / p.tiles_x) * 8u;
    float px = float(x), py = float(y);
    uint at = texel_pick(tile_offsets, tile), end = texel_pick(tile_offsets, tile + 1u);
    float t[8], r[8], g[8], b[8];
    [[unroll]] for (int k = 0; k < 8; ++k) {
        // A pixel outside the image starts stopped.
        t[k] = x < p.width && y + uint(k) < p.height ? 1.0 : -1.0;
        r[k] = g[k] = b[k] = 0.0;
    }
    float live;
    do {
        uint i = at + lane;
        bool valid = i < end;
        uint splat = isect_splat(texel_pick(splat_from_isect, i));
        splat = valid ? splat : 0u;
        vec4 shape = texel_load(geom, int(2u * splat));
        vec4 rest = texel_load(geom, int(2u * splat + 1u));
        vec4 colour = mix(vec4(0.0), texel_load(colours, int(splat)), bvec4(valid));
        float log_opacity = valid ? log2(rest.y) : NO_SPLAT;
        // One splat after the other for each row of pixels: sums and transmittances then stay in registers.
        float peak[8], bx[8], c[8], lo[8], top[8], cr[8], cg[8], cb[8];
        [[unroll]] for (int j = 0; j < 8; ++j) {
            float dx = lane_shuffle(shape.x, j) - px;
            top[j] = lane_shuffle(shape.y, j) - py;
            lo[j] = lane_shuffle(log_opacity, j);
            peak[j] = lane_shuffle(shape.z, j) * dx * dx + lo[j];
            bx[j] = lane_shuffle(shape.w, j) * dx;
            c[j] = lane_shuffle(rest.x, j);
            cr[j] = lane_shuffle(colour.x, j);
            cg[j] = lane_shuffle(colour.y, j);
            cb[j] = lane_shuffle(colour.z, j);
        }
        [[unroll]] for (int k = 0; k < 8; ++k) {
            [[unroll]] for (int j = 0; j < 8; ++j) {
                float alpha = splat_alpha(rules, peak[j], bx[j], c[j], lo[j], top[j] - float(k));
                float weight = blend_weight(rules, alpha, t[k]);
                r[k] += weight * cr[j];
                g[k] += weight * cg[j];
                b[k] += weight * cb[j];
            }
        }
        live = t[0];
        [[unroll]] for (int k = 1; k < 8; ++k) live = max(live, t[k]);
        live = lanes_max(live);
        at += 8u;
    } while (at < end && live > 0.0);
    vec3 background = vec3(p.background_r, p.background_g, p.background_b);
    [[unroll]] for (int k = 0; k < 8; ++k) {
        float final_t = abs(t[k]);
        if (WHOLE == 1u || (x < p.width && y + uint(k) < p.height)) {
            image[p.out_offset + (y + uint(k)) * p.width + x] =
                vec4(vec3(r[k], g[k], b[k]) + final_t * background, final_t);
        }
    }
}
