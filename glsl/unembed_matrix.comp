// Tokens of 2x2 pixels, maps of halves, to pixels of three channels on cooperative matrices: a 3x3 convolution, a pixel
// shuffle and another 3x3 convolution as one sum over 5x5 tokens for the four pixels of a token, four outputs each.
//
// The inputs of one column of taps are staged as rows of eight tokens, as in conv3x3_matrix.comp. On the frame's border
// the second convolution reads zeros, so that the sums there have weights of their own: a workgroup goes through every
// set of weights that one of its tokens needs, and every token stores the result of its own.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/matrix.glsl"
layout(constant_id = 4) const uint INPUTS = 32; // staged at a time, a divisor of all
const uint TILES = SUBGROUPS;
const uint HALVES = 1u;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | halves: [set][tap][input channel][pixel of 4][output of 4]]
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;           // of the tokens
    uint height;
    uint src_stride;      // strides and channel counts in vectors of four
    uint channels;
    uint dst_stride;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

#define OUTPUTS 16u
const uint TAPS = 5u;                           // a side
const uint VECTORS = INPUTS / 8u;               // of eight halves
const uint TOKEN = VECTORS + 1u;
const uint SOURCE_ROWS = 7u + TAPS;
const uint STAGED_INPUTS = TILES * SOURCE_ROWS * 8u * TOKEN;
// The weights come straight from memory: staged with the inputs they leave room for half as many of these, which took
// twice as long.
const uint STAGED_BLOCKS = 0u;
const uint bias_vectors = 1u;
const uint dst_channels = OUTPUTS / 4u;
#include "shared/matrix_dense.glsl"

const uint SETS = 9u;

// The weights of a token: 3 * (away from the border in y, at the top, at the bottom) + (the same in x).
uint set_of(uvec2 token) {
    uint y = token.y == 0u ? 1u : token.y + 1u == height ? 2u : 0u;
    uint x = token.x == 0u ? 1u : token.x + 1u == width ? 2u : 0u;
    return 3u * y + x;
}

// Bits of the sets that the tokens of a tile need.
uint sets_of_tile(uvec2 origin) {
    uint y = 1u | (origin.y == 0u ? 2u : 0u) | (origin.y + 8u == height ? 4u : 0u);
    uint x = 1u | (origin.x == 0u ? 2u : 0u) | (origin.x + 8u == width ? 4u : 0u);
    uint sets = 0u;
    for (uint row = 0u; row < 3u; ++row) if ((y >> row & 1u) != 0u) sets |= x << 3u * row;
    return sets;
}

void stage(uint rows, uvec2 origin, uint first, uint kx) {
    Vectors from = Vectors(src);
    ivec2 corner = ivec2(origin) + ivec2(int(kx) - 2, -2);
    for (uint i = tile_lane; i < SOURCE_ROWS * 8u * VECTORS; i += TILE_LANES) {
        uint part = i % VECTORS, token = i / VECTORS;
        ivec2 at = corner + ivec2(token % 8u, token / 8u);
        bool inside = at.x >= 0 && at.x < int(width) && at.y >= 0 && at.y < int(height);
        uvec4 halves = from.v[uint(inside ? at.y * int(width) + at.x : 0) * (src_stride / 2u) + first + part];
        staged[rows + token * TOKEN + part] = inside ? halves : uvec4(0u);
    }
}

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Halves { float16_t v[]; };

// The weights of DEPTH rows, which begin `at` halves into the packed ones.
void load_rows(Halves weights, uint at, out MatrixB columns[COLUMN_TILES]) {
    [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
        coopMatLoad(columns[n], weights.v, at + n * COLUMNS, OUTPUTS, gl_CooperativeMatrixLayoutRowMajor);
    }
}

// sums += the products of one column of taps; the weights of its first tap begin at `at`, those of the next ones
// `row_of_taps` further each.
void multiply_column(uint rows, Halves weights, uint at, uint row_of_taps) {
    // Rows of matrices begin at every row of tokens; each serves up to five taps.
    const uint STEP = ROWS / 8u;
    [[unroll]] for (uint k = 0u; k < INPUTS; k += DEPTH) {
        MatrixA inputs[SOURCE_ROWS + 1u - STEP];
        [[unroll]] for (uint row = 0u; row < SOURCE_ROWS + 1u - STEP; ++row) {
            uint from = rows + row * 8u * TOKEN + k / 8u;
            coopMatLoad(inputs[row], staged, from, TOKEN, gl_CooperativeMatrixLayoutRowMajor);
        }
        [[unroll]] for (uint ky = 0u; ky < TAPS; ++ky) {
            MatrixB columns[COLUMN_TILES];
            load_rows(weights, at + ky * row_of_taps + k * OUTPUTS, columns);
            [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
                [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
                    uint sum = m * COLUMN_TILES + n;
                    sums[sum] = coopMatMulAdd(inputs[m * STEP + ky], columns[n], sums[sum]);
                }
            }
        }
    }
}

void main() {
    uint first_slot = group_index() * TILES;
    uint count = tiles_of(tile_count, flags, tiles);
    if (first_slot >= count) return;                                                 // whole groups only
    bool live = first_slot + own_tile < count;
    uvec2 origin = tile_origin(min(first_slot + own_tile, count - 1u), first_tile, flags, tiles);
    uint sets = 0u;
    for (uint tile = 0u; tile < TILES; ++tile) {
        sets |= sets_of_tile(tile_origin(min(first_slot + tile, count - 1u), first_tile, flags, tiles));
    }
    uint rows = own_tile * SOURCE_ROWS * 8u * TOKEN;
    uint inputs = 4u * channels;
    Halves matrix = Halves(weights);
    vec4 bias = LOAD_WEIGHTS(weights, 0);

    for (uint set = 0u; set < SETS; ++set) {
        if ((sets >> set & 1u) == 0u) continue;
        clear_sums();
        for (uint first = 0u; first < inputs; first += INPUTS) {
            for (uint kx = 0u; kx < TAPS; ++kx) {
                barrier();
                stage(rows, origin, first / 8u, kx);
                barrier();
                uint at = 8u + ((set * TAPS * TAPS + kx) * inputs + first) * OUTPUTS;
                multiply_column(rows, matrix, at, TAPS * inputs * OUTPUTS);
            }
        }
        [[unroll]] for (uint part = 0u; part < OWN_TOKENS / SUMS_TOKENS; ++part) {
            stage_sums(part);
            for (uint i = gl_SubgroupInvocationID; live && i < SUMS_TOKENS * 4u; i += LANES) {
                // Pixels of a row follow one another.
                uint row = i / 32u, column = i / 2u % 8u, phase = i / 16u % 2u * 2u + i % 2u;
                uint of_tile = part * SUMS_TOKENS + row * 8u + column;
                uvec2 token = origin + uvec2(column, of_tile / 8u);
                if (set_of(token) != set) continue;
                uvec2 pixel = 2u * token + uvec2(phase % 2u, phase / 2u);
                STORE(dst, (pixel.y * 2u * width + pixel.x) * dst_stride, staged_sum(row * 8u + column, phase) + bias);
            }
        }
    }
}
