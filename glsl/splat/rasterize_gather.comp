#version 460
// splat/rasterize_gather: sums the slots of each splat. One invocation per visible splat, fixed order.
//   in   v_slots [I,4]   slot_ranges [V,2] first, end
//   out  v_colours [V,4] = sum of the splat's slots, 4th channel 0 (=)
#extension GL_EXT_control_flow_attributes : require
#extension GL_GOOGLE_include_directive : require
#include "lib/grid.glsl"
layout(local_size_x = 64) in;
#include "lib/texels.glsl"
layout(push_constant) uniform Params { uint num_visible, num_slots; } p;
TEXELS_F32(0, v_slots);
TEXELS_U32(1, slot_ranges);
layout(set = 0, binding = 2) buffer VColours { vec4 v_colours[]; };

// Four slots a turn: fewer loop-carried updates, and the loop limit of lavapipe stays out of reach.
void add_four(inout vec3 sum, inout uint at, uint end) {
    [[unroll]] for (uint k = 0u; k < 4u; ++k) {
        vec3 value = texel_load(v_slots, int(min(at + k, p.num_slots - 1u))).xyz;
        sum += at + k < end ? value : vec3(0.0);
    }
    at += 4u;
}

void main() {
    uint splat = global_index();
    bool valid = splat < p.num_visible;
    uint at = valid ? texel_pick(slot_ranges, 2u * splat) : 0u;
    uint end = valid ? texel_pick(slot_ranges, 2u * splat + 1u) : 0u;
    vec3 sum = vec3(0.0);
#ifdef TILES
    // Asks first: of invocations that leave a bottom-tested loop before others, SwiftShader loses what they loaded
    // last.
    while (at < end) add_four(sum, at, end);
#else
    // Asks last: a top-tested loop runs one turn more on lavapipe, masked.
    do add_four(sum, at, end); while (at < end);
#endif
    if (valid) v_colours[splat] = vec4(sum, 0.0);
}
