// Pointwise (1x1) convolution of one or two concatenated maps of halves on cooperative matrices:
// act(film(W [a|b] + bias) + residual), the sums in 32-bit floats.
//
// NORM: every token of the one map is brought to mean 0 and variance 1 over its channels first; gain and bias are in
// the weights.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define EPILOGUE_ID 4         // after those of matrix.glsl
#include "shared/epilogue.glsl"
layout(constant_id = 5) const uint TILES = 4;   // of a workgroup: 1, 2 or 4
layout(constant_id = 6) const uint HALVES = 1;  // subgroups that share the tokens of a tile: 1 or 2
#define SUBGROUPS (4u * HALVES)
#include "shared/matrix.glsl"
layout(constant_id = 7) const uint INPUTS = 32; // staged at a time, a divisor of all; with NORM all of them

layout(push_constant) uniform Push {
    Source src;
    Source src_b;         // read where src_b_channels is not 0
    Target dst;
    Weights weights;      // [bias | halves, packed]
    Weights film;         // [gamma | beta] with FLAG_FILM
    Residual residual;    // with FLAG_RESIDUAL
    TileList tiles;       // with FLAG_TILE_LIST
    uint src_stride;      // strides and channel counts in vectors of four
    uint src_channels;
    uint src_b_stride;
    uint src_b_channels;
    uint width;
    uint dst_stride;
    uint dst_channels;
    uint residual_stride;
    uint bias_vectors;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

const uint VECTORS = INPUTS / 8u;               // of eight halves
const uint STRIDE = VECTORS + 1u;
const uint STAGED_INPUTS = TILES * 64u * STRIDE;
#ifdef NORM
const uint ROWS_AT_ONCE = INPUTS < 32u ? INPUTS : 32u;   // of weights
#else
const uint ROWS_AT_ONCE = INPUTS;
#endif
const uint STAGED_BLOCKS = 4u / TILES * ROWS_AT_ONCE / 16u;
#include "shared/matrix_dense.glsl"

#ifdef NORM
#define NORMED_VECTORS VECTORS
#include "shared/stage_normed.glsl"
#else
const uint STAGED = TOKENS * VECTORS;           // vectors of a tile
const uint LOADS = 4u;                          // of an invocation at a time

// Loads come before the stores, so that they overlap.
void stage(uint rows, uvec2 origin, uint first) {
    Vectors from = Vectors(src), from_b = Vectors(src_b);
    [[dont_unroll]] for (uint begin = tile_lane; begin < STAGED; begin += LOADS * TILE_LANES) {
        uvec4 halves[LOADS];
        [[unroll]] for (uint n = 0u; n < LOADS; ++n) {
            uint i = min(begin + n * TILE_LANES, STAGED - 1u), token = i / VECTORS;
            uint pixel = (origin.y + token / 8u) * width + origin.x + token % 8u;
            uint k = first + i % VECTORS;
            uint k_b = k - src_channels / 2u;
            halves[n] = uvec4(0u);
            if (k < src_channels / 2u) halves[n] = from.v[pixel * (src_stride / 2u) + k];
            else if (k_b < src_b_channels / 2u) halves[n] = from_b.v[pixel * (src_b_stride / 2u) + k_b];
        }
        [[unroll]] for (uint n = 0u; n < LOADS; ++n) {
            uint i = begin + n * TILE_LANES;
            if (i < STAGED) staged[rows + i / VECTORS * STRIDE + i % VECTORS] = halves[n];
        }
    }
}
#endif

void finish(uvec2 at, uint channel, vec4 value) {
    uint pixel = at.y * width + at.x;
    if ((EPILOGUE & FLAG_FILM) != 0u) {
        value = LOAD_WEIGHTS(film, channel) * value + LOAD_WEIGHTS(film, dst_channels + channel);
    }
    if ((EPILOGUE & FLAG_RESIDUAL) != 0u) value += LOAD(residual, pixel * residual_stride + channel);
    STORE(dst, pixel * dst_stride + channel, activate(value, EPILOGUE));
}

void main() {
    uint slot = group_index() * TILES + own_tile;
    uint count = tiles_of(tile_count, flags, tiles);
    if (group_index() * TILES >= count) return;                                      // whole groups only
    bool live = slot < count;
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint rows = own_tile * TOKENS * STRIDE;
    uint inputs = (4u * (src_channels + src_b_channels) + INPUTS - 1u) / INPUTS * INPUTS;
    bool computes = live && own_outputs * (OUTPUTS / 4u) < dst_channels;
    const uint BLOCKS = ROWS_AT_ONCE / 16u;

    clear_sums();
#ifdef NORM
    stage_normed(Vectors(src), src_stride, rows, STRIDE, origin);
#endif
    for (uint first = 0u; first < inputs; first += ROWS_AT_ONCE) {
        barrier();
#ifdef NORM
        uint at = rows + first / 8u;
#else
        uint at = rows;
        stage(rows, origin, first / 8u);
#endif
        stage_weights(Vectors(weights), first / 16u, inputs / 16u, 0u, BLOCKS, BLOCKS);
        barrier();
        if (computes) multiply_add(at, STRIDE, own_split * BLOCKS, ROWS_AT_ONCE);
    }
    FINISH_SUMS(finish)
}
