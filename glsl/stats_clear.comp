// Zeroes a histogram.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"

layout(local_size_x = 256) in;

layout(push_constant) uniform Push {
    Uints histogram;
    uint count;
    uint unused;
};

void main() {
    uint index = group_index() * 256u + gl_LocalInvocationID.x;
    if (index < count) histogram.v[index] = 0u;
}
