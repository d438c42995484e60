// lib/chunk_prefix: exclusive sums of a chunk of texels in place, from the sum of what stands before it. Includers
// declare what lib/chunk_sum wants, and as `data` the same memory to write: a texel is read, then written.
#include "lib/chunk_sum.glsl"

void put_prefixes(uint texel, uint end, uint sum) {
    do {
        uvec4 v = counted(texel);
        uvec4 sums = uvec4(sum, sum + v.x, sum + v.x + v.y, sum + v.x + v.y + v.z);
        if (texel < end) data[texel] = sums;
        sum = sums.w + v.w;
        ++texel;
    } while (texel < end);
}
