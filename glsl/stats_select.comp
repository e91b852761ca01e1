// Group 0: median luminance; group 1: 99.9th percentile of depth. From the histograms, interpolated within a bin.
#version 460
#include "shared/storage.glsl"
#include "shared/stats.glsl"

layout(local_size_x = 256) in;

layout(push_constant) uniform Push {
    Uints histograms;
    Stats stats;
};

const uint PER_LANE = BINS / 256u;

shared uint counts[256];

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint first = gl_WorkGroupID.x * BINS + lane * PER_LANE;
    uint count = 0u;
    for (uint i = 0u; i < PER_LANE; ++i) count += histograms.v[first + i];
    counts[lane] = count;
    barrier();
    if (lane != 0u) return;

    uint total = 0u;
    for (uint i = 0u; i < 256u; ++i) total += counts[i];
    bool of_depth = gl_WorkGroupID.x == 1u;
    float value = of_depth ? 1.0 : 0.0;
    if (total > 0u) {
        // 999/1000 in integers: floats do not hold every count.
        uint last = total - 1u;
        uint rank = of_depth ? last - (last + 999u) / 1000u : last / 2u;
        uint before = 0u;
        uint segment = 0u;
        while (before + counts[segment] <= rank) before += counts[segment++];
        uint bin = segment * PER_LANE;
        uint offset = gl_WorkGroupID.x * BINS;
        while (before + histograms.v[offset + bin] <= rank) before += histograms.v[offset + bin++];
        uint first_bin = of_depth ? DEPTH_FIRST : 0u;
        uint shift = of_depth ? DEPTH_SHIFT : LUMINANCE_SHIFT;
        float low = uintBitsToFloat((bin + first_bin) << shift);
        // The last finite bin of luminance ends at the largest float.
        float high = uintBitsToFloat(min((bin + first_bin + 1u) << shift, 0x7f7fffffu));
        value = low + (high - low) * ((float(rank - before) + 0.5) / float(histograms.v[offset + bin]));
    }
    if (of_depth) stats.depth_scale = value;
    else stats.median = value;
}
