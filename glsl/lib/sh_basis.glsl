// The basis of degree 0, the same in every direction.
const float SH_CONSTANT = 0.28209479177387814;

// Real spherical harmonics in 3DGS order and sign (Kerbl et al. 2023); `d` is a unit direction.
// Entries above `degree` are zero.
void sh_basis(vec3 d, uint degree, out float y[16]) {
    float one = float(degree >= 1u), two = float(degree >= 2u), three = float(degree >= 3u);
    float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
    y[0] = SH_CONSTANT;
    y[1] = -0.4886025119029199 * d.y * one;
    y[2] = 0.4886025119029199 * d.z * one;
    y[3] = -0.4886025119029199 * d.x * one;
    y[4] = 1.0925484305920792 * d.x * d.y * two;
    y[5] = -1.0925484305920792 * d.y * d.z * two;
    y[6] = 0.31539156525252005 * (2.0 * zz - xx - yy) * two;
    y[7] = -1.0925484305920792 * d.x * d.z * two;
    y[8] = 0.5462742152960396 * (xx - yy) * two;
    y[9] = -0.5900435899266435 * d.y * (3.0 * xx - yy) * three;
    y[10] = 2.890611442640554 * d.x * d.y * d.z * three;
    y[11] = -0.4570457994644658 * d.y * (4.0 * zz - xx - yy) * three;
    y[12] = 0.3731763325901154 * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * three;
    y[13] = -0.4570457994644658 * d.x * (4.0 * zz - xx - yy) * three;
    y[14] = 1.445305721320277 * d.z * (xx - yy) * three;
    y[15] = -0.5900435899266435 * d.x * (xx - 3.0 * yy) * three;
}
