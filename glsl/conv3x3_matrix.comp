// Dense 3x3 convolution of halves, zero padding, stride STRIDE, on cooperative matrices, the sums in 32-bit floats;
// with the epilogue of the other convolutions. With NORM every token is brought to mean 0 and variance 1 over its
// channels first, then takes gain and bias; all of its channels are staged at once.
//
// The inputs of one column of taps, kx, are staged as rows of eight tokens that lie STRIDE apart. So the tokens of a
// tile follow one another for every ky, and a matrix of any number of rows begins at any of them. For stride 2 the even
// rows come before the odd ones: then a tile's rows follow one another too.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define EPILOGUE_ID 4         // after those of matrix.glsl
#include "shared/epilogue.glsl"
layout(constant_id = 5) const uint TILES = 4;   // of a workgroup: 1, 2 or 4
layout(constant_id = 6) const uint HALVES = 1;  // subgroups that share the tokens of a tile: 1 or 2
#define SUBGROUPS (4u * HALVES)
#include "shared/matrix.glsl"
layout(constant_id = 7) const uint INPUTS = 32; // staged at a time, a divisor of all

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | halves, packed]
    Weights film;         // [gamma | beta] with FLAG_FILM
    Residual residual;    // with FLAG_RESIDUAL
    TileList tiles;       // with FLAG_TILE_LIST
#ifdef NORM
    Weights norm;         // [gain | bias]
#endif
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

const uint VECTORS = INPUTS / 8u;               // of eight halves
const uint TOKEN = VECTORS + 1u;
const uint SOURCE_ROWS = 7u * STRIDE + 3u;
const uint EVEN_ROWS = 9u;                      // of stride 2
const uint STAGED_TILE = SOURCE_ROWS * 8u * TOKEN;
const uint STAGED_INPUTS = TILES * STAGED_TILE;
const uint BLOCKS = INPUTS / 16u;               // of weights, of a tap
const uint STAGED_BLOCKS = 4u / TILES * 3u * BLOCKS;
#include "shared/matrix_dense.glsl"
#include "shared/conv_store.glsl"
#ifdef NORM
#define NORMED_VECTORS VECTORS
#include "shared/norm_share.glsl"

// Eight channels of a token, normed.
uvec4 normed(uvec4 halves, vec4 gain[2], vec4 bias[2]) {
    vec4 low, high;
    unpack_halves(halves, low, high);
    float mean = mean_of(norm_sum(low + high), 2u * VECTORS);
    low -= mean;
    high -= mean;
    float scale = scale_of(norm_sum(low * low + high * high), 2u * VECTORS);
    return pack_halves(low * scale * gain[0] + bias[0], high * scale * gain[1] + bias[1]);
}
#endif

// Where a row of the source that begins `row` below the tile's first one is staged.
uint staged_row(uint row) {
    return STRIDE == 1 ? row : (row & 1u) * EVEN_ROWS + row / 2u;
}

const uint STAGED = SOURCE_ROWS * 8u * VECTORS; // vectors of a column of taps
const uint LOADS = 5u;                          // of an invocation at a time

// Stages one column of taps, of the inputs from vector `first` on. Loads come before the stores, so that they overlap.
void stage(uint rows, uvec2 origin, uint first, uint kx) {
    Vectors from = Vectors(src);
    // What is less than zero is more than any size.
    uvec2 corner = origin * STRIDE + uvec2(kx, 0u) - 1u;
#ifdef NORM
    // An invocation stages the same channels of every token.
    uint part = 2u * (tile_lane % VECTORS);
    vec4 gain[2] = vec4[](norm.v[part], norm.v[part + 1u]);
    vec4 bias[2] = vec4[](norm.v[2u * VECTORS + part], norm.v[2u * VECTORS + part + 1u]);
#endif
    [[dont_unroll]] for (uint begin = tile_lane; begin < STAGED; begin += LOADS * TILE_LANES) {
        uvec4 halves[LOADS];
        [[unroll]] for (uint n = 0u; n < LOADS; ++n) {
            uint i = begin + n * TILE_LANES;
            uvec2 at = corner + uvec2(i / VECTORS % 8u * STRIDE, i / VECTORS / 8u);
            bool inside = all(lessThan(at, uvec2(src_width, src_height)));
            uint pixel = inside ? at.y * src_width + at.x : 0u;
            halves[n] = mix(uvec4(0u), from.v[pixel * (src_stride / 2u) + first + i % VECTORS], bvec4(inside));
        }
        [[unroll]] for (uint n = 0u; n < LOADS; ++n) {
            uint i = begin + n * TILE_LANES;
            uint to = (staged_row(i / VECTORS / 8u) * 8u + i / VECTORS % 8u) * TOKEN + i % VECTORS;
#ifdef NORM
            uvec2 at = corner + uvec2(i / VECTORS % 8u, i / VECTORS / 8u);
            bool inside = all(lessThan(at, uvec2(src_width, src_height)));
            halves[n] = mix(uvec4(0u), normed(halves[n], gain, bias), bvec4(inside));
#endif
            if (i < STAGED) staged[rows + to] = halves[n];
        }
    }
}

