// Key and exposure of the frame from its tiles. One workgroup, fixed order.
#version 460
#include "shared/storage.glsl"
#include "shared/stats.glsl"

layout(local_size_x = 256) in;

layout(push_constant) uniform Push {
    ReadFloats src;
    Stats stats;
    uint tile_count;
    float fixed_exposure;     // 0: the frame's own
};

const float MIDDLE_GREY = 0.18;
// Keys whose exposure and reciprocal are still finite, normal floats.
const float MIN_KEY = 1e-30;
const float MAX_KEY = 1e36;

shared float sums[256];
shared uint counts[256];

void main() {
    uint lane = gl_LocalInvocationID.x;
    float sum = 0.0;
    uint count = 0u;
    for (uint i = lane; i < tile_count; i += 256u) {
        float value = src.v[i];
        if (value > -1e30) {
            sum += value;
            ++count;
        }
    }
    sums[lane] = sum;
    counts[lane] = count;
    barrier();
    for (uint width = 128u; width > 0u; width /= 2u) {
        if (lane < width) {
            sums[lane] += sums[lane + width];
            counts[lane] += counts[lane + width];
        }
        barrier();
    }
    if (lane == 0u) {
        float key = MIDDLE_GREY;
        if (counts[0] > 0u) key = clamp(stats.median * exp2(sums[0] / float(counts[0])), MIN_KEY, MAX_KEY);
        stats.key = key;
        stats.exposure = fixed_exposure > 0.0 ? fixed_exposure : MIDDLE_GREY / key;
    }
}
