// A small map made large: its borders stay at the borders, and what lies between repeats the half tile in its middle.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
TEXELS_OF(0, src)

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint src_width;
    uint src_height;
    uint width;
    uint height;
    uint src_stride;      // strides and channel counts in vectors of four
    uint dst_stride;
    uint channels;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

// Where position i of `size` comes from among `small`.
uint source_of(uint i, uint size, uint small) {
    uint middle = small / 2u;
    if (i < middle || size == small) return i;
    uint from_end = size - i;
    return from_end <= small - middle - 4u ? small - from_end : middle + (i - middle) % 4u;
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    at += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uvec2 from = uvec2(source_of(at.x, width, src_width), source_of(at.y, height, src_height));
    uint source = (from.y * src_width + from.x) * src_stride;
    uint target = (at.y * width + at.x) * dst_stride;
    for (uint c = 0u; c < channels; ++c) STORE(dst, target + c, LOAD(src, source + c));
}
