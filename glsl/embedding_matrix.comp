// The embedding of pixels of 32 channels in tokens of 2x2, a convolution of stride 2, on cooperative matrices, with
// what comes before it or beside it:
// PROJECTED: the pixels are the colour's, a convolution of four channels of 32-bit floats (bias, leaky rectifier); else
// they are a map of halves, the features'.
// EARLY: what the head's kernels are predicted from takes a Linear of the pixels too; the colour's adds what the
// features' gave.
//
// A workgroup computes one 8x8 tile of tokens. Its pixels are in shared memory: one column of the convolution's taps
// after the other, kx, eight pixels that lie two apart in each of 17 rows, the even rows before the odd ones. So the
// pixels of a tile follow one another for every ky, and two of the columns hold every pixel of the tile once.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/matrix.glsl"

layout(push_constant) uniform Push {
    Source src;           // the colour, or the pixels
    Target dst;
    Weights projection;   // [bias | halves, packed], with PROJECTED
    ReadFloats biases;    // its biases, sixteen times
    Weights weights;      // [bias | halves, packed] of the embedding
    Target early;         // with EARLY
    Residual before;      // with both
    Weights early_weights;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;           // tokens
    uint height;
    uint src_stride;      // strides and channel counts in vectors of four
    uint dst_stride;
    uint early_stride;
    uint before_stride;
    uint dst_channels;
    uint bias_vectors;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

const uint TILES = 1u;
const uint HALVES = 4u;                          // every subgroup computes a quarter of the tile
const uint CHANNELS = 32u;                       // of a pixel
const uint STRIDE = CHANNELS / 8u + 1u;          // of its row, in vectors of eight
const uint EVEN_ROWS = 9u;
const uint PIXELS = 144u;                        // of a column of taps, 17 rows of eight, in whole matrices
const uint INPUTS = 48u;                         // nine taps of four channels, and zeros
const uint TAPS_STRIDE = INPUTS / 8u + 1u;
// Staged: pixels; where first lies what each subgroup projects, the weights of a column of taps and those of the
// Linear; the weights of the projection; the colours of the tile and around it.
const uint STAGED_INPUTS = PIXELS * STRIDE;
const uint COLUMN_BLOCKS = 3u * CHANNELS / 16u;
const uint EARLY_BLOCK = COLUMN_BLOCKS;
const uint PROJECTION_BLOCK = EARLY_BLOCK + CHANNELS / 16u;
#ifdef PROJECTED
const uint STAGED_BLOCKS = PROJECTION_BLOCK + INPUTS / 16u;
const uint SIDE = 19u;                           // of a tile's pixels with what they are projected from
const uint COLORS_AT = STAGED_INPUTS + STAGED_BLOCKS * 64u;
#define STAGED_AT_LEAST (COLORS_AT + (SIDE * SIDE + 1u) / 2u)
#else
const uint STAGED_BLOCKS = PROJECTION_BLOCK;
#endif
#define SUMS_TOKENS 16u
#include "shared/matrix_dense.glsl"

// The pixel that is staged as number `i` of a column of taps, from the tile's first tap on.
uvec2 pixel_of_tile(uint i, uint kx) {
    uint row = i / 8u < EVEN_ROWS ? i / 8u * 2u : (i / 8u - EVEN_ROWS) * 2u + 1u;
    return uvec2(i % 8u * 2u + kx, row);
}

// The same in the frame.
ivec2 pixel_of(uvec2 origin, uint i, uint kx) {
    return ivec2(2u * origin + pixel_of_tile(i, kx)) - 1;
}

bool is_inside(ivec2 pixel) {
    return all(greaterThanEqual(pixel, ivec2(0))) && all(lessThan(pixel, 2 * ivec2(width, height)));
}

#ifdef PROJECTED
#include "shared/color_taps.glsl"

// Stages what the pixels of matrix `matrix` of a column of taps are projected from, for this subgroup.
void stage_taps(uint to, uint matrix, uint kx) {
    for (uint i = gl_SubgroupInvocationID; i < ROWS * (INPUTS / 8u); i += LANES) {
        uint own = i % ROWS, part = i / ROWS;
        // The last row fills the last matrix up and is not read; nothing is staged below it.
        uvec2 at = pixel_of_tile(min(matrix * ROWS + own, 17u * 8u - 1u), kx);
        staged[to + own * TAPS_STRIDE + part] = color_taps(COLORS_AT, SIDE, at.y * SIDE + at.x, part);
    }
}

// Projects the pixels of matrix `matrix`, of which the inputs are staged.
void project(uint from, uint matrix, MatrixSum bias[COLUMN_TILES]) {
    MatrixSum projected[COLUMN_TILES];
    [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) projected[n] = MatrixSum(0.0);
    [[unroll]] for (uint k = 0u; k < INPUTS; k += DEPTH) {
        MatrixA rows;
        MatrixB columns[COLUMN_TILES];
        coopMatLoad(rows, staged, from + k / 8u, TAPS_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
        load_weights(PROJECTION_BLOCK + k / 16u, k % 16u, columns);
        [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
            projected[n] = coopMatMulAdd(rows, columns[n], projected[n]);
        }
    }
    [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
        // After the products, as the kernel by itself does: large frames have that one too, and the same bits.
        projected[n] = projected[n] + bias[n];
        for (int i = 0; i < projected[n].length(); ++i) {
            projected[n][i] = max(projected[n][i], 0.01 * projected[n][i]);
        }
        coopMatStore(MatrixHalves(projected[n]), staged, matrix * ROWS * STRIDE + n * COLUMNS / 8u, STRIDE,
            gl_CooperativeMatrixLayoutRowMajor);
    }
}

// Projects a column of taps. Subgroups that have no matrix left wait with the others: CPU drivers take every barrier
// for one of the workgroup.
void stage_projected(uint kx) {
    MatrixSum bias[COLUMN_TILES];
    [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
        coopMatLoad(bias[n], biases.v, n * COLUMNS, CHANNELS, gl_CooperativeMatrixLayoutRowMajor);
    }
    uint own = STAGED_INPUTS + gl_SubgroupID * ROWS * TAPS_STRIDE;
    const uint MATRICES = PIXELS / ROWS;
    // Not unrolled: CPU drivers spell every product out.
    [[dont_unroll]] for (uint first = 0u; first < MATRICES; first += SUBGROUPS) {
        uint matrix = first + gl_SubgroupID;
        if (matrix < MATRICES) stage_taps(own, matrix, kx);
        subgroupBarrier();
        if (matrix < MATRICES) project(own, matrix, bias);
        subgroupBarrier();
    }
}

// Beyond the frame pixels are zero.
void clear_beyond(uvec2 origin, uint kx) {
    for (uint i = tile_lane; i < PIXELS; i += TILE_LANES) {
        ivec2 at = pixel_of(origin, i, kx);
        if (is_inside(at)) continue;
        for (uint part = 0u; part < CHANNELS / 8u; ++part) staged[i * STRIDE + part] = uvec4(0u);
    }
}

#else
const uint VECTORS = CHANNELS / 8u;
const uint LOADS = 5u;                           // of an invocation at a time

// Stages a column of taps. Loads come before the stores, so that they overlap.
void stage_pixels(uvec2 origin, uint kx) {
    Vectors from = Vectors(src);
    [[dont_unroll]] for (uint begin = tile_lane; begin < PIXELS * VECTORS; begin += LOADS * TILE_LANES) {
        uvec4 halves[LOADS];
        [[unroll]] for (uint n = 0u; n < LOADS; ++n) {
            uint i = min(begin + n * TILE_LANES, PIXELS * VECTORS - 1u);
            ivec2 at = pixel_of(origin, i / VECTORS, kx);
            bool inside = is_inside(at);
            uint pixel = inside ? uint(at.y) * 2u * width + uint(at.x) : 0u;
            halves[n] = mix(uvec4(0u), from.v[pixel * (src_stride / 2u) + i % VECTORS], bvec4(inside));
        }
        [[unroll]] for (uint n = 0u; n < LOADS; ++n) {
            uint i = begin + n * TILE_LANES;
            if (i < PIXELS * VECTORS) staged[i / VECTORS * STRIDE + i % VECTORS] = halves[n];
        }
    }
}
#endif

#ifdef EARLY
// Even rows of the tile's pixels, then odd ones.
MatrixSum early_sums[2u * ROW_TILES * COLUMN_TILES];

uint first_early(uint part) {
    return (part == 0u ? EVEN_ROWS : 1u) * 8u + own_half * OWN_TOKENS;
}

void multiply_early() {
    [[unroll]] for (uint i = 0u; i < 2u * ROW_TILES * COLUMN_TILES; ++i) early_sums[i] = MatrixSum(0.0);
    [[unroll]] for (uint k = 0u; k < CHANNELS; k += DEPTH) {
        MatrixB columns[COLUMN_TILES];
        load_weights(EARLY_BLOCK + k / 16u, k % 16u, columns);
        [[unroll]] for (uint m = 0u; m < 2u * ROW_TILES; ++m) {
            MatrixA rows;
            uint from = (first_early(m / ROW_TILES) + m % ROW_TILES * ROWS) * STRIDE + k / 8u;
            coopMatLoad(rows, staged, from, STRIDE, gl_CooperativeMatrixLayoutRowMajor);
            [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
                early_sums[m * COLUMN_TILES + n] = coopMatMulAdd(rows, columns[n], early_sums[m * COLUMN_TILES + n]);
            }
        }
    }
}

void finish_early(uvec2 origin, uint kx) {
    uint to = gl_SubgroupID * SUMS_TOKENS * SUMS_STRIDE;
    barrier();
    [[unroll]] for (uint part = 0u; part < 2u; ++part) {
        [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
            [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
                coopMatStore(early_sums[(part * ROW_TILES + m) * COLUMN_TILES + n], staged,
                    to + m * ROWS * SUMS_STRIDE + n * COLUMNS / 4u, SUMS_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
            }
        }
        subgroupBarrier();
        for (uint i = gl_SubgroupInvocationID; i < SUMS_TOKENS * CHANNELS / 4u; i += LANES) {
            uint token = i / (CHANNELS / 4u), channel = i % (CHANNELS / 4u);
            ivec2 at = pixel_of(origin, first_early(part) + token, kx);
            uint pixel = uint(at.y) * 2u * width + uint(at.x);
            vec4 value = staged_sum(token, channel) + LOAD_WEIGHTS(early_weights, channel);
#ifdef PROJECTED
            value += LOAD(before, pixel * before_stride + channel);
#endif
            STORE(early, pixel * early_stride + channel, value);
        }
        subgroupBarrier();
    }
}
#endif

void finish(uvec2 at, uint channel, vec4 value) {
    STORE(dst, (at.y * width + at.x) * dst_stride + channel, value);
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;                          // whole groups only
    uvec2 origin = tile_origin(slot, first_tile, flags, tiles);
    const bool live = true;

#ifdef PROJECTED
    bool at_border = any(equal(origin, uvec2(0u))) || any(greaterThanEqual(origin + 8u, uvec2(width, height)));
    stage_weights(Vectors(projection), 0u, INPUTS / 16u, PROJECTION_BLOCK, INPUTS / 16u, STAGED_BLOCKS);
    stage_colors(COLORS_AT, SIDE, 2 * ivec2(origin) - 2, 2 * ivec2(width, height));
#endif
    clear_sums();
    [[dont_unroll]] for (uint kx = 0u; kx < 3u; ++kx) {
        barrier();
#ifdef PROJECTED
        stage_projected(kx);
        barrier();
        if (at_border) clear_beyond(origin, kx);
#else
        stage_pixels(origin, kx);
#endif
        const uint BLOCKS = CHANNELS / 16u;
        for (uint ky = 0u; ky < 3u; ++ky) {
            stage_weights(Vectors(weights), (3u * ky + kx) * BLOCKS, 9u * BLOCKS, ky * BLOCKS, BLOCKS, STAGED_BLOCKS);
        }
#ifdef EARLY
        if (kx > 0u) stage_weights(Vectors(early_weights), 0u, BLOCKS, EARLY_BLOCK, BLOCKS, STAGED_BLOCKS);
#endif
        barrier();
        [[dont_unroll]] for (uint ky = 0u; ky < 3u; ++ky) {
            uint row = (ky & 1u) * EVEN_ROWS + ky / 2u;
            multiply_add(row * 8u * STRIDE, STRIDE, ky * BLOCKS, CHANNELS);
        }
#ifdef EARLY
        if (kx > 0u) {
            multiply_early();
            finish_early(origin, kx);
        }
#endif
    }
    FINISH_SUMS(finish)
}
