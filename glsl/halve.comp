// The mean of 2x2 tokens. GLOSS: of one image, and of what it was before it was divided by the albedo.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/kernels.glsl"
TEXELS_OF(0, src)
TEXELS_OF(1, albedo)

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Weights src;          // 32-bit floats
    Source albedo;        // read with FLAG_GLOSS
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;           // of the result
    uint src_stride;      // strides and channels in vectors of four
    uint dst_stride;
    uint channels;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint albedo_stride;
};

// What a pixel's sum is of the radiance as it is.
vec4 undivided(uint pixel) {
    vec4 divided = LOAD_WEIGHTS(src, pixel * src_stride);
    return vec4(divided.xyz * demodulator(LOAD(albedo, pixel * albedo_stride).xyz), divided.w);
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    at += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uint first = 2u * at.y * 2u * width + 2u * at.x;
    uint from = first * src_stride;
    uint below = from + 2u * width * src_stride;
    uint to = (at.y * width + at.x) * dst_stride;
    for (uint k = 0u; k < channels; ++k) {
        vec4 above = LOAD_WEIGHTS(src, from + k) + LOAD_WEIGHTS(src, from + src_stride + k);
        vec4 mean = 0.25 * (above + (LOAD_WEIGHTS(src, below + k) + LOAD_WEIGHTS(src, below + src_stride + k)));
        STORE(dst, to + k, mean);
    }
    if ((flags & FLAG_GLOSS) != 0u) {
        vec4 above = undivided(first) + undivided(first + 1u);
        STORE(dst, to + 1u, 0.25 * (above + (undivided(first + 2u * width) + undivided(first + 2u * width + 1u))));
    }
}
