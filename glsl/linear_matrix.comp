// Pointwise (1x1) convolution of one or two concatenated maps on cooperative matrices: act(film(W [a|b] + bias) + residual), the
// factors rounded to halves, the sums in 32-bit floats.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define EPILOGUE_ID 4         // after those of matrix.glsl
#include "shared/epilogue.glsl"
#include "shared/matrix.glsl"

layout(push_constant) uniform Push {
    Source src;
    Source src_b;         // read where src_b_channels is not 0
    Target dst;
    Weights weights;      // [bias | packed weights]
    Weights film;         // [gamma | beta] with FLAG_FILM
    Source residual;      // with FLAG_RESIDUAL
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

const uint INPUTS = 32u;                        // staged at a time
const uint INPUTS_STRIDE = INPUTS / 8u + 1u;
const uint WEIGHTS_AT = 4u * 64u * INPUTS_STRIDE;
const uint STAGED = WEIGHTS_AT + INPUTS * 5u;
#include "shared/matrix_dense.glsl"

// Vector `k` of a token's inputs, [src | src_b]; zeros beyond them.
vec4 input_vector(uint pixel, uint k) {
    if (k < src_channels) return LOAD(src, pixel * src_stride + k);
    k -= src_channels;
    return k < src_b_channels ? LOAD(src_b, pixel * src_b_stride + k) : vec4(0.0);
}

void finish(uvec2 at, uint channel, vec4 value) {
    uint pixel = at.y * width + at.x;
    if ((EPILOGUE & FLAG_FILM) != 0u) value = LOAD_WEIGHTS(film, channel) * value + LOAD_WEIGHTS(film, dst_channels + channel);
    if ((EPILOGUE & FLAG_RESIDUAL) != 0u) value += LOAD(residual, pixel * residual_stride + channel);
    STORE(dst, pixel * dst_stride + channel, activate(value, EPILOGUE));
}

void main() {
    uint slot = group_index() * SUBGROUPS + gl_SubgroupID;
    uint count = tiles_of(tile_count, flags, tiles);
    if (count == 0u) return;
    bool live = slot < count;
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint rows = gl_SubgroupID * TOKENS * INPUTS_STRIDE;
    uint inputs = src_channels + src_b_channels;
    uint first_weight = bias_vectors + gl_WorkGroupID.y * inputs * OUTPUTS;

    clear_sums();
    for (uint first = 0u; first < inputs; first += INPUTS / 4u) {
        barrier();
        for (uint i = gl_SubgroupInvocationID; i < TOKENS * INPUTS / 8u; i += LANES) {
            uint token = i / (INPUTS / 8u), part = i % (INPUTS / 8u);
            uint pixel = (origin.y + token / 8u) * width + origin.x + token % 8u;
            uint k = first + 2u * part;
            staged[rows + token * INPUTS_STRIDE + part] = to_halves(input_vector(pixel, k), input_vector(pixel, k + 1u));
        }
        for (uint i = gl_LocalInvocationID.x; i < INPUTS * OUTPUTS / 8u; i += INVOCATIONS) {
            uint row = i / (OUTPUTS / 8u), part = i % (OUTPUTS / 8u);
            uint k = 4u * first + row;
            STAGE_WEIGHTS(WEIGHTS_AT, row, part, first_weight + k * (OUTPUTS / 4u), k < 4u * inputs)
        }
        barrier();
        multiply_add(rows, INPUTS_STRIDE, WEIGHTS_AT, INPUTS);
    }
    FINISH_SUMS(finish)
}
