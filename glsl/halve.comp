// The mean of 2x2 tokens.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
TEXELS_OF(0, src)

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;           // of the result
    uint src_stride;      // strides and channels in vectors of four
    uint dst_stride;
    uint channels;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    at += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uint from = (2u * at.y * 2u * width + 2u * at.x) * src_stride;
    uint below = from + 2u * width * src_stride;
    for (uint k = 0u; k < channels; ++k) {
        vec4 above = LOAD(src, from + k) + LOAD(src, from + src_stride + k);
        vec4 mean = 0.25 * (above + (LOAD(src, below + k) + LOAD(src, below + src_stride + k)));
        STORE(dst, (at.y * width + at.x) * dst_stride + k, mean);
    }
}
