#version 460
// splat/rasterize_bytes: back-to-front blending into a framebuffer of 8 bits, which rounds after every splat, as
// viewers in browsers do. One workgroup per 8x8 tile, one invocation per column.
//   in   geom [V,8] = mean2d.xy, conic.ab | conic.c, opacity, depth, -   colours [V,4]   tile_offsets [tiles+1]
//     tile_order [tiles] active ones first
//        splat_from_isect [I, padded by 8] front to back inside a tile, as in lib/isect.glsl
//   out  image [..,H,W,4] = rgb over the background in steps of 1/255, transmittance without any steps (=), from pixel
//     `out_offset` on
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
layout(constant_id = 0) const uint PACKED = 1;
#include "lib/isect.glsl"
layout(constant_id = 1) const uint PLAIN = 1;
#include "lib/raster.glsl"
#include "lib/blend.glsl"
layout(push_constant) uniform Params {
    uint width, height, tiles_x, num_active, tile_stride, out_offset;
    float background_r, background_g, background_b;
    float min_alpha, max_alpha, span, foot;
} p;
TEXELS_F32(0, geom);
TEXELS_F32(1, colours);
TEXELS_U32(2, splat_from_isect);
TEXELS_U32(3, tile_offsets);
TEXELS_U32(5, tile_order);
layout(set = 0, binding = 4) buffer Image { vec4 image[]; };

const float STEPS = 255.0;

vec3 stored(vec3 steps) {
    return floor(clamp(steps, 0.0, STEPS) + 0.5);
}

void main() {
    if (workgroup_index() >= p.num_active) return;
    // A pixel has no end: what is behind all others comes first.
    Rules rules = Rules(p.min_alpha, p.max_alpha, p.span, p.foot, 0u);
    uint tile = texel_pick(tile_order, interleaved(workgroup_index(), p.tile_stride, p.num_active));
    uint x = (tile % p.tiles_x) * 8u + gl_LocalInvocationID.x, y = (tile / p.tiles_x) * 8u;
    uint begin = texel_pick(tile_offsets, tile), at = texel_pick(tile_offsets, tile + 1u);
    vec3 steps[8];
    float t[8];
    [[unroll]] for (int k = 0; k < 8; ++k) {
        steps[k] = stored(STEPS * vec3(p.background_r, p.background_g, p.background_b));
        t[k] = 1.0;
    }
    do {
        at -= 1u;
        uint splat = isect_splat(texel_pick(splat_from_isect, at));
        vec4 shape = texel_load(geom, int(2u * splat));
        vec4 rest = texel_load(geom, int(2u * splat + 1u));
        vec3 colour = STEPS * texel_load(colours, int(splat)).rgb;
        float log_opacity = log2(rest.y);
        float dx = shape.x - float(x), top = shape.y - float(y);
        float peak = shape.z * dx * dx + log_opacity, bx = shape.w * dx;
        [[unroll]] for (int k = 0; k < 8; ++k) {
            float alpha = splat_alpha(rules, peak, bx, rest.x, log_opacity, top - float(k));
            // What a framebuffer of 8 bits is given is cut at white before it is blended.
            steps[k] = stored(min(alpha * colour, STEPS) + (1.0 - alpha) * steps[k]);
            t[k] *= 1.0 - alpha;
        }
    } while (at > begin);
    [[unroll]] for (int k = 0; k < 8; ++k) {
        if (x < p.width && y + uint(k) < p.height) {
            image[p.out_offset + (y + uint(k)) * p.width + x] = vec4(steps[k] / STEPS, t[k]);
        }
    }
}
