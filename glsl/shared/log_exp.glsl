// log1p and expm1 to a few ulp. GLSL has neither, and Vulkan's log is only good to 2^-21 absolutely near 1.
// Range reduction and polynomials in the manner of fdlibm (s_log1pf.c, s_expm1f.c: Sun Microsystems, freely usable).

const float LN2_HIGH = 6.9313812256e-01;
const float LN2_LOW = 9.0580006145e-06;

// log(1 + x), x >= 0.
float log1p(float x) {
    precise float u = 1.0 + x;
    // What the addition lost, relative to u.
    precise float lost = x >= 1.0 ? 1.0 - (u - x) : x - (u - 1.0);
    uint bits = floatBitsToUint(u);
    // u = 2^k (1 + f), 1 + f in [sqrt(1/2), sqrt(2)).
    int k = int((bits + (0x3f800000u - 0x3f3504f3u)) >> 23) - 127;
    float m = uintBitsToFloat(bits - uint(k << 23));
    precise float f = m - 1.0;
    float correction = lost / u;
    if (k == 0) {
        // 1 + x needed no scaling: x itself is exact.
        f = x;
        correction = 0.0;
    }
    precise float s = f / (2.0 + f);
    float z = s * s;
    float w = z * z;
    float r = z * (0.66666662693 + w * 0.28498786688) + w * (0.40000972152 + w * 0.24279078841);
    precise float half_square = 0.5 * f * f;
    precise float tail = s * (half_square + r) + (float(k) * LN2_LOW + correction);
    precise float sum = float(k) * LN2_HIGH + (f - (half_square - tail));
    return sum;
}

// exp(x) - 1, x up to 88.
float expm1(float x) {
    float k = roundEven(x * 1.4426950408889634);
    precise float high = x - k * LN2_HIGH;
    precise float r = high - k * LN2_LOW;           // |r| <= ln(2)/2
    // exp(r) - 1 - r, by Taylor: the next term is below 2^-26 of r.
    float p = r * r * (0.5 + r * (1.0 / 6.0 + r * (1.0 / 24.0 + r * (1.0 / 120.0 + r * (1.0 / 720.0 + r / 5040.0)))));
    precise float e = r + p;
    if (k == 0.0) return e;
    if (k < -25.0) return -1.0;
    // In two steps: 2^k alone overflows at the largest x.
    float half_scale = uintBitsToFloat(uint(int(k) - 1 + 127) << 23);
    precise float scaled = (e * half_scale + (half_scale - 0.5)) * 2.0;
    return scaled;
}
