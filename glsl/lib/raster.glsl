// What every traversal of tiles shares.
const float MAX_ALPHA = 0.99;
const float MIN_ALPHA = 1.0 / 255.0;

// Index of the workgroup in a dispatch that may spill into y.
uint workgroup_index() {
    return gl_WorkGroupID.x + gl_WorkGroupID.y * gl_NumWorkGroups.x;
}

// A permutation of 0..count: neighbours in time lie apart in the list, so that a static split of the
// grid between workers is even. `stride` is coprime to `count`.
uint interleaved(uint index, uint stride, uint count) {
    return (index * stride) % count;
}
