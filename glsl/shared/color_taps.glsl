// The taps of a 3x3 convolution of the colour, four channels of 32-bit floats, for kernels on matrices: the colours of
// a square are rounded to halves and staged once; pixels' taps are made of them.
const float LARGEST_HALF = 65504.0;

// Stages the square whose first pixel is `corner`, from vector `to` on. Beyond the frame, of `size`, it is zero.
void stage_colors(uint to, const uint side, ivec2 corner, ivec2 size) {
    for (uint i = tile_lane; i < side * side; i += TILE_LANES) {
        ivec2 at = corner + ivec2(i % side, i / side);
        bool inside = all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, size));
        vec4 value = LOAD(src, uint(inside ? at.y * size.x + at.x : 0) * src_stride);
        // Larger values would become infinite, and the sums NaN.
        value = inside ? clamp(value, -LARGEST_HALF, LARGEST_HALF) : vec4(0.0);
        staged[to + i / 2u][i % 2u * 2u] = packHalf2x16(value.xy);
        staged[to + i / 2u][i % 2u * 2u + 1u] = packHalf2x16(value.zw);
    }
}

// Two taps, `pair` of them, of the pixel whose first tap is staged as number `first`; zeros from the ninth on.
uvec4 color_taps(uint from, const uint side, uint first, uint pair) {
    uvec4 taps = uvec4(0u);
    [[unroll]] for (uint n = 0u; n < 2u; ++n) {
        uint tap = 2u * pair + n, color = first + tap / 3u * side + tap % 3u;
        if (tap < 9u) {
            taps[2u * n] = staged[from + color / 2u][color % 2u * 2u];
            taps[2u * n + 1u] = staged[from + color / 2u][color % 2u * 2u + 1u];
        }
    }
    return taps;
}
