// Zeros in the tiles of a list, whose tokens may be larger or smaller than the map's. One group a tile.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Target dst;
    TileList tiles;
    uint width;
    uint dst_stride;      // in vectors of four, like the channels
    uint channels;
    uint side;            // tokens of the map a tile
    uint tile_count;
    uint flags;
    uint first_tile;      // x | y << 16, in half tiles
    uint unused;
};

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 origin = tile_origin(slot, first_tile, flags, tiles) * side / 8u;
    // A power of two: CPU drivers divide slowly.
    uint shift = uint(findLSB(side));
    for (uint token = gl_LocalInvocationID.x; token < side * side; token += 64u) {
        uvec2 at = origin + uvec2(token & (side - 1u), token >> shift);
        uint first = (at.y * width + at.x) * dst_stride;
        for (uint c = 0u; c < channels; ++c) STORE(dst, first + c, vec4(0.0));
    }
}
