// lib/block_scale: gradients in 16-bit floats, which end at 6e-8: what a workgroup stages is multiplied by the power of
// two that brings the largest value so far to 1..2. Where the scale falls, includers multiply the sums that they hold
// by how much.
// In x, bits of the largest magnitude of a finite value; such bits order as whole numbers do. Sixteen bytes, so that
// panels beside it stay where cooperative loads may begin: NVIDIA 580 aligns a variable to its elements alone.
shared uvec4 largest_bits;

// Bits of the largest magnitude among the finite components.
uint finite_bits(vec4 v) {
    uvec4 bits = floatBitsToUint(v) & 0x7fffffffu;
    bits = mix(bits, uvec4(0u), greaterThanEqual(bits, uvec4(0x7f800000u)));
    return max(max(bits.x, bits.y), max(bits.z, bits.w));
}

// Before the first of them; a barrier follows.
void start_block_scale(int id) {
    if (id == 0) {
        largest_bits.x = 0u;
    }
}

// Every invocation tells what it holds, then all meet at a barrier and read the scale.
void tell_block_scale(uint bits) {
    atomicMax(largest_bits.x, bits, gl_ScopeWorkgroup, gl_StorageSemanticsNone, gl_SemanticsRelaxed);
}

// From 2^-60 to 2^60, so that the ratio of two scales is a normal number.
float block_scale() {
    return uintBitsToFloat((254u - clamp(largest_bits.x >> 23, 127u - 60u, 127u + 60u)) << 23);
}

// Its inverse, exactly.
float unscale(float scale) {
    return uintBitsToFloat((254u << 23) - floatBitsToUint(scale));
}
