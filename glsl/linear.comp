// Pointwise (1x1) convolution of one or two concatenated maps: act(film(W [a|b] + bias) + residual).
//
// NORM: every token of the one map is brought to mean 0 and variance 1 over its channels first; gain and bias are in
// the weights.
//
// Input channels are staged in shared memory, STEP vectors of them at a time; those of the next step are loaded while
// this one is computed.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/epilogue.glsl"
const uint STEP = 4u;
const uint FACTOR_ROWS = 4u * STEP;
#include "shared/staged_products.glsl"

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

const uint ROW = STEP + 1u;                      // of a token, padded so that rows begin in different banks
const uint INPUT_LOADS = TOKENS * STEP / INVOCATIONS;
shared vec4 inputs[TOKENS * ROW];

uint pixel_of(uint token) {
    uvec2 at = token_at(token);
    return at.y * width + at.x;
}

#ifdef NORM
#include "shared/norm.glsl"
const uint SHARE = 8u;                           // invocations that share a token, so that loads lie side by side
shared float means[TOKENS];
shared float scales[TOKENS];

// Parts of a token's sum, each of one invocation, and their sum in a fixed order.
void put_part(uint token, uint share, vec4 part) {
    inputs[token * ROW + share / 4u][share % 4u] = part.x + part.y + part.z + part.w;
}
vec4 parts_of(uint token) {
    return inputs[token * ROW] + inputs[token * ROW + 1u];
}

void find_norms() {
    uint share = lane % SHARE;
    for (uint token = lane / SHARE; token < TOKENS; token += INVOCATIONS / SHARE) {
        uint from = pixel_of(token) * src_stride;
        vec4 sum = vec4(0.0);
        for (uint k = share; k < src_channels; k += SHARE) sum += LOAD(src, from + k);
        put_part(token, share, sum);
    }
    barrier();
    for (uint token = lane; token < TOKENS; token += INVOCATIONS) {
        means[token] = mean_of(parts_of(token), src_channels);
    }
    barrier();
    for (uint token = lane / SHARE; token < TOKENS; token += INVOCATIONS / SHARE) {
        uint from = pixel_of(token) * src_stride;
        vec4 squares = vec4(0.0);
        for (uint k = share; k < src_channels; k += SHARE) {
            vec4 d = LOAD(src, from + k) - means[token];
            squares += d * d;
        }
        put_part(token, share, squares);
    }
    barrier();
    for (uint token = lane; token < TOKENS; token += INVOCATIONS) {
        scales[token] = scale_of(parts_of(token), src_channels);
    }
    barrier();
}
#define NORMED(token, value) (((value) - means[token]) * scales[token])
#else
#define NORMED(token, value) (value)
#endif

vec4 next_inputs[INPUT_LOADS];
uint pixels[INPUT_LOADS];                        // of the tokens that this invocation loads

#define FACTOR(block, row, vector) \
    (first + (row) / 4u < all ? LOAD_WEIGHTS(weights, bias_vectors + ((block * all + first) * 4u + (row)) * PACKED \
        + (vector)) : vec4(0.0))

// Loads what a step from input vector `first` on takes; zeros beyond the last.
void fetch(uint first) {
    uint all = src_channels + src_b_channels;
    [[unroll]] for (uint n = 0u; n < INPUT_LOADS; ++n) {
        uint i = lane + n * INVOCATIONS, k = first + i % STEP;
        vec4 value = vec4(0.0);
        if (k < src_channels) {
            value = NORMED(i / STEP, LOAD(src, pixels[n] * src_stride + k));
        } else if (k < all) {
            value = LOAD(src_b, pixels[n] * src_b_stride + k - src_channels);
        }
        next_inputs[n] = value;
    }
    FETCH_FACTORS
}

void stage() {
    [[unroll]] for (uint n = 0u; n < INPUT_LOADS; ++n) {
        uint i = lane + n * INVOCATIONS;
        inputs[i / STEP * ROW + i % STEP] = next_inputs[n];
    }
    stage_factors();
}

void main() {
    uint count = tiles_of(tile_count, flags, tiles), slot = group_index() * TILES;
    if (slot >= count) return;                                                       // whole groups only
    [[unroll]] for (uint t = 0u; t < TILES; ++t) {
        origins[t] = tile_origin(min(slot + t, count - 1u), first_tile, flags, tiles);
    }
#ifdef NORM
    find_norms();
#endif
    CLEAR_SUMS(weights)
    [[unroll]] for (uint n = 0u; n < INPUT_LOADS; ++n) pixels[n] = pixel_of((lane + n * INVOCATIONS) / STEP);
    fetch(0u);
    for (uint k = 0u; k < src_channels + src_b_channels; k += STEP) {
        barrier();
        stage();
        barrier();
        fetch(k + STEP);
        [[dont_unroll]] for (uint i = 0u; i < STEP; ++i) {
#define STAGED(p) inputs[OWN_TOKEN(p) * ROW + i]
            ADD_PRODUCTS(4u * i, STAGED)
        }
    }

    [[unroll]] for (uint p = 0u; p < OWN; ++p) {
        uint token = OWN_TOKEN(p);
        if (slot + token / 64u >= count) continue;
        uint pixel = pixel_of(token);
        [[unroll]] for (uint n = 0u; n < 2u; ++n) {
            uint channel = first_output + n * OUTPUT_GROUPS;
            if (channel >= dst_channels) continue;
            vec4 value = sums[2u * p + n];
            if ((EPILOGUE & FLAG_FILM) != 0u) {
                value = LOAD_WEIGHTS(film, channel) * value + LOAD_WEIGHTS(film, dst_channels + channel);
            }
            if ((EPILOGUE & FLAG_RESIDUAL) != 0u) value += LOAD(residual, pixel * residual_stride + channel);
            STORE(dst, pixel * dst_stride + channel, activate(value, EPILOGUE));
        }
    }
}
