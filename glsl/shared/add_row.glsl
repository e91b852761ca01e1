// A sum and one row of three tokens times one row of taps, one product after another: each an addition for nothing.
vec4 add_row(vec4 sum, vec4 row[3], vec4 taps[9], const uint ky) {
    [[unroll]] for (uint kx = 0u; kx < 3u; ++kx) sum += taps[3u * ky + kx] * row[kx];
    return sum;
}
