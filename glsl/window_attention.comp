// Joint attention of one 8x8 window and one head; the 64x64 scores stay in shared memory.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
TEXELS_OF(0, x)
TEXELS_OF(1, f)

layout(local_size_x = 256) in;

layout(push_constant) uniform Push {
    Source x;             // [Q | K | V], head-major
    Source f;             // [Qf | Kf], head-major
    ReadFloats bias;      // 228 values a head
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint x_stride;        // strides and widths in vectors of four
    uint f_stride;
    uint dst_stride;
    uint heads;
    uint key_vectors;
    uint value_vectors;
    float scale;          // 1 / sqrt(d)
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

const uint TOKENS = 64u;
const uint BIAS_TABLE_STRIDE = 228u;

shared float scores[TOKENS * TOKENS];      // [query][key]
shared float inverse_sums[TOKENS];

uint window_pixel;

uint token_pixel(uint token) {
    return window_pixel + (token / 8u) * width + token % 8u;
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;                          // whole groups only
    uint head = gl_WorkGroupID.y;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    window_pixel = at.y * width + at.x;
    uint lane = gl_LocalInvocationID.x;

    // Scores: an invocation computes 4 queries x 4 keys.
    uint query = lane / 16u * 4u;
    uint key = lane % 16u * 4u;
    uint query_pixels[4];
    uint key_pixels[4];
    float sx[16];
    float sf[16];
    [[unroll]] for (uint i = 0u; i < 4u; ++i) {
        query_pixels[i] = token_pixel(query + i);
        key_pixels[i] = token_pixel(key + i);
    }
    [[unroll]] for (uint i = 0u; i < 16u; ++i) {
        sx[i] = 0.0;
        sf[i] = 0.0;
    }
    uint q_first = head * key_vectors;
    uint k_first = (heads + head) * key_vectors;
    for (uint c = 0u; c < key_vectors; ++c) {
        vec4 q[4], k[4];
        [[unroll]] for (uint i = 0u; i < 4u; ++i) {
            q[i] = LOAD(x, query_pixels[i] * x_stride + q_first + c);
            k[i] = LOAD(x, key_pixels[i] * x_stride + k_first + c);
        }
        [[unroll]] for (uint i = 0u; i < 16u; ++i) sx[i] += dot(q[i / 4u], k[i % 4u]);
        [[unroll]] for (uint i = 0u; i < 4u; ++i) {
            q[i] = LOAD(f, query_pixels[i] * f_stride + q_first + c);
            k[i] = LOAD(f, key_pixels[i] * f_stride + k_first + c);
        }
        [[unroll]] for (uint i = 0u; i < 16u; ++i) sf[i] += dot(q[i / 4u], k[i % 4u]);
    }
    [[unroll]] for (uint i = 0u; i < 16u; ++i) {
        uint from = query + i / 4u;
        uint to = key + i % 4u;
        // Query minus key position, each in -7..7.
        uint dy = from / 8u + 7u - to / 8u;
        uint dx = from % 8u + 7u - to % 8u;
        float b = bias.v[head * BIAS_TABLE_STRIDE + dy * 15u + dx];
        scores[from * TOKENS + to] = (sx[i] * scale + b) * (sf[i] * scale + b);
    }
    barrier();

    // Softmax: an invocation owns a row. Order is fixed, so are the bits. The values are divided by the sum at the end.
    if (lane < TOKENS) {
        uint row = lane * TOKENS;
        float top = scores[row];
        for (uint i = 1u; i < TOKENS; ++i) top = max(top, scores[row + i]);
        float sum = 0.0;
        for (uint i = 0u; i < TOKENS; ++i) {
            float e = exp(scores[row + i] - top);
            scores[row + i] = e;
            sum += e;
        }
        inverse_sums[lane] = 1.0 / sum;
    }
    barrier();

    // Values: an invocation computes 4 queries x 4 channels at a time.
    uint v_first = 2u * heads * key_vectors + head * value_vectors;
    for (uint task = lane; task < 16u * value_vectors; task += 256u) {
        uint c = task / 16u;
        uint first = task % 16u * 4u;
        vec4 sums[4];
        [[unroll]] for (uint i = 0u; i < 4u; ++i) sums[i] = vec4(0.0);
        for (uint t = 0u; t < TOKENS; ++t) {
            vec4 value = LOAD(x, token_pixel(t) * x_stride + v_first + c);
            [[unroll]] for (uint i = 0u; i < 4u; ++i) sums[i] += scores[(first + i) * TOKENS + t] * value;
        }
        [[unroll]] for (uint i = 0u; i < 4u; ++i) {
            uint to = token_pixel(first + i) * dst_stride + head * value_vectors + c;
            STORE(dst, to, sums[i] * inverse_sums[first + i]);
        }
    }
}
