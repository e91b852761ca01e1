// An FFN as one kernel, maps of halves, on cooperative matrices: x + W act(depthwise(V norm(x) + b)) + c. What lies
// between, several times as wide as the map, is never in memory: a workgroup computes one 8x8 tile, of it HIDDEN hidden
// channels at a time, those of the tokens around it too.
//
// Sums of the hidden channels are rounded to halves as they would be on their way to memory; the depthwise sums are
// made in 32-bit floats and rounded to halves for the matrices.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define EPILOGUE_ID 4         // after those of matrix.glsl: of the depthwise results
#include "shared/epilogue.glsl"
#include "shared/matrix.glsl"
layout(constant_id = 5) const uint INPUTS = 32; // the map's channels: 32 or 64

layout(push_constant) uniform Push {
    Source x;
    Target dst;
    Weights expand;       // [bias | halves, packed]
    ReadFloats biases;    // the same biases, sixteen times
    Weights depthwise;    // [bias | 9 taps], each of all hidden channels
    Weights weights;      // [bias | halves, packed] of the Linear back
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint x_stride;        // strides and channel counts in vectors of four
    uint dst_stride;
    uint dst_channels;
    uint hidden;
    uint bias_vectors;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

const uint TILES = 1u;
const uint HALVES = 128u / INPUTS;              // subgroups that share the outputs: each has 32 of them
const uint HIDDEN = 32u;
const uint SIDE = 10u;                          // of a tile with the tokens around it
const uint AROUND = 112u;                       // these tokens, as many as whole matrices have
const uint NORMED_STRIDE = INPUTS / 8u + 1u;    // of a token's row, in vectors of eight
const uint STRIDE = HIDDEN / 8u + 1u;
// Staged: hidden channels, what the depthwise convolution makes of them, weights of the Linear back, weights of the
// first one. Before the first hidden channels, all normed tokens.
const uint CONVOLVED_AT = AROUND * STRIDE;
const uint STAGED_INPUTS = CONVOLVED_AT + 64u * STRIDE;
const uint BACK_BLOCKS = HIDDEN / 16u;          // of weights, of 32 outputs
const uint STAGED_BLOCKS = INPUTS / 32u * BACK_BLOCKS;
const uint EXPAND_BLOCKS = INPUTS / 16u;
const uint EXPAND_AT = STAGED_INPUTS + STAGED_BLOCKS * 64u;
const uint STAGED_ALL = EXPAND_AT + EXPAND_BLOCKS * 64u;
const uint STAGED_NORMED = AROUND * NORMED_STRIDE;
#define STAGED_AT_LEAST (STAGED_ALL > STAGED_NORMED ? STAGED_ALL : STAGED_NORMED)
#define SUMS_TOKENS 16u
#include "shared/matrix_dense.glsl"
#include "shared/add_row.glsl"
#define NORMED_VECTORS (INPUTS / 8u)
#define NORMED_SIDE SIDE
#include "shared/stage_normed.glsl"

// The normed tokens of this subgroup: every fourth matrix of them.
const uint STEPS = INPUTS / DEPTH;
const uint MATRICES = AROUND / ROWS;
const uint OWN_MATRICES = (MATRICES + SUBGROUPS - 1u) / SUBGROUPS;
MatrixA normed[OWN_MATRICES * STEPS];

void load_normed() {
    [[unroll]] for (uint m = 0u; m < OWN_MATRICES; ++m) {
        uint matrix = m * SUBGROUPS + gl_SubgroupID;
        if (matrix < MATRICES) {
            [[unroll]] for (uint k = 0u; k < STEPS; ++k) {
                uint from = matrix * ROWS * NORMED_STRIDE + k * DEPTH / 8u;
                coopMatLoad(normed[m * STEPS + k], staged, from, NORMED_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
            }
        }
    }
}

// Stages the weights of the hidden channels from `first` on.
void stage_expand(uint first) {
    Vectors packed = Vectors(expand);
    uint from = hidden + first / 32u * EXPAND_BLOCKS * BLOCK;
    for (uint i = tile_lane; i < EXPAND_BLOCKS * BLOCK; i += TILE_LANES) staged[EXPAND_AT + i] = packed.v[from + i];
}

// The hidden channels from `first` on of all tokens, by the weights that are staged.
void stage_hidden(uint first) {
    // Not unrolled: CPU drivers spell every product out.
    [[dont_unroll]] for (uint n = 0u; n < HIDDEN; n += COLUMNS) {
        MatrixB columns[STEPS];
        [[unroll]] for (uint k = 0u; k < STEPS; ++k) {
            uint from = EXPAND_AT + k * DEPTH / 16u * BLOCK + n * 2u + k * DEPTH % 16u / 8u;
            coopMatLoad(columns[k], staged, from, 2u, gl_CooperativeMatrixLayoutColumnMajor);
        }
        MatrixSum bias;
        coopMatLoad(bias, biases.v, first + n, 4u * hidden, gl_CooperativeMatrixLayoutRowMajor);
        [[unroll]] for (uint m = 0u; m < OWN_MATRICES; ++m) {
            uint matrix = m * SUBGROUPS + gl_SubgroupID;
            if (matrix < MATRICES) {
                MatrixSum sum = MatrixSum(0.0);
                [[unroll]] for (uint k = 0u; k < STEPS; ++k) {
                    sum = coopMatMulAdd(normed[m * STEPS + k], columns[k], sum);
                }
                // After the products, as a Linear by itself does.
                sum = sum + bias;
                uint to = matrix * ROWS * STRIDE + n / 8u;
                coopMatStore(MatrixHalves(sum), staged, to, STRIDE, gl_CooperativeMatrixLayoutRowMajor);
            }
        }
    }
}

const uint VECTORS = HIDDEN / 4u;               // of four halves
const uint RUN = 4u;                            // results of an invocation, one below the other

// Stages the depthwise results of the hidden channels from vector `first` on: an invocation goes down half a column of
// the tile, four channels wide, and adds every row that it loads to the three results that it touches.
void stage_convolved(uint first) {
    for (uint i = tile_lane; i < 8u * VECTORS * 8u / RUN; i += TILE_LANES) {
        uint part = i % VECTORS, x = i / VECTORS % 8u, top = i / (8u * VECTORS) * RUN;
        uint channel = first + part;
        vec4 taps[9];
        [[unroll]] for (uint t = 0u; t < 9u; ++t) taps[t] = LOAD_WEIGHTS(depthwise, (t + 1u) * hidden + channel);
        vec4 bias = LOAD_WEIGHTS(depthwise, channel);
        // Of the row of results above the row that is loaded, of its own, and of the one below.
        vec4 above = bias, own = bias;
        [[unroll]] for (uint y = 0u; y < RUN + 2u; ++y) {
            vec4 row[3];
            [[unroll]] for (uint dx = 0u; dx < 3u; ++dx) {
                uint from = ((top + y) * SIDE + x + dx) * STRIDE + part / 2u;
                row[dx] = widen(uvec2(staged[from][part % 2u * 2u], staged[from][part % 2u * 2u + 1u]));
            }
            if (y >= 2u) {
                uvec2 halves = narrow(activate(add_row(above, row, taps, 2u), EPILOGUE));
                uint to = CONVOLVED_AT + ((top + y - 2u) * 8u + x) * STRIDE + part / 2u;
                staged[to][part % 2u * 2u] = halves.x;
                staged[to][part % 2u * 2u + 1u] = halves.y;
            }
            above = add_row(own, row, taps, 1u);
            own = add_row(bias, row, taps, 0u);
        }
    }
}

// Beyond the map hidden channels are zero.
void clear_beyond(uvec2 origin) {
    for (uint i = tile_lane; i < SIDE * SIDE * STRIDE; i += TILE_LANES) {
        uint token = i / STRIDE;
        // What is less than zero is more than any size.
        uvec2 at = origin + uvec2(token % SIDE, token / SIDE) - 1u;
        if (any(greaterThanEqual(at, uvec2(width, height)))) staged[i] = uvec4(0u);
    }
}

void finish(uvec2 at, uint channel, vec4 value) {
    uint pixel = at.y * width + at.x;
    STORE(dst, pixel * dst_stride + channel, value + LOAD(x, pixel * x_stride + channel));
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;                          // whole groups only
    uvec2 origin = tile_origin(slot, first_tile, flags, tiles);
    const bool live = true;
    bool at_border = any(equal(origin, uvec2(0u))) || any(greaterThanEqual(origin + 8u, uvec2(width, height)));

    stage_normed(Vectors(x), x_stride, 0u, NORMED_STRIDE, origin);
    barrier();
    load_normed();
    barrier();
    stage_expand(0u);
    clear_sums();
    barrier();
    // The weights of one step are staged while the one before reads no more of them, so that two barriers do.
    [[dont_unroll]] for (uint first = 0u; first < 4u * hidden; first += HIDDEN) {
        stage_hidden(first);
        barrier();
        if (at_border) {
            clear_beyond(origin);
            barrier();
        }
        stage_convolved(first / 4u);
        stage_weights(Vectors(weights), first / 16u, hidden / 4u, 0u, BACK_BLOCKS, BACK_BLOCKS);
        if (first + HIDDEN < 4u * hidden) stage_expand(first + HIDDEN);
        barrier();
        multiply_add(CONVOLVED_AT, STRIDE, own_split * BACK_BLOCKS, HIDDEN);
    }
    FINISH_SUMS(finish)
}
