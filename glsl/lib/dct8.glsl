// Orthonormal DCT-II of eight numbers and its inverse, by even and odd halves.
const float DCT_A = 0.35355339059327379; // sqrt(1/8)
const float DCT_B = 0.46193976625564337; // cos(pi/8) / 2
const float DCT_C = 0.19134171618254489; // cos(3 pi/8) / 2
const float DCT_P = 0.49039264020161522; // cos(pi/16) / 2
const float DCT_Q = 0.41573480615127262; // cos(3 pi/16) / 2
const float DCT_R = 0.27778511650980111; // cos(5 pi/16) / 2
const float DCT_T = 0.09754516100806413; // cos(7 pi/16) / 2

void dct8(inout float x[8]) {
    float e0 = x[0] + x[7], e1 = x[1] + x[6], e2 = x[2] + x[5], e3 = x[3] + x[4];
    float d0 = x[0] - x[7], d1 = x[1] - x[6], d2 = x[2] - x[5], d3 = x[3] - x[4];
    x[0] = DCT_A * ((e0 + e3) + (e1 + e2));
    x[4] = DCT_A * ((e0 + e3) - (e1 + e2));
    x[2] = DCT_B * (e0 - e3) + DCT_C * (e1 - e2);
    x[6] = DCT_C * (e0 - e3) - DCT_B * (e1 - e2);
    x[1] = DCT_P * d0 + DCT_Q * d1 + DCT_R * d2 + DCT_T * d3;
    x[3] = DCT_Q * d0 - DCT_T * d1 - DCT_P * d2 - DCT_R * d3;
    x[5] = DCT_R * d0 - DCT_P * d1 + DCT_T * d2 + DCT_Q * d3;
    x[7] = DCT_T * d0 - DCT_R * d1 + DCT_Q * d2 - DCT_P * d3;
}

void dct8_inverse(inout float x[8]) {
    float low = DCT_A * (x[0] + x[4]), high = DCT_A * (x[0] - x[4]);
    float e0 = low + (DCT_B * x[2] + DCT_C * x[6]), e3 = low - (DCT_B * x[2] + DCT_C * x[6]);
    float e1 = high + (DCT_C * x[2] - DCT_B * x[6]), e2 = high - (DCT_C * x[2] - DCT_B * x[6]);
    float o0 = DCT_P * x[1] + DCT_Q * x[3] + DCT_R * x[5] + DCT_T * x[7];
    float o1 = DCT_Q * x[1] - DCT_T * x[3] - DCT_P * x[5] - DCT_R * x[7];
    float o2 = DCT_R * x[1] - DCT_P * x[3] + DCT_T * x[5] + DCT_Q * x[7];
    float o3 = DCT_T * x[1] - DCT_R * x[3] + DCT_Q * x[5] - DCT_P * x[7];
    x[0] = e0 + o0;
    x[7] = e0 - o0;
    x[1] = e1 + o1;
    x[6] = e1 - o1;
    x[2] = e2 + o2;
    x[5] = e2 - o2;
    x[3] = e3 + o3;
    x[4] = e3 - o3;
}
