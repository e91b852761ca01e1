// Of an ensemble of two, what the frame turned by half a circle gave and what the frame itself gives, averaged.
const uint FLAG_TURNED = 64u;
const uint FLAG_UPRIGHT = 128u;

// Keeps the turned frame's result of a pixel, and says false; averages the frame's own with it. `channels`: 1 or 3.
bool is_averaged(uvec2 at, uint channels, inout vec3 result) {
    uint pixel = at.y * width + at.x;
    if ((flags & FLAG_TURNED) != 0u) {
        for (uint i = 0u; i < channels; ++i) turned.v[pixel * channels + i] = result[i];
        return false;
    }
    if ((flags & FLAG_UPRIGHT) != 0u) {
        uint there = (pixels - 1u - pixel) * channels;
        for (uint i = 0u; i < channels; ++i) result[i] = 0.5 * result[i] + 0.5 * turned.v[there + i];
    }
    return true;
}
