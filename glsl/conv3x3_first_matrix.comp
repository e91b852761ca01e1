// Dense 3x3 convolution of a map of four channels of 32-bit floats, zero padding, on cooperative matrices, the factors
// rounded to halves, the sums in 32-bit floats; with the epilogue of the other convolutions. The nine taps of a token
// are its row of inputs.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define EPILOGUE_ID 4         // after those of matrix.glsl
#include "shared/epilogue.glsl"
layout(constant_id = 5) const uint TILES = 4;   // of a workgroup: 1, 2 or 4
layout(constant_id = 6) const uint HALVES = 1;  // subgroups that share the tokens of a tile: 1 or 2
#define SUBGROUPS (4u * HALVES)
#include "shared/matrix.glsl"

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | halves, packed]
    Weights film;         // [gamma | beta] with FLAG_FILM
    Residual residual;    // with FLAG_RESIDUAL
    TileList tiles;       // with FLAG_TILE_LIST
    uint src_width;
    uint src_height;
    uint src_stride;      // strides and channel counts in vectors of four
    uint src_channels;
    uint dst_width;       // of the convolution's result, before any shuffle
    uint dst_stride;
    uint dst_channels;
    uint residual_stride;
    uint bias_vectors;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

const uint INPUTS = 48u;                        // nine taps of four channels, and zeros
const uint VECTORS = INPUTS / 8u;               // of a token; not padded, or shared memory would not hold four tiles
const uint STAGED_INPUTS = TILES * 64u * VECTORS;
const uint STAGED_BLOCKS = 4u / TILES * INPUTS / 16u;
const uint SIDE = 10u;                          // of a tile with the pixels around it
const uint COLORS = SIDE * SIDE / 2u;           // vectors of them
const uint COLORS_AT = STAGED_INPUTS + STAGED_BLOCKS * 64u;
#define STAGED_AT_LEAST (COLORS_AT + TILES * COLORS)
#include "shared/matrix_dense.glsl"
#include "shared/conv_store.glsl"
#include "shared/color_taps.glsl"

void main() {
    uint slot = group_index() * TILES + own_tile;
    uint count = tiles_of(tile_count, flags, tiles);
    if (group_index() * TILES >= count) return;                                      // whole groups only
    bool live = slot < count;
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint rows = own_tile * TOKENS * VECTORS, colors = COLORS_AT + own_tile * COLORS;

    stage_colors(colors, SIDE, ivec2(origin) - 1, ivec2(src_width, src_height));
    const uint BLOCKS = INPUTS / 16u;
    stage_weights(Vectors(weights), 0u, BLOCKS, 0u, BLOCKS, BLOCKS);
    clear_sums();
    barrier();
    for (uint i = tile_lane; i < TOKENS * VECTORS; i += TILE_LANES) {
        uint token = i % TOKENS, part = i / TOKENS;
        staged[rows + token * VECTORS + part] = color_taps(colors, SIDE, token / 8u * SIDE + token % 8u, part);
    }
    barrier();
    if (own_outputs * (OUTPUTS / 4u) < dst_channels) multiply_add(rows, VECTORS, own_split * BLOCKS, INPUTS);
    FINISH_SUMS(store_result)
}
