// The median luminance, or the 99.9th percentile of depth, from its histogram, interpolated within a bin. One workgroup.
#version 460
#include "shared/storage.glsl"
#include "shared/stats.glsl"

layout(local_size_x = 256) in;

layout(push_constant) uniform Push {
    Uints histogram;
    Floats dst;
    uint of_depth;
    uint unused;
};

const uint PER_LANE = BINS / 256u;

shared uint counts[256];

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint first = lane * PER_LANE;
    uint count = 0u;
    for (uint i = 0u; i < PER_LANE; ++i) count += histogram.v[first + i];
    counts[lane] = count;
    barrier();
    if (lane != 0u) return;

    uint total = 0u;
    for (uint i = 0u; i < 256u; ++i) total += counts[i];
    bool depth = of_depth != 0u;
    float value = depth ? 1.0 : 0.0;
    if (total > 0u) {
        // 999/1000 in integers: floats do not hold every count.
        uint last = total - 1u;
        uint rank = depth ? last - (last + 999u) / 1000u : last / 2u;
        uint before = 0u;
        uint segment = 0u;
        while (before + counts[segment] <= rank) before += counts[segment++];
        uint bin = segment * PER_LANE;
        while (before + histogram.v[bin] <= rank) before += histogram.v[bin++];
        uint first_bin = depth ? DEPTH_FIRST : 0u;
        uint shift = depth ? DEPTH_SHIFT : LUMINANCE_SHIFT;
        float low = uintBitsToFloat((bin + first_bin) << shift);
        // The last finite bin of luminance ends at the largest float.
        float high = uintBitsToFloat(min((bin + first_bin + 1u) << shift, 0x7f7fffffu));
        value = low + (high - low) * ((float(rank - before) + 0.5) / float(histogram.v[bin]));
    }
    dst.v[0] = value;
}
