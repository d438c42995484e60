#version 460
// code/copy_score_sum: scores of many copies of a fingerprint, whose chips are made where they are counted and stored
// nowhere. One invocation per copy.
//   in   keys [copies, 8]   biases [chips], below 2^16   weights [chips]   chips in whole blocks of 32, weight 0 where
//     there is none
//   out  scores [copies] (=) = sum of the weights of the chips that are +1
//   Chip 32b + i of a copy is +1 where 16 bits lie below its bias: half i of block b of ChaCha8 (Bernstein 2008) under
//     its key, the low half of each word first. twin kernels/src/reference/code/copy_score.rs
//   Eight neighbours load a block's biases and weights together, four each, and hand them round. Each block is summed
//     by itself, so that rounding grows with its length and the number of blocks, not with their product.
#extension GL_EXT_control_flow_attributes : require
#include "lib/grid.glsl"
layout(local_size_x = 8) in;
#include "lib/texels.glsl"
#include "lib/shuffle.glsl"
#include "lib/chacha8.glsl"
layout(push_constant) uniform Params { uint copies, blocks; } p;
TEXELS_U32(0, keys);
TEXELS_U32(1, biases);
TEXELS_F32(2, weights);
layout(set = 0, binding = 3) writeonly buffer Scores { float scores[]; };

const uint TEXELS = 8u; // of a block

void main() {
    uint copy = global_index(), own = gl_LocalInvocationID.x % TEXELS;
    int key = int(2u * min(copy, p.copies - 1u));
    uvec4 first = texel_load(keys, key), second = texel_load(keys, key + 1);
    float score = 0.0;
    uint block = 0u;
    do {
        int texel = int(TEXELS * block + own);
        uvec4 own_biases = texel_load(biases, texel);
        vec4 own_weights = texel_load(weights, texel);
        uint words[16] = chacha8(first, second, block);
        float sum = 0.0;
        [[unroll]] for (uint i = 0u; i < TEXELS; ++i) {
            uvec4 bound = lane_shuffle(own_biases, i);
            vec4 weight = lane_shuffle(own_weights, i);
            uint low = words[2u * i], high = words[2u * i + 1u];
            sum += ((low & 0xffffu) < bound.x ? weight.x : 0.0) + ((low >> 16) < bound.y ? weight.y : 0.0);
            sum += ((high & 0xffffu) < bound.z ? weight.z : 0.0) + ((high >> 16) < bound.w ? weight.w : 0.0);
        }
        score += sum;
        ++block;
    } while (block < p.blocks);
    if (copy < p.copies) {
        scores[copy] = score;
    }
}
