// Sums over a workgroup's invocations in their order, for tile kernels. Included behind local_size_x.
//   sum_before(x, total)   sum of x over the invocations before this one; total: over all of them
// All invocations of the workgroup call it together, as often as they like.
shared uint scanned[gl_WorkGroupSize.x];

uint sum_before(uint x, out uint total) {
    uint id = gl_LocalInvocationID.x;
    scanned[id] = x;
    barrier();
    uint step = 1u;
    do {
        uint add = id >= step ? scanned[id - step] : 0u;
        barrier();
        scanned[id] += add;
        barrier();
        step *= 2u;
    } while (step < gl_WorkGroupSize.x);
    uint before = scanned[id] - x;
    total = scanned[gl_WorkGroupSize.x - 1u];
    // Nobody writes for the next sum before all have read this one.
    barrier();
    return before;
}
