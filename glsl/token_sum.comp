// Sums of runs of tokens, each brought to mean 0 and variance 1 over its channels first; one workgroup a run. Block by
// block an invocation finds the mean and the scale of one token, then takes four channels of every n-th; the
// invocations' sums are added in a fixed order. Only tokens that hold pixels of the unpadded frame count; where
// converged squares are left out, those of denoised squares, and in sums of their own those of the converged squares
// that stand for the others.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/converged.glsl"
#include "shared/norm.glsl"

layout(local_size_x = 256) in;

layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Sums { vec4 v[]; };

layout(push_constant) uniform Push {
    Source src;
    Sums dst;             // [sums][channels]; with a map the same of sampled squares behind
    Uints map;            // the squares: 1 denoised, 0 converged
    Uints counts;         // with a map: tokens of denoised and of sampled squares for every sum
    uint width;
    uint real_width;
    uint real_tokens;
    uint src_stride;      // strides and channel counts in vectors of four
    uint channels;
    uint tokens_per_sum;
    uint sums;
    uint map_columns;     // 0: no map
    uint token_pixels;    // a side
    uint pitch;           // of the sample
    uint skew;
    uint unused;
};

const uint LANES = 256u;
shared vec4 sums_of[LANES];
shared vec4 sampled_sums_of[LANES];
shared uint denoised_of[LANES];
shared uint sampled_of[LANES];
shared vec2 norms[LANES];     // of a block's tokens: mean, scale

uint first_of(uint token) {
    return (token / real_width * width + token % real_width) * src_stride;
}

// Two passes, so that a large common value costs no accuracy.
vec2 norm_of(uint token) {
    uint from = first_of(token);
    vec4 sum = vec4(0.0);
    for (uint c = 0u; c < channels; ++c) sum += LOAD(src, from + c);
    float mean = mean_of(sum, channels);
    vec4 squares = vec4(0.0);
    for (uint c = 0u; c < channels; ++c) {
        vec4 d = LOAD(src, from + c) - mean;
        squares += d * d;
    }
    return vec2(mean, scale_of(squares, channels));
}

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint run = group_index();
    uint ways = LANES / channels;
    uint channel = lane % channels;
    uint way = lane / channels;
    uint end = min((run + 1u) * tokens_per_sum, real_tokens);
    vec4 sum = vec4(0.0);
    vec4 sampled_sum = vec4(0.0);
    uint denoised_tokens = 0u;
    uint sampled_tokens = 0u;
    for (uint first = run * tokens_per_sum; first < end; first += LANES) {
        barrier();
        if (first + lane < end) norms[lane] = norm_of(first + lane);
        barrier();
        uint block_end = min(first + LANES, end);
        for (uint token = first + way; way < ways && token < block_end; token += ways) {
            bool denoised = true;
            bool sampled = false;
            if (map_columns > 0u) {
                uvec2 square = uvec2(token % real_width, token / real_width) * token_pixels / MAP_TILE;
                denoised = map.v[square.y * map_columns + square.x] != 0u;
                sampled = !denoised && is_sampled(square, pitch, skew);
            }
            if (!denoised && !sampled) continue;
            vec2 norm = norms[token - first];
            vec4 value = (LOAD(src, first_of(token) + channel) - norm.x) * norm.y;
            if (denoised) sum += value;
            else sampled_sum += value;
            denoised_tokens += denoised ? 1u : 0u;
            sampled_tokens += sampled ? 1u : 0u;
        }
    }
    sums_of[lane] = sum;
    sampled_sums_of[lane] = sampled_sum;
    denoised_of[lane] = denoised_tokens;
    sampled_of[lane] = sampled_tokens;
    barrier();
    if (way > 0u) return;
    for (uint other = channels + channel; other < ways * channels; other += channels) {
        sum += sums_of[other];
        sampled_sum += sampled_sums_of[other];
        denoised_tokens += denoised_of[other];
        sampled_tokens += sampled_of[other];
    }
    uint index = run * channels + channel;
    dst.v[index] = sum;
    if (map_columns > 0u) {
        dst.v[sums * channels + index] = sampled_sum;
        if (channel == 0u) {
            counts.v[2u * run] = denoised_tokens;
            counts.v[2u * run + 1u] = sampled_tokens;
        }
    }
}
