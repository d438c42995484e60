#version 460
// code/copy_score_sum: scores of many copies of a fingerprint, whose chips are made where they are counted and stored
// nowhere. One invocation per copy.
//   in   keys [copies, 8]   biases [chips], below 2^16   weights [chips]   chips in whole blocks of 32, weight 0 where
//     there is none
//   out  scores [copies] (=) = sum of the weights of the chips that are +1
//   Chip 32b + i of a copy is +1 where 16 bits lie below its bias: half i of block b of ChaCha8 (Bernstein 2008) under
//     its key, the low half of each word first. twin kernels/src/reference/code/copy_score.rs
//   On processors eight neighbours load a block's biases and weights together, four each, and hand them round; on GPUs
//     (TILES) all read the same, which their caches are made for. Each block is summed by itself, so that rounding
//     grows with its length and the number of blocks, not with their product.
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
#ifdef TILES
#define OF_BLOCK(name, own, i) texel_load(name, int(TEXELS * block + i))
#else
#define OF_BLOCK(name, own, i) lane_shuffle(own, i)
#endif

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
        uvec4 words[4];
        chacha8(first, second, block, words[0], words[1], words[2], words[3]);
        float sum = 0.0;
        [[unroll]] for (uint i = 0u; i < TEXELS; ++i) {
            uvec4 bound = OF_BLOCK(biases, own_biases, i);
            vec4 weight = OF_BLOCK(weights, own_weights, i);
            uvec2 pair = i % 2u == 0u ? words[i / 2u].xy : words[i / 2u].zw;
            uvec4 halves = uvec4(pair.x & 0xffffu, pair.x >> 16, pair.y & 0xffffu, pair.y >> 16);
            vec4 counted = mix(vec4(0.0), weight, lessThan(halves, bound));
            sum += counted.x + counted.y + (counted.z + counted.w);
        }
        score += sum;
        ++block;
    } while (block < p.blocks);
    if (copy < p.copies) {
        scores[copy] = score;
    }
}
