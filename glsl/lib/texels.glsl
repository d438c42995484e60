// Buffers of four-component texels that a shader only reads; an index out of range gives zeros.
//   TEXELS_F32(binding, name);   TEXELS_U32(binding, name);   texel_load(name, index)
// In the lane kernels texel buffers, whose loads the drivers of processors do eight at a time; in the tile kernels
// (TILES) storage buffers, whose size no driver limits to less than 128 MiB.
#ifdef TILES
#define TEXELS(binding_number, type, name) \
    layout(set = 0, binding = binding_number, std430) readonly buffer Texels_##name { type name[]; }; \
    type load_##name(int i) { \
        uint last = uint(name.length()) - 1u; \
        type texel = name[min(uint(i), last)]; \
        return uint(i) > last ? type(0) : texel; \
    }
#define TEXELS_F32(binding_number, name) TEXELS(binding_number, vec4, name)
#define TEXELS_U32(binding_number, name) TEXELS(binding_number, uvec4, name)
#define texel_load(name, i) load_##name(i)
#else
#define TEXELS_F32(binding_number, name) \
    layout(set = 0, binding = binding_number, rgba32f) uniform readonly imageBuffer name
#define TEXELS_U32(binding_number, name) \
    layout(set = 0, binding = binding_number, rgba32ui) uniform readonly uimageBuffer name
#define texel_load imageLoad
#endif

// Component `i` & 3 of a texel.
uint pick(uvec4 v, uint i) {
    uint low = (i & 1u) != 0u ? v.y : v.x;
    uint high = (i & 1u) != 0u ? v.w : v.z;
    return (i & 2u) != 0u ? high : low;
}

float pick(vec4 v, uint i) {
    return uintBitsToFloat(pick(floatBitsToUint(v), i));
}

// Element `i` of a buffer of scalars. Processors' drivers load one lane after the other from a storage buffer.
#define texel_pick(name, i) pick(texel_load(name, int(i) >> 2), uint(i))
