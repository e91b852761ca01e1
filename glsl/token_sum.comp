// Sums of runs of tokens, four channels an invocation. Only tokens that hold pixels of the unpadded frame count; where quiet squares
// are left out, those of denoised squares, and in sums of their own those of the quiet squares that stand for the others.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/quiet.glsl"

layout(local_size_x = 64) in;

layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Sums { vec4 v[]; };

layout(push_constant) uniform Push {
    Source src;
    Sums dst;             // [sums][channels]; with a map the same of sampled squares behind
    Uints map;            // the squares: 1 denoised, 0 quiet
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

void add(inout vec4 sum, uint token, uint tokens, uint channel) {
    for (uint i = 0u; i < tokens; ++i) sum += LOAD(src, (token + i) * src_stride + channel);
}

void main() {
    uint index = group_index() * 64u + gl_LocalInvocationID.x;
    if (index >= sums * channels) return;
    uint channel = index % channels;
    uint token = index / channels * tokens_per_sum;
    uint end = min(token + tokens_per_sum, real_tokens);
    uint x = token % real_width;
    uint y = token / real_width;
    uint side = max(MAP_TILE / token_pixels, 1u);
    vec4 sum = vec4(0.0);
    vec4 sampled_sum = vec4(0.0);
    uint denoised_tokens = 0u;
    uint sampled_tokens = 0u;
    while (token < end) {
        // Of one row, and with a map of one square.
        uint tokens = min(end - token, real_width - x);
        bool denoised = true;
        bool sampled = false;
        if (map_columns > 0u) {
            tokens = min(tokens, side - x % side);
            uvec2 square = uvec2(x, y) * token_pixels / MAP_TILE;
            denoised = map.v[square.y * map_columns + square.x] != 0u;
            sampled = !denoised && is_sampled(square, pitch, skew);
        }
        if (denoised) {
            add(sum, y * width + x, tokens, channel);
            denoised_tokens += tokens;
        } else if (sampled) {
            add(sampled_sum, y * width + x, tokens, channel);
            sampled_tokens += tokens;
        }
        token += tokens;
        x += tokens;
        if (x == real_width) {
            x = 0u;
            ++y;
        }
    }
    dst.v[index] = sum;
    if (map_columns > 0u) {
        dst.v[sums * channels + index] = sampled_sum;
        if (channel == 0u) {
            counts.v[2u * (index / channels)] = denoised_tokens;
            counts.v[2u * (index / channels) + 1u] = sampled_tokens;
        }
    }
}
