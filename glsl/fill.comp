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
    for (uint i = gl_LocalInvocationID.x; i < side * side * channels; i += 64u) {
        uint token = i / channels;
        uvec2 at = origin + uvec2(token % side, token / side);
        STORE(dst, (at.y * width + at.x) * dst_stride + i % channels, vec4(0.0));
    }
}
