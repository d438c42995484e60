#version 460
// splat/project_fwd: EWA splatting, Zwicker et al. 2001. One invocation per splat. Where PLAIN is 1 by the rules of
// Kerbl et al. 2023, else by those that the dispatch brings (kernels/src/splat/rules.rs says what each is).
//   in   means [N,4] = xyz, opacity logit   scales [N,4] log, whether quats keep their norm   quats [N,4] wxyz
//   out  geom [N,8] = mean2d.xy px, conic.ab | conic.c, opacity, depth, reach, conic times -log2(e)/2, b doubled (=)
//        dirs [N,4] unit vector camera -> mean (=)   tile_rects [N,4] 8x8 tiles x0 y0 x1 y1, empty = culled (=)
//        depth_keys [N] bits of the view depth or distance, ~0 = culled (=)   order [N] = splat (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
#include "lib/quat.glsl"
#include "lib/raster.glsl"
layout(local_size_x = 64) in;
layout(constant_id = 0) const uint PLAIN = 1;
#include "lib/texels.glsl"
layout(push_constant) uniform Params {
    uint n, width, height;
    float fx, fy, cx, cy;
    float view_00, view_01, view_02, view_03;
    float view_10, view_11, view_12, view_13;
    float view_20, view_21, view_22, view_23;
    float dilation, split, min_minor, min_major, margin, guard, min_alpha, span;
    uint compensated, tiles, distance;
} p;
TEXELS_F32(0, means);
TEXELS_F32(1, scales);
TEXELS_F32(2, quats);
layout(set = 0, binding = 3) buffer Geom { vec4 geom[]; };
layout(set = 0, binding = 4) buffer Dirs { vec4 dirs[]; };
layout(set = 0, binding = 5) buffer TileRects { uvec4 tile_rects[]; };
layout(set = 0, binding = 6) buffer DepthKeys { uint depth_keys[]; };
layout(set = 0, binding = 7) buffer Order { uint order[]; };

const float NEAR_DEPTH = 0.2;
const float DILATION = 0.3;
const float MARGIN = 1.3;
const float MIN_SPREAD = 0.1;
const float LOG2_E = 1.4426950408889634;

// Rows of the 2x3 matrix J W R S, whose Gram matrix is the projected covariance before the blur.
void half_covariance(vec3 view, mat3 rotation, vec4 quat, vec4 log_scale, out vec3 row_x, out vec3 row_y) {
    vec2 limit = (PLAIN == 1u ? MARGIN : p.margin) * 0.5 * vec2(p.width, p.height) / vec2(p.fx, p.fy);
    vec2 t = clamp(view.xy / view.z, -limit, limit);
    // Splats that a network has added to after activation are drawn with the matrix of their quaternion as it is.
    mat3 m = rotation * quat_to_mat3(log_scale.w == 0.0 ? quat_normalize(quat) : quat);
    vec3 scale = exp(log_scale.xyz);
    mat3 rows = transpose(m);
    row_x = (p.fx / view.z) * (rows[0] - t.x * rows[2]) * scale;
    row_y = (p.fy / view.z) * (rows[1] - t.y * rows[2]) * scale;
}

// Makes the axes of an ellipse (xx, xy, yy, their variances divided by `unit`) differ as the rules want it; the
// determinant goes along. Whether it is drawn then.
bool reshape(inout vec3 cov, inout float det, float unit) {
    float mid = 0.5 * (cov.x + cov.z), spread = 0.5 * (cov.x - cov.z);
    float gap = length(vec2(spread, cov.y));
    float radius = max(gap, p.split * unit);
    float major = mid + radius;
    float thin = radius > gap ? mid - radius : det / major;
    float minor = max(thin, p.min_minor * unit);
    if (radius > gap || minor > thin) {
        vec2 axis = vec2(cov.y, radius - spread);
        float size = length(axis);
        axis = size > 0.0 ? axis / size : vec2(1.0, 0.0);
        float more = major - minor;
        cov = vec3(minor + more * axis.x * axis.x, more * axis.x * axis.y, minor + more * axis.y * axis.y);
        det = major * minor;
    }
    return minor > 0.0 && major >= p.min_major * unit;
}

