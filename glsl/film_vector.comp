// The mean of all tokens from its partial sums, and the matrix that makes [gamma | beta] of it. One workgroup.
//
// Where only some tokens were computed, those of denoised squares count once, and those of sampled converged squares as
// often as it takes to stand for all converged ones; where none was sampled, the denoised ones stand for all.
#version 460
#include "shared/storage.glsl"

layout(local_size_x = 256) in;

layout(push_constant) uniform Push {
    ReadFloats partials;  // [sums][channels]; with counts the same of sampled squares behind
    ReadFloats weights;   // [bias | matrix]
    Floats dst;
    Uints counts;         // tokens of denoised and of sampled squares for every sum
    uint channels;        // at most 512
    uint outputs;
    uint sums;
    uint tokens;          // that the mean is of
    float inverse_tokens;
    uint counted;         // 1: there are counts
};

shared float segments[512];
shared float mean[512];
shared uint denoised_tokens;
shared uint sampled_tokens;

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint kinds = 1u;
    // Of the tokens of denoised and of sampled squares.
    float factors[2] = float[2](inverse_tokens, 0.0);
    if (counted != 0u) {
        if (lane == 0u) {
            denoised_tokens = 0u;
            sampled_tokens = 0u;
        }
        barrier();
        for (uint s = lane; s < sums; s += 256u) {
            atomicAdd(denoised_tokens, counts.v[2u * s]);
            atomicAdd(sampled_tokens, counts.v[2u * s + 1u]);
        }
        barrier();
        uint converged_tokens = tokens - denoised_tokens;
        if (sampled_tokens > 0u) {
            kinds = 2u;
            factors[1] = float(converged_tokens) / float(sampled_tokens) * inverse_tokens;
        } else if (converged_tokens > 0u) {
            factors[0] = 1.0 / float(denoised_tokens);
        }
    }
    // Narrow maps leave lanes over: several share a channel, each summing every n-th partial.
    uint ways = max(256u / channels, 1u);
    for (uint kind = 0u; kind < kinds; ++kind) {
        uint first = kind * sums * channels;
        for (uint i = lane; i < channels * ways; i += 256u) {
            float sum = 0.0;
            for (uint s = i / channels; s < sums; s += ways) sum += partials.v[first + s * channels + i % channels];
            segments[i] = sum;
        }
        barrier();
        for (uint c = lane; c < channels; c += 256u) {
            float sum = 0.0;
            for (uint way = 0u; way < ways; ++way) sum += segments[way * channels + c];
            mean[c] = kind == 0u ? sum * factors[0] : mean[c] + sum * factors[1];
        }
        barrier();
    }
    for (uint o = lane; o < outputs; o += 256u) {
        float sum = weights.v[o];
        for (uint c = 0u; c < channels; ++c) sum += weights.v[outputs + o * channels + c] * mean[c];
        dst.v[o] = sum;
    }
}
