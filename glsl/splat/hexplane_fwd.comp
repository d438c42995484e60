#version 460
// splat/hexplane_fwd: HexPlane features of canonical positions at one time, Cao & Johnson 2023. One invocation per
// splat.
//   in   means [N,4]   planes = every plane [R_b,R_a,C4] one after another
//        plane_shapes [L,6,4] = first texel, R_a, R_b, 0, pairs in the order xy xz xt yz yt zt
//   out  features [N, L*C4] = per level the product over planes of the bilinear sample (=)
//   positions go through (p - aabb_0) 2/(aabb_1 - aabb_0) - 1, the time does not; samples outside take the border
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params {
    uint n, levels, channel_texels;
    float time;
    float first_x, first_y, first_z, second_x, second_y, second_z;
} p;
TEXELS_F32(0, means);
TEXELS_F32(1, planes);
TEXELS_U32(2, plane_shapes);
layout(set = 0, binding = 3) buffer Features { vec4 features[]; };

// Index and fraction of the lower neighbour on an axis of `size` samples, corners aligned, border outside.
vec2 axis_position(float q, uint size) {
    float at = 0.5 * (q + 1.0) * float(size - 1u);
    // clamp(NaN) is undefined in GLSL; here it reads the first sample.
    at = at > 0.0 ? min(at, float(size - 1u)) : 0.0;
    float low = min(floor(at), float(max(size, 2u) - 2u));
    return vec2(low, at - low);
}

// mix, which drivers may compute as x + (y - x) * t: that is NaN where both are infinite.
vec4 between(vec4 x, vec4 y, float t) {
    return x * (1.0 - t) + y * t;
}

vec4 plane_sample(uvec4 shape, vec2 q, uint channel) {
    vec2 a = axis_position(q.x, shape.y), b = axis_position(q.y, shape.z);
    uint right = shape.y > 1u ? p.channel_texels : 0u;
    uint below = shape.z > 1u ? shape.y * p.channel_texels : 0u;
    uint at = shape.x + (uint(b.x) * shape.y + uint(a.x)) * p.channel_texels + channel;
    vec4 upper = between(texel_load(planes, int(at)), texel_load(planes, int(at + right)), a.y);
    vec4 lower = between(texel_load(planes, int(at + below)), texel_load(planes, int(at + below + right)), a.y);
    return between(upper, lower, b.y);
}

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    vec3 first = vec3(p.first_x, p.first_y, p.first_z), second = vec3(p.second_x, p.second_y, p.second_z);
    vec3 q = (texel_load(means, int(i)).xyz - first) * 2.0 / (second - first) - 1.0;
    uint blocks = p.levels * p.channel_texels, block = 0u;
    do {
        int level = int(block / p.channel_texels) * 6;
        uint channel = block % p.channel_texels;
        vec4 product = plane_sample(texel_load(plane_shapes, level), q.xy, channel);
        product *= plane_sample(texel_load(plane_shapes, level + 1), q.xz, channel);
        product *= plane_sample(texel_load(plane_shapes, level + 2), vec2(q.x, p.time), channel);
        product *= plane_sample(texel_load(plane_shapes, level + 3), q.yz, channel);
        product *= plane_sample(texel_load(plane_shapes, level + 4), vec2(q.y, p.time), channel);
        product *= plane_sample(texel_load(plane_shapes, level + 5), vec2(q.z, p.time), channel);
        features[i * blocks + block] = product;
        ++block;
    } while (block < blocks);
}
