// Quaternions as vec4(w, x, y, z).

// q / |q|; a norm below 1e-12 divides by 1e-12 instead, as torch's normalize does.
vec4 quat_normalize(vec4 q) {
    return q / max(sqrt(dot(q, q)), 1e-12);
}

// Hamilton product a b.
vec4 quat_mul(vec4 a, vec4 b) {
    return vec4(a.x * b.x - a.y * b.y - a.z * b.z - a.w * b.w,
                a.x * b.y + a.y * b.x + a.z * b.w - a.w * b.z,
                a.x * b.z - a.y * b.w + a.z * b.x + a.w * b.y,
                a.x * b.w + a.y * b.z - a.z * b.y + a.w * b.x);
}

// Rotation matrix (columns) of a unit quaternion.
mat3 quat_to_mat3(vec4 q) {
    float w = q.x, x = q.y, y = q.z, z = q.w;
    return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
                2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
                2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}
