// Linear invocation index of a `Grid::threads(n)` dispatch, which spills into y beyond the x limit.
// A macro, because the workgroup size is declared after the includes.
#define global_index() \
    (gl_GlobalInvocationID.x + gl_GlobalInvocationID.y * (gl_NumWorkGroups.x * gl_WorkGroupSize.x))