// sums += the products of the column of taps that is staged.
void multiply_column(uint rows) {
    uint blocks = own_split * 3u * BLOCKS;
#if STRIDE == 1
    // Rows of matrices begin at every row of tokens; each serves up to three taps.
    const uint STEP = ROWS / 8u;
    const uint FIRSTS = OWN_TOKENS / 8u + 3u - STEP;
    // Not unrolled: CPU drivers spell every product out.
    [[dont_unroll]] for (uint k = 0u; k < INPUTS; k += DEPTH) {
        MatrixA inputs[FIRSTS];
        [[unroll]] for (uint row = 0u; row < FIRSTS; ++row) {
            uint from = rows + (own_half * OWN_TOKENS / 8u + row) * 8u * TOKEN + k / 8u;
            coopMatLoad(inputs[row], staged, from, TOKEN, gl_CooperativeMatrixLayoutRowMajor);
        }
        [[unroll]] for (uint ky = 0u; ky < 3u; ++ky) {
            MatrixB columns[COLUMN_TILES];
            load_weights(blocks + ky * BLOCKS + k / 16u, k % 16u, columns);
            [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
                [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
                    uint sum = m * COLUMN_TILES + n;
                    sums[sum] = coopMatMulAdd(inputs[m * STEP + ky], columns[n], sums[sum]);
                }
            }
        }
    }
#else
    [[dont_unroll]] for (uint ky = 0u; ky < 3u; ++ky) {
        multiply_add(rows + staged_row(ky) * 8u * TOKEN, TOKEN, blocks + ky * BLOCKS, INPUTS);
    }
#endif
}

// The sums of `part` go to tokens of half the resolution: of 2x2 tokens one channel makes a vector.
void finish_unshuffled(uint part, uvec2 origin) {
    for (uint i = gl_SubgroupInvocationID; i < SUMS_TOKENS / 4u * OUTPUTS; i += LANES) {
        uint output_of = i % OUTPUTS, channel = own_outputs * OUTPUTS + output_of;
        uvec2 to = uvec2(i / OUTPUTS % 4u, i / OUTPUTS / 4u);
        if (channel >= 4u * dst_channels) continue;
        vec4 value;
        [[unroll]] for (uint d = 0u; d < 4u; ++d) {
            uint token = (2u * to.y + d / 2u) * 8u + 2u * to.x + d % 2u;
            value[d] = staged_sum(token, output_of / 4u)[output_of % 4u];
        }
        value = activate(value + ReadFloats(weights).v[channel], EPILOGUE);
        uvec2 at = origin / 2u + uvec2(0u, (own_half * OWN_TOKENS + part * SUMS_TOKENS) / 16u) + to;
        STORE(dst, (at.y * (dst_width / 2u) + at.x) * dst_stride + channel, value);
    }
}

void main() {
    uint slot = group_index() * TILES + own_tile;
    uint count = tiles_of(tile_count, flags, tiles);
    if (group_index() * TILES >= count) return;                                      // whole groups only
    bool live = slot < count;
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint rows = own_tile * STAGED_TILE;
    uint inputs = 4u * src_channels;
    bool computes = live && own_outputs * (OUTPUTS / 4u) < dst_channels;

    clear_sums();
    for (uint first = 0u; first < inputs; first += INPUTS) {
        for (uint kx = 0u; kx < 3u; ++kx) {
            barrier();
            stage(rows, origin, first / 8u, kx);
            for (uint ky = 0u; ky < 3u; ++ky) {
                uint block = ((3u * ky + kx) * inputs + first) / 16u;
                stage_weights(Vectors(weights), block, 9u * inputs / 16u, ky * BLOCKS, BLOCKS, 3u * BLOCKS);
            }
            barrier();
            if (computes) multiply_column(rows);
        }
    }
    if ((EPILOGUE & FLAG_UNSHUFFLE) == 0u) {
        FINISH_SUMS(store_result)
        return;
    }
    [[unroll]] for (uint part = 0u; part < OWN_TOKENS / SUMS_TOKENS; ++part) {
        stage_sums(part);
        if (live) finish_unshuffled(part, origin);
    }
}
