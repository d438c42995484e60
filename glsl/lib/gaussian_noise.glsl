// Three standard normal values for a counter: PCG4D (Jarzynski & Olano 2020), then Box-Muller.
uvec4 pcg4d(uvec4 v) {
    v = v * 1664525u + 1013904223u;
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    v ^= v >> 16u;
    v.x += v.y * v.w; v.y += v.z * v.x; v.z += v.x * v.y; v.w += v.y * v.z;
    return v;
}

vec3 gaussian_noise(uint index, uint stream, uint seed_low, uint seed_high) {
    uvec4 bits = pcg4d(uvec4(index, stream, seed_low, seed_high));
    vec4 u = (vec4(bits >> 8u) + 0.5) * (1.0 / 16777216.0);
    float turn = 6.283185307179586;
    vec2 radius = sqrt(-2.0 * log(u.xz));
    return vec3(radius.x * cos(turn * u.y), radius.x * sin(turn * u.y), radius.y * cos(turn * u.w));
}
