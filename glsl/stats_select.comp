// The median luminance, or the 99.9th percentile of depth, from its histogram, interpolated within a bin. One
// workgroup.
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

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Vectors { uvec4 v[]; };

const uint LANES = 256u;
const uint PER_LANE = BINS / LANES;

shared uint ends[LANES];                        // how many values there are up to the lane's own last one
shared uint found_segment;
shared uint found_before;

// Makes running sums of `own` over the lanes.
void running_sums(uint lane, uint own) {
    ends[lane] = own;
    barrier();
    for (uint step = 1u; step < LANES; step *= 2u) {
        uint before = lane >= step ? ends[lane - step] : 0u;
        barrier();
        ends[lane] += before;
        barrier();
    }
}

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint count = 0u;
    Vectors vectors = Vectors(histogram);
    for (uint i = 0u; i < PER_LANE / 4u; ++i) {
        uvec4 four = vectors.v[lane * PER_LANE / 4u + i];
        count += four.x + four.y + four.z + four.w;
    }
    running_sums(lane, count);
    uint total = ends[LANES - 1u];
    bool depth = of_depth != 0u;
    if (total == 0u) {
        if (lane == 0u) dst.v[0] = depth ? 1.0 : 0.0;
        return;
    }
    // 999/1000 in integers: floats do not hold every count.
    uint last = total - 1u;
    uint rank = depth ? last - (last + 999u) / 1000u : last / 2u;
    if (ends[lane] > rank && ends[lane] - count <= rank) {
        found_segment = lane;
        found_before = ends[lane] - count;
    }
    barrier();
    uint first = found_segment * PER_LANE;
    rank -= found_before;
    barrier();
    count = lane < PER_LANE ? histogram.v[first + lane] : 0u;
    running_sums(lane, count);
    if (count == 0u || ends[lane] <= rank || ends[lane] - count > rank) return;
    uint bin = first + lane;
    uint first_bin = depth ? DEPTH_FIRST : 0u;
    uint shift = depth ? DEPTH_SHIFT : LUMINANCE_SHIFT;
    float low = uintBitsToFloat((bin + first_bin) << shift);
    // The last finite bin of luminance ends at the largest float.
    float high = uintBitsToFloat(min((bin + first_bin + 1u) << shift, 0x7f7fffffu));
    dst.v[0] = low + (high - low) * ((float(rank - (ends[lane] - count)) + 0.5) / float(count));
}
