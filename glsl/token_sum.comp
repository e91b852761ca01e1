// Sums of runs of tokens, four channels an invocation. Only tokens that hold pixels of the unpadded frame count.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"

layout(local_size_x = 64) in;

layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Sums { vec4 v[]; };

layout(push_constant) uniform Push {
    Source src;
    Sums dst;             // [sums][channels]
    uint width;
    uint real_width;
    uint real_tokens;
    uint src_stride;      // strides and channel counts in vectors of four
    uint channels;
    uint tokens_per_sum;
    uint sums;
    uint unused;
};

void main() {
    uint index = group_index() * 64u + gl_LocalInvocationID.x;
    if (index >= sums * channels) return;
    uint channel = index % channels;
    uint token = index / channels * tokens_per_sum;
    uint end = min(token + tokens_per_sum, real_tokens);
    uint x = token % real_width;
    uint y = token / real_width;
    vec4 sum = vec4(0.0);
    for (; token < end; ++token) {
        sum += LOAD(src, (y * width + x) * src_stride + channel);
        if (++x == real_width) {
            x = 0u;
            ++y;
        }
    }
    dst.v[index] = sum;
}
