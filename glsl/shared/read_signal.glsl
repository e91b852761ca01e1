// A signal of a pixel, as the caller wrote it; one channel three times.
vec3 read_signal(uvec2 at) {
    uint index = ((flags & FLAG_SIGNAL_ODD) != 0u ? 1u : 0u) + at.y * signal_row + at.x * signal_pixel;
    bool half_floats = (flags & FLAG_SIGNAL_HALF) != 0u;
    uint channel = (flags & FLAG_SIGNAL_ONE) != 0u ? 0u : signal_channel;
    uvec3 at_channel = index + channel * uvec3(0u, 1u, 2u);
    vec3 read;
    for (int i = 0; i < 3; ++i) {
        if (half_floats) {
            vec2 both = unpackHalf2x16(signal.v[at_channel[i] / 2u]);
            read[i] = (at_channel[i] & 1u) == 0u ? both.x : both.y;
        } else {
            read[i] = uintBitsToFloat(signal.v[at_channel[i]]);
        }
    }
    return read;
}
