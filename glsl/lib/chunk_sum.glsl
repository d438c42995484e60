// lib/chunk_sum: the elements of a chunk of texels and their sum. Includers declare the texels `before` and p.n, behind
// which nothing counts.
uvec4 counted(uint texel) {
    uint i = 4u * texel;
    uvec4 v = texel_load(before, int(min(texel, p.n / 4u)));
    return uvec4(i < p.n ? v.x : 0u, i + 1u < p.n ? v.y : 0u, i + 2u < p.n ? v.z : 0u, i + 3u < p.n ? v.w : 0u);
}

// Of texel..end, or of `texel` alone where that is none.
uint chunk_sum(uint texel, uint end) {
    uint sum = 0u;
    do {
        uvec4 v = counted(texel);
        sum += v.x + v.y + v.z + v.w;
        ++texel;
    } while (texel < end);
    return sum;
}