// 8x8 tiles of the box where alpha can count, and of reference renderers inside the 16x16 tiles of the 3-sigma square.
uvec4 tile_rect(vec2 mean2d, vec3 cov, float span) {
    float mid = 0.5 * (cov.x + cov.z), spread = 0.5 * (cov.x - cov.z);
    float radius = ceil(3.0 * sqrt(mid + sqrt(max(MIN_SPREAD, spread * spread + cov.y * cov.y))));
    vec2 grid = vec2((uvec2(p.width, p.height) + 15u) / 16u);
    bool tiles = PLAIN == 1u || p.tiles == 1u;
    vec2 low = tiles ? floor(clamp((mean2d - radius) / 16.0, vec2(0.0), grid)) : vec2(0.0);
    vec2 high = tiles ? floor(clamp((mean2d + radius + 15.0) / 16.0, vec2(0.0), grid)) : grid;
    vec2 reach = 1.001 * sqrt(2.0 * span * cov.xz) + 0.01;
    vec2 fine = vec2((uvec2(p.width, p.height) + 7u) / 8u);
    vec2 first = clamp(floor((mean2d - reach) / 8.0), 2.0 * low, fine);
    vec2 last = clamp(floor((mean2d + reach) / 8.0) + 1.0, first, max(first, min(2.0 * high, fine)));
    bool empty = high.x <= low.x || high.y <= low.y;
    return empty ? uvec4(0u) : uvec4(uvec2(first), uvec2(last));
}

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec4 mean = texel_load(means, int(i));
    mat3 rotation = mat3(p.view_00, p.view_10, p.view_20, p.view_01, p.view_11, p.view_21,
                         p.view_02, p.view_12, p.view_22);
    vec3 shift = vec3(p.view_03, p.view_13, p.view_23);
    vec3 view = rotation * mean.xyz + shift;
    vec3 row_x, row_y;
    half_covariance(view, rotation, texel_load(quats, int(i)), texel_load(scales, int(i)), row_x, row_y);
    vec3 gram = vec3(dot(row_x, row_x), dot(row_x, row_y), dot(row_y, row_y));
    // Scaled by the largest entry, so that huge splats do not overflow; the determinant is a sum of
    // non-negative terms (Cauchy-Binet), so that needles do not cancel.
    float unit = 1.0 / max(1.0, max(gram.x, gram.z));
    float root = sqrt(unit);
    vec3 minors = cross(row_x * root, row_y * root);
    vec3 g = gram * unit;
    float blur = (PLAIN == 1u ? DILATION : p.dilation) * unit;
    float det = dot(minors, minors) + blur * (g.x + g.z) + blur * blur;
    vec3 cov = g + vec3(blur, 0.0, blur);
    float opacity = 1.0 / (1.0 + exp(-mean.w));
    vec2 mean2d = vec2(p.fx * view.x, p.fy * view.y) / view.z + vec2(p.cx, p.cy);
    bool seen = true;
    if (PLAIN == 0u) {
        if (p.compensated == 1u) opacity *= sqrt(dot(minors, minors) / det);
        vec2 half_image = 0.5 * vec2(p.width, p.height);
        bool inside = all(lessThanEqual(abs(mean2d + 0.5 - half_image), p.guard * half_image));
        seen = reshape(cov, det, unit) && inside;
    }
    vec3 conic = vec3(cov.z, -cov.y, cov.x) / det * unit;
    vec4 shape = vec4(mean2d, conic.x * (-0.5 * LOG2_E), conic.y * -LOG2_E);
    float shape_c = conic.z * (-0.5 * LOG2_E);
    bool finite = !any(isnan(shape)) && !any(isinf(shape)) && !isnan(shape_c) && !isinf(shape_c);
    float min_alpha = PLAIN == 1u ? MIN_ALPHA : p.min_alpha;
    bool keep = view.z > NEAR_DEPTH && !isinf(view.z) && finite && seen && opacity >= min_alpha;
    float natural = log(opacity / min_alpha);
    float reach = log2(opacity * 255.0) + 1e-3;
    if (PLAIN == 0u) {
        natural = min(natural, p.span / LOG2_E);
        reach = min(log2(opacity / min_alpha), p.span) + 1e-3;
    }
    uvec4 rect = tile_rect(mean2d, cov / unit, natural);
    keep = keep && rect.z > rect.x && rect.w > rect.y;
    geom[2u * i] = keep ? shape : vec4(0.0);
    geom[2u * i + 1u] = keep ? vec4(shape_c, opacity, view.z, reach) : vec4(0.0);
    vec3 centre = -(shift * rotation);
    vec3 towards = mean.xyz - centre;
    dirs[i] = keep ? vec4(towards / max(length(towards), 1e-12), 0.0) : vec4(0.0);
    tile_rects[i] = keep ? rect : uvec4(0u);
    float far = PLAIN == 0u && p.distance == 1u ? length(towards) : view.z;
    depth_keys[i] = keep ? floatBitsToUint(far) : ~0u;
    order[i] = i;
}
