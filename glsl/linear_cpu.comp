// Pointwise (1x1) convolution of one or two concatenated maps, for CPU drivers: act(film(W [a|b] + bias) + residual).
//
// NORM: every token of the one map is brought to mean 0 and variance 1 over its channels first; gain and bias are in
// the weights.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/epilogue.glsl"
const int PIXELS = TX * TY;
TEXELS_OF(0, src)
TEXELS_OF(1, weights)
TEXELS_OF(2, film)
TEXELS_OF(3, residual)
TEXELS_OF(4, src_b)
#include "shared/microkernel.glsl"

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Source src_b;         // read where src_b_channels is not 0
    Target dst;
    Weights weights;      // [bias | packed weights]
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

const uint LANES_X = 8 / TX;
const uint LANES = 64 / PIXELS;

vec4 activations[PIXELS];

#ifdef NORM
#include "shared/norm.glsl"
float means[PIXELS];
float scales[PIXELS];

void find_norm(int p, uint from) {
    vec4 sum = vec4(0.0);
    for (uint k = 0u; k < src_channels; ++k) sum += LOAD(src, from + k);
    means[p] = mean_of(sum, src_channels);
    vec4 squares = vec4(0.0);
    for (uint k = 0u; k < src_channels; ++k) {
        vec4 d = LOAD(src, from + k) - means[p];
        squares += d * d;
    }
    scales[p] = scale_of(squares, src_channels);
}
#define NORMED(p) ((activations[p] - means[p]) * scales[p])
#else
#define NORMED(p) activations[p]
#endif

void main() {
    uint slot = group_index() * (64u / LANES) + gl_LocalInvocationID.x / LANES;
    uint count = tiles_of(tile_count, flags, tiles);
    bool live = slot < count;
    LEAVE_UNLESS(live)
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint lane = gl_LocalInvocationID.x % LANES;
    uvec2 base = origin + uvec2(lane % LANES_X, lane / LANES_X) * uvec2(TX, TY);
    uint tile_n = gl_WorkGroupID.y;

    clear_accumulators(weights, tile_n);
    uint block_base = bias_vectors + tile_n * (src_channels + src_b_channels) * BLOCK;
    uint pixels[PIXELS];
    [[unroll]] for (int p = 0; p < PIXELS; ++p) pixels[p] = (base.y + p / TX) * width + base.x + p % TX;
#ifdef NORM
    [[unroll]] for (int p = 0; p < PIXELS; ++p) find_norm(p, pixels[p] * src_stride);
#endif
#define ACTIVATION(p) NORMED(p)
#define ADD_SOURCE(source) \
    for (uint k = 0u; k < source##_channels; ++k) { \
        [[unroll]] for (int p = 0; p < PIXELS; ++p) activations[p] = LOAD(source, pixels[p] * source##_stride + k); \
        MULTIPLY_ADD(weights, block_base, ACTIVATION) \
        block_base += BLOCK; \
    }
    ADD_SOURCE(src)
    ADD_SOURCE(src_b)
    if (!live) return;

    [[unroll]] for (int n = 0; n < NV; ++n) {
        uint channel = tile_n * NV + n;
        if (channel >= dst_channels) continue;
        [[unroll]] for (int p = 0; p < PIXELS; ++p) {
            vec4 value = accumulators[p * NV + n];
            if ((EPILOGUE & FLAG_FILM) != 0u) {
                value = LOAD_WEIGHTS(film, channel) * value + LOAD_WEIGHTS(film, dst_channels + channel);
            }
            if ((EPILOGUE & FLAG_RESIDUAL) != 0u) value += LOAD(residual, pixels[p] * residual_stride + channel);
            STORE(dst, pixels[p] * dst_stride + channel, activate(value, EPILOGUE));
        }
    }
}
