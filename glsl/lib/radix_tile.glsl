// What the two passes of scan/radix_sort share on GPUs. Included behind BINS and Params.
const uint MAX_BINS = 16u;
// Texels of keys of one invocation.
const uint OWN = 4u;

uint digit(uint key) {
    return (key >> p.shift) & (BINS - 1u);
}
