// Mean of a term over colour values with its gradient. The includer defines TERM(d) and SLOPE(d) of the vec3
// difference d = image - reference; v_before is v_image's memory as texels. Each invocation owns PIXELS pixels; eight lanes share one partial sum.
layout(local_size_x = 64) in;
layout(constant_id = 0) const uint ACCUMULATE = 0;
layout(constant_id = 1) const uint PIXELS = 16;
layout(push_constant) uniform Params { uint n, image_px, reference_px; float slope_scale; } p;
layout(set = 0, binding = 0, rgba32f) uniform readonly imageBuffer image;
layout(set = 0, binding = 1, rgba32f) uniform readonly imageBuffer reference;
layout(set = 0, binding = 2, rgba32f) uniform readonly imageBuffer v_before;
layout(set = 0, binding = 3) writeonly buffer VImage { vec4 v_image[]; };
layout(set = 0, binding = 4) writeonly buffer Partial { float partial[]; };

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint i = gl_WorkGroupID.x * 64 * PIXELS + lane;
    uint end = min(p.n, (gl_WorkGroupID.x + 1) * 64 * PIXELS);
    vec3 sum = vec3(0.0);
    uint left = PIXELS;
    do {
        if (i < end) {
            vec3 d = imageLoad(image, int(p.image_px + i)).rgb - imageLoad(reference, int(p.reference_px + i)).rgb;
            sum += TERM(d);
            vec3 v = p.slope_scale * SLOPE(d);
            if (ACCUMULATE != 0) v += imageLoad(v_before, int(p.image_px + i)).rgb;
            v_image[p.image_px + i] = vec4(v, 0.0);
        }
        i += 64;
        left--;
    } while (left > 0);
    float total = sum.r + sum.g + sum.b;
    total += subgroupShuffleXor(total, 1);
    total += subgroupShuffleXor(total, 2);
    total += subgroupShuffleXor(total, 4);
    if (lane % 8 == 0) partial[gl_WorkGroupID.x * 8 + lane / 8] = total;
}
