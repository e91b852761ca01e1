// The mean of all tokens from its partial sums, and the matrix that makes [gamma | beta] of it. One workgroup.
#version 460
#include "shared/storage.glsl"

layout(local_size_x = 256) in;

layout(push_constant) uniform Push {
    ReadFloats partials;  // [sums][channels]
    ReadFloats weights;   // [bias | matrix]
    Floats dst;
    uint channels;        // at most 512
    uint outputs;
    uint sums;
    float inverse_tokens;
};

shared float segments[512];
shared float mean[512];

void main() {
    uint lane = gl_LocalInvocationID.x;
    // Narrow maps leave lanes over: several share a channel, each summing every n-th partial.
    uint ways = max(256u / channels, 1u);
    for (uint i = lane; i < channels * ways; i += 256u) {
        float sum = 0.0;
        for (uint s = i / channels; s < sums; s += ways) sum += partials.v[s * channels + i % channels];
        segments[i] = sum;
    }
    barrier();
    for (uint c = lane; c < channels; c += 256u) {
        float sum = 0.0;
        for (uint way = 0u; way < ways; ++way) sum += segments[way * channels + c];
        mean[c] = sum * inverse_tokens;
    }
    barrier();
    for (uint o = lane; o < outputs; o += 256u) {
        float sum = weights.v[o];
        for (uint c = 0u; c < channels; ++c) sum += weights.v[outputs + o * channels + c] * mean[c];
        dst.v[o] = sum;
    }
}
