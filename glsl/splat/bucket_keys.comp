#version 460
// splat/bucket_keys: depth in buckets, as renderers sort by that sort on the CPU. Of the scene's depth 32 bins are
// made, and the nearer to the camera a bin is, the more of the buckets it has. One invocation per splat.
//   in   geom [N,8] depth is the seventh of each, 0 = culled   along [N] splats in the order that those of one bucket
//     have, front to back
//   out  keys [N] = bucket, 0 is nearest, buckets + 1 = culled (=)   order [N] = along (=)
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint n, buckets, camera_bin; float farthest, bins_per_unit; } p;
TEXELS_F32(0, geom);
TEXELS_U32(1, along);
layout(set = 0, binding = 2) buffer Keys { uint keys[]; };
layout(set = 0, binding = 3) buffer Order { uint order[]; };

const uint BINS = 32u;

uint weight(uint bin) {
    uint apart = bin > p.camera_bin ? bin - p.camera_bin : p.camera_bin - bin;
    return apart == 0u ? 40u : apart <= 2u ? 20u : apart <= 5u ? 8u : apart <= 10u ? 3u : 1u;
}

void main() {
    uint i = global_index();
    if (i >= p.n) return;
    uint splat = texel_pick(along, i);
    float depth = texel_load(geom, int(2u * splat + 1u)).z;
    float place = clamp((p.farthest - depth) * p.bins_per_unit, 0.0, float(BINS) - 1e-3);
    uint bin = uint(place), total = 0u, before = 0u, own = 0u;
    for (uint b = 0u; b < BINS; ++b) total += weight(b);
    for (uint b = 0u; b < BINS; ++b) {
        uint share = max(1u, weight(b) * p.buckets / total);
        before += b < bin ? share : 0u;
        own = b == bin ? share : own;
    }
    uint nearness = min(before + uint(float(own) * (place - float(bin))), p.buckets);
    keys[i] = depth > 0.0 ? p.buckets - nearness : p.buckets + 1u;
    order[i] = splat;
}
