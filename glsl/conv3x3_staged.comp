// Dense 3x3 convolution of stride STRIDE, zero padding, with its epilogue: act(film(sum + bias) + residual), stored
// plain, pixel-shuffled or pixel-unshuffled.
//
// The tokens of two tiles and those around them are staged in shared memory, STEP vectors of input channels at a time,
// and the weights of one row of taps; what comes next is loaded while this is computed.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/epilogue.glsl"
const uint STEP = STRIDE == 1u ? 2u : 1u;
const uint FACTOR_ROWS = 3u * STEP * 4u;
#include "shared/staged_products.glsl"

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | packed weights]
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

#include "shared/conv_store.glsl"

const uint ROW = STEP == 1u ? 1u : STEP + 1u;    // of a token; several vectors are padded, to begin in different banks
const uint SIDE = 7u * STRIDE + 3u;              // of the tokens that a tile is computed from
const uint AROUND = TILES * SIDE * SIDE;
const uint INPUT_LOADS = (AROUND * STEP + INVOCATIONS - 1u) / INVOCATIONS;
shared vec4 inputs[AROUND * ROW];
vec4 next_inputs[INPUT_LOADS];

void fetch_inputs(uint first) {
    [[unroll]] for (uint n = 0u; n < INPUT_LOADS; ++n) {
        uint i = lane + n * INVOCATIONS, token = min(i / STEP, AROUND - 1u), k = first + i % STEP;
        uvec2 first_tap = origin_of(token / (SIDE * SIDE)) * STRIDE;
        ivec2 at = ivec2(first_tap + uvec2(token % SIDE, token / SIDE % SIDE)) - 1;
        bool inside = k < src_channels && all(greaterThanEqual(at, ivec2(0)));
        inside = inside && all(lessThan(at, ivec2(src_width, src_height)));
        next_inputs[n] = inside ? LOAD(src, uint(at.y * int(src_width) + at.x) * src_stride + k) : vec4(0.0);
    }
}

void stage_inputs() {
    [[unroll]] for (uint n = 0u; n < INPUT_LOADS; ++n) {
        uint i = lane + n * INVOCATIONS;
        if (i < AROUND * STEP) inputs[i / STEP * ROW + i % STEP] = next_inputs[n];
    }
}

// A row is of one tap of the row `ky`, one vector of input channels from `first` on and one channel of that.
#define PACKED_ROW(block, tap, k) (((block * 9u + (tap)) * src_channels + (k)) * 4u)
#define FACTOR(block, row, vector) \
    (first + (row) / 4u % STEP < src_channels ? LOAD_WEIGHTS(weights, bias_vectors + (vector) \
        + (PACKED_ROW(block, 3u * ky + (row) / (4u * STEP), first + (row) / 4u % STEP) + (row) % 4u) * PACKED) \
        : vec4(0.0))

void fetch_factors(uint first, uint ky) {
    FETCH_FACTORS
}

// Where the first tap of this invocation's token `p` is staged, from that of the first one on.
#define TO_TOKEN(p) (((p) / 4u * SIDE + (p) % 4u * 2u * STRIDE) * SIDE * ROW)

void main() {
    uint count = tiles_of(tile_count, flags, tiles), slot = group_index() * TILES;
    if (slot >= count) return;                                                       // whole groups only
    [[unroll]] for (uint t = 0u; t < TILES; ++t) {
        origins[t] = tile_origin(min(slot + t, count - 1u), first_tile, flags, tiles);
    }
    CLEAR_SUMS(weights)
    uint first_staged = (own_tokens / 8u * SIDE + own_tokens % 8u) * STRIDE * ROW;
    fetch_inputs(0u);
    fetch_factors(0u, 0u);
    for (uint k = 0u; k < src_channels; k += STEP) {
        uint vectors = min(STEP, src_channels - k);
        [[dont_unroll]] for (uint ky = 0u; ky < 3u; ++ky) {
            barrier();
            if (ky == 0u) stage_inputs();
            stage_factors();
            barrier();
            if (ky == 2u) {
                fetch_inputs(k + STEP);
                fetch_factors(k + STEP, 0u);
            } else {
                fetch_factors(k, ky + 1u);
            }
            [[dont_unroll]] for (uint kx = 0u; kx < 3u; ++kx) {
                [[dont_unroll]] for (uint i = 0u; i < vectors; ++i) {
                    uint tap = first_staged + (ky * SIDE + kx) * ROW + i;
#define STAGED(p) inputs[tap + TO_TOKEN(p)]
                    ADD_PRODUCTS((kx * STEP + i) * 4u, STAGED)
                }
            }
        }
    }

    [[unroll]] for (uint p = 0u; p < OWN; ++p) {
        uint token = OWN_TOKEN(p);
        if (slot + token / 64u >= count) continue;
        [[unroll]] for (uint n = 0u; n < 2u; ++n) {
            uint channel = first_output + n * OUTPUT_GROUPS;
            if (channel < dst_channels) store_result(token_at(token), channel, sums[2u * p + n]);
        }
    }
}
