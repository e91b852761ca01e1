// Dense 3x3 convolution, zero padding, stride STRIDE, on cooperative matrices: the factors rounded to halves, the sums in 32-bit
// floats; with the epilogue of the other convolutions.
//
// The inputs of one column of taps, kx, are staged as rows of eight tokens that lie STRIDE apart. So the tokens of a tile
// follow one another for every ky, and a matrix of any number of rows begins at any of them. For stride 2 the even rows come
// before the odd ones: then a tile's rows follow one another too.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define EPILOGUE_ID 4         // after those of matrix.glsl
#include "shared/epilogue.glsl"
#include "shared/matrix.glsl"

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | packed weights]
    Weights film;         // [gamma | beta] with FLAG_FILM
    Source residual;      // with FLAG_RESIDUAL
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

const uint INPUTS = 16u;                        // staged at a time
const uint INPUTS_STRIDE = INPUTS / 8u + 1u;
const uint SOURCE_ROWS = 7u * STRIDE + 3u;
const uint EVEN_ROWS = 9u;                      // of stride 2
const uint WEIGHTS_AT = 4u * SOURCE_ROWS * 8u * INPUTS_STRIDE;
const uint STAGED = WEIGHTS_AT + 3u * INPUTS * 5u;
#include "shared/matrix_dense.glsl"

// Where a row of the source that begins `row` below the tile's first one is staged.
uint staged_row(uint row) {
    return STRIDE == 1 ? row : (row & 1u) * EVEN_ROWS + row / 2u;
}

void main() {
    uint slot = group_index() * SUBGROUPS + gl_SubgroupID;
    uint count = tiles_of(tile_count, flags, tiles);
    if (count == 0u) return;
    bool live = slot < count;
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint rows = gl_SubgroupID * SOURCE_ROWS * 8u * INPUTS_STRIDE;
    uint first_weight = bias_vectors + gl_WorkGroupID.y * 9u * src_channels * OUTPUTS;

    clear_sums();
    for (uint first = 0u; first < src_channels; first += INPUTS / 4u) {
        for (uint kx = 0u; kx < 3u; ++kx) {
            barrier();
            ivec2 corner = ivec2(origin) * STRIDE + ivec2(int(kx) - 1, -1);
            for (uint i = gl_SubgroupInvocationID; i < SOURCE_ROWS * 8u * INPUTS / 8u; i += LANES) {
                uint token = i / (INPUTS / 8u), part = i % (INPUTS / 8u);
                ivec2 at = corner + ivec2(token % 8u * STRIDE, token / 8u);
                bool inside = at.x >= 0 && at.x < int(src_width) && at.y >= 0 && at.y < int(src_height);
                uint k = first + 2u * part;
                uint from = inside ? uint(at.y * int(src_width) + at.x) * src_stride + k : 0u;
                vec4 low = inside && k < src_channels ? LOAD(src, from) : vec4(0.0);
                vec4 high = inside && k + 1u < src_channels ? LOAD(src, from + 1u) : vec4(0.0);
                staged[rows + (staged_row(token / 8u) * 8u + token % 8u) * INPUTS_STRIDE + part] = to_halves(low, high);
            }
            for (uint i = gl_LocalInvocationID.x; i < 3u * INPUTS * OUTPUTS / 8u; i += INVOCATIONS) {
                uint row = i / (OUTPUTS / 8u), part = i % (OUTPUTS / 8u);
                uint k = 4u * first + row % INPUTS;
                uint tap = row / INPUTS * 3u + kx;
                uint from = first_weight + (tap * 4u * src_channels + k) * (OUTPUTS / 4u);
                STAGE_WEIGHTS(WEIGHTS_AT, row, part, from, k < 4u * src_channels)
            }
            barrier();
            [[unroll]] for (uint ky = 0u; ky < 3u; ++ky) {
                multiply_add(
                    rows + staged_row(ky) * 8u * INPUTS_STRIDE, INPUTS_STRIDE,
                    WEIGHTS_AT + ky * INPUTS * OUTPUTS_STRIDE, INPUTS);
            }
        }
    }
    FINISH_SUMS(store_result)
}
