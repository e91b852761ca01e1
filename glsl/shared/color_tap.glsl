// Taps of a 3x3 convolution of the colour, four channels of 32-bit floats, for kernels on matrices.
const float LARGEST_HALF = 65504.0;

// Tap `tap` of a pixel of a frame of this size; zeros beyond the frame, and from the ninth on.
vec4 color_tap(ivec2 pixel, uint tap, ivec2 size) {
    ivec2 at = pixel + ivec2(tap % 3u, tap / 3u) - 1;
    bool inside = tap < 9u && all(greaterThanEqual(at, ivec2(0))) && all(lessThan(at, size));
    vec4 value = LOAD(src, uint(inside ? at.y * size.x + at.x : 0) * src_stride);
    // Larger values would become infinite, and the sums NaN.
    return inside ? clamp(value, -LARGEST_HALF, LARGEST_HALF) : vec4(0.0);
}
