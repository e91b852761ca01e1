// What kernels of pixels read, of the planes that the push constants name.

// What a tap at `at` reads: the reliability times the image, and the reliability; of the albedo what the radiance is
// divided by, and 1. Zeros outside the frame.
vec4 load_tap(ivec2 at, bool of_albedo) {
    bool inside = min(at.x, at.y) >= 0 && at.x < int(width) && at.y < int(height);
    uvec2 clamped = uvec2(clamp(at, ivec2(0), ivec2(width, height) - 1));
    uint pixel = clamped.y * width + clamped.x;
    vec4 value;
    if (of_albedo) {
        value = vec4(demodulator(LOAD(albedo, pixel * albedo_stride).xyz), 1.0);
    } else {
        value = LOAD_WEIGHTS(taps, pixel * taps_stride);
    }
    return mix(vec4(0.0), value, bvec4(inside));
}
