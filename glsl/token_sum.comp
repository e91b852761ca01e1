// Sums of runs of tokens, one workgroup a run: its invocations take four channels each of every n-th token, and their
// sums are added in a fixed order. Only tokens that hold pixels of the unpadded frame count; where converged squares
// are left out, those of denoised squares, and in sums of their own those of the converged squares that stand for the
// others.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/converged.glsl"

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
    for (uint token = run * tokens_per_sum + way; way < ways && token < end; token += ways) {
        uvec2 at = uvec2(token % real_width, token / real_width);
        bool denoised = true;
        bool sampled = false;
        if (map_columns > 0u) {
            uvec2 square = at * token_pixels / MAP_TILE;
            denoised = map.v[square.y * map_columns + square.x] != 0u;
            sampled = !denoised && is_sampled(square, pitch, skew);
        }
        if (!denoised && !sampled) continue;
        vec4 value = LOAD(src, (at.y * width + at.x) * src_stride + channel);
        if (denoised) sum += value;
        else sampled_sum += value;
        denoised_tokens += denoised ? 1u : 0u;
        sampled_tokens += sampled ? 1u : 0u;
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
