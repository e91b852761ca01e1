// Layer normalisation of every token over its channels: two passes over the token, mean first, so that a large common
// value costs no accuracy.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/norm.glsl"
TEXELS_OF(0, src)
TEXELS_OF(1, weights)

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [gain | bias]
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint src_stride;      // strides and channel counts in vectors of four
    uint dst_stride;
    uint channels;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

#ifdef TEXELS
void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    at += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uint pixel = at.y * width + at.x;
    uint from = pixel * src_stride;

    vec4 sum = vec4(0.0);
    for (uint c = 0u; c < channels; ++c) sum += LOAD(src, from + c);
    float mean = mean_of(sum, channels);
    vec4 squares = vec4(0.0);
    for (uint c = 0u; c < channels; ++c) {
        vec4 d = LOAD(src, from + c) - mean;
        squares += d * d;
    }
    float scale = scale_of(squares, channels);
    for (uint c = 0u; c < channels; ++c) {
        vec4 value = (LOAD(src, from + c) - mean) * scale;
        STORE(dst, pixel * dst_stride + c, value * LOAD_WEIGHTS(weights, c) + LOAD_WEIGHTS(weights, channels + c));
    }
}
#else
// Eight invocations share a token, so that what they load lies side by side.
const uint SHARE = 8u;
shared vec4 parts[64];

// The sum over the invocations that share a token, in a fixed order.
vec4 share_sum(vec4 part) {
    uint lane = gl_LocalInvocationID.x;
    parts[lane] = part;
    barrier();
    vec4 sum = vec4(0.0);
    for (uint i = 0u; i < SHARE; ++i) sum += parts[lane / SHARE * SHARE + i];
    barrier();
    return sum;
}

void main() {
    // A workgroup takes a row of a tile.
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;                          // whole groups only
    uvec2 at = tile_origin(slot, first_tile, flags, tiles) + uvec2(gl_LocalInvocationID.x / SHARE, gl_WorkGroupID.y);
    uint pixel = at.y * width + at.x;
    uint from = pixel * src_stride;
    uint first = gl_LocalInvocationID.x % SHARE;

    vec4 sum = vec4(0.0);
    for (uint c = first; c < channels; c += SHARE) sum += LOAD(src, from + c);
    float mean = mean_of(share_sum(sum), channels);
    vec4 squares = vec4(0.0);
    for (uint c = first; c < channels; c += SHARE) {
        vec4 d = LOAD(src, from + c) - mean;
        squares += d * d;
    }
    float scale = scale_of(share_sum(squares), channels);
    for (uint c = first; c < channels; c += SHARE) {
        vec4 value = (LOAD(src, from + c) - mean) * scale;
        STORE(dst, pixel * dst_stride + c, value * LOAD_WEIGHTS(weights, c) + LOAD_WEIGHTS(weights, channels + c));
    }
}
#endif
