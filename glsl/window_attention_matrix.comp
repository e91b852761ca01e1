// Joint attention of one 8x8 window and one head, maps of halves, on cooperative matrices: a subgroup computes sixteen
// queries. Scores, their product and the exponentials are 32-bit floats; queries, keys, values and probabilities are
// halves.
#version 460
#extension GL_KHR_shader_subgroup_shuffle : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/matrix.glsl"
layout(constant_id = 4) const uint KEYS = 8;     // channels of queries and keys: a multiple of eight
layout(constant_id = 5) const uint VALUES = 16;  // channels of values: a multiple of sixteen

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Vectors { uvec4 v[]; };

layout(push_constant) uniform Push {
    Source x;             // [Q | K | V], head-major
    Source f;             // [Qf | Kf], head-major
    ReadFloats bias;      // for every head [query][key]
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint x_stride;        // strides and widths in vectors of four
    uint f_stride;
    uint dst_stride;
    uint heads;
    uint key_vectors;
    uint value_vectors;
    float scale;          // 1 / sqrt(d)
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

const uint TOKENS = 64u;
const uint QUERIES = TOKENS / SUBGROUPS;         // of a subgroup
const uint ROW_TILES = QUERIES / ROWS;
const uint COLUMN_TILES = TOKENS / COLUMNS;
const uint DEPTH_KEYS = (KEYS + 15u) / 16u * 16u; // filled up with zeros
// Strides of rows in shared memory, in vectors of 16 bytes, padded so that rows begin in different banks.
const uint KEY_STRIDE = DEPTH_KEYS / 8u + 1u;
const uint VALUE_STRIDE = VALUES / 8u + 1u;
const uint SCORE_STRIDE = TOKENS / 4u + 1u;
// Queries, keys, and both of the features; later the scores, over them the probabilities and last the results.
const uint KEYS_SIZE = 4u * TOKENS * KEY_STRIDE;
const uint SCORES_SIZE = TOKENS * SCORE_STRIDE;
const uint VALUES_AT = KEYS_SIZE > SCORES_SIZE ? KEYS_SIZE : SCORES_SIZE;

shared uvec4 staged[VALUES_AT + TOKENS * VALUE_STRIDE];
shared float inverse_sums[TOKENS];

uint window_pixel;

uint token_pixel(uint token) {
    return window_pixel + (token / 8u) * width + token % 8u;
}

// Stages `vectors` of eight channels of every token, of which `real` exist.
void stage(Vectors from, uint stride, uint first, uint to, uint to_stride, const uint vectors, const uint real) {
    for (uint i = gl_LocalInvocationID.x; i < TOKENS * vectors; i += INVOCATIONS) {
        uint token = i / vectors, part = i % vectors;
        uvec4 halves = uvec4(0u);
        if (part < real) halves = from.v[token_pixel(token) * (stride / 2u) + first + part];
        staged[to + token * to_stride + part] = halves;
    }
}

// Scores of this subgroup's queries and sixteen or so keys, from the queries staged at `queries` and the keys behind
// them.
MatrixSum scores_of(uint queries, uint m, uint n) {
    MatrixSum sum = MatrixSum(0.0);
    [[unroll]] for (uint k = 0u; k < DEPTH_KEYS; k += DEPTH) {
        MatrixA rows;
        MatrixB columns;
        uint row = gl_SubgroupID * QUERIES + m * ROWS;
        coopMatLoad(rows, staged, queries + row * KEY_STRIDE + k / 8u, KEY_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
        uint keys = queries + TOKENS * KEY_STRIDE;
        coopMatLoad(columns, staged, keys + n * COLUMNS * KEY_STRIDE + k / 8u, KEY_STRIDE, gl_CooperativeMatrixLayoutColumnMajor);
        sum = coopMatMulAdd(rows, columns, sum);
    }
    return sum;
}

// Invocations that share a row of scores.
const uint SHARE = LANES >= 64u ? 4u : LANES >= 32u ? 2u : 1u;
const uint EACH = TOKENS / 4u / SHARE;           // vectors of four scores

float share_max(float value) {
    if (SHARE > 1u) value = max(value, subgroupShuffleXor(value, 1u));
    if (SHARE > 2u) value = max(value, subgroupShuffleXor(value, 2u));
    return value;
}
float share_sum(float value) {
    if (SHARE > 1u) value += subgroupShuffleXor(value, 1u);
    if (SHARE > 2u) value += subgroupShuffleXor(value, 2u);
    return value;
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;                          // whole groups only
    uint head = gl_WorkGroupID.y;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    window_pixel = at.y * width + at.x;

    const uint REAL = KEYS / 8u;
    stage(Vectors(x), x_stride, head * REAL, 0u, KEY_STRIDE, DEPTH_KEYS / 8u, REAL);
    stage(Vectors(x), x_stride, (heads + head) * REAL, TOKENS * KEY_STRIDE, KEY_STRIDE, DEPTH_KEYS / 8u, REAL);
    stage(Vectors(f), f_stride, head * REAL, 2u * TOKENS * KEY_STRIDE, KEY_STRIDE, DEPTH_KEYS / 8u, REAL);
    stage(Vectors(f), f_stride, (heads + head) * REAL, 3u * TOKENS * KEY_STRIDE, KEY_STRIDE, DEPTH_KEYS / 8u, REAL);
    stage(Vectors(x), x_stride, 2u * heads * REAL + head * (VALUES / 8u), VALUES_AT, VALUE_STRIDE, VALUES / 8u, VALUES / 8u);
    barrier();

    MatrixSum scores[ROW_TILES * COLUMN_TILES];
    [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
        [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
            MatrixSum b;
            uint row = gl_SubgroupID * QUERIES + m * ROWS;
            coopMatLoad(b, bias.v, (head * TOKENS + row) * TOKENS + n * COLUMNS, TOKENS, gl_CooperativeMatrixLayoutRowMajor);
            scores[m * COLUMN_TILES + n] =
                (scores_of(0u, m, n) * scale + b) * (scores_of(2u * TOKENS * KEY_STRIDE, m, n) * scale + b);
        }
    }
    barrier();
    // From here on a subgroup works on its own rows alone.
    uint own = gl_SubgroupID * QUERIES * SCORE_STRIDE;
    [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
        [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
            coopMatStore(scores[m * COLUMN_TILES + n], staged, own + m * ROWS * SCORE_STRIDE + n * COLUMNS / 4u, SCORE_STRIDE,
                gl_CooperativeMatrixLayoutRowMajor);
        }
    }
    barrier();

    // Softmax: SHARE invocations own a row; the order is fixed, so are the bits. The results are divided by the sum at
    // the end.
    uint part = gl_SubgroupInvocationID % SHARE * EACH;
    for (uint row = gl_SubgroupInvocationID / SHARE; row < QUERIES; row += LANES / SHARE) {
        uint from = own + row * SCORE_STRIDE;
        vec4 e[EACH];
        vec4 top = vec4(-3.402823466e38);
        [[unroll]] for (uint i = 0u; i < EACH; ++i) {
            e[i] = uintBitsToFloat(staged[from + part + i]);
            top = max(top, e[i]);
        }
        float most = share_max(max(max(top.x, top.y), max(top.z, top.w)));
        vec4 sum = vec4(0.0);
        [[unroll]] for (uint i = 0u; i < EACH; ++i) {
            e[i] = exp(e[i] - most);
            sum += e[i];
        }
        float all = share_sum(sum.x + sum.y + sum.z + sum.w);
        // The others of the row have read it too: the shuffles waited for them.
        [[unroll]] for (uint i = 0u; i < EACH; i += 2u) {
            staged[from + (part + i) / 2u] = pack_halves(e[i], e[i + 1u]);
        }
        if (part == 0u) inverse_sums[gl_SubgroupID * QUERIES + row] = 1.0 / all;
    }
    barrier();

    const uint VALUE_TILES = VALUES / COLUMNS;
    MatrixSum results[ROW_TILES * VALUE_TILES];
    [[unroll]] for (uint i = 0u; i < ROW_TILES * VALUE_TILES; ++i) results[i] = MatrixSum(0.0);
    [[unroll]] for (uint k = 0u; k < TOKENS; k += DEPTH) {
        MatrixB values[VALUE_TILES];
        [[unroll]] for (uint n = 0u; n < VALUE_TILES; ++n) {
            coopMatLoad(values[n], staged, VALUES_AT + k * VALUE_STRIDE + n * COLUMNS / 8u, VALUE_STRIDE,
                gl_CooperativeMatrixLayoutRowMajor);
        }
        [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
            MatrixA rows;
            coopMatLoad(rows, staged, own + m * ROWS * SCORE_STRIDE + k / 8u, SCORE_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
            [[unroll]] for (uint n = 0u; n < VALUE_TILES; ++n) {
                results[m * VALUE_TILES + n] = coopMatMulAdd(rows, values[n], results[m * VALUE_TILES + n]);
            }
        }
    }
    barrier();
    [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
        [[unroll]] for (uint n = 0u; n < VALUE_TILES; ++n) {
            coopMatStore(results[m * VALUE_TILES + n], staged, own + m * ROWS * SCORE_STRIDE + n * COLUMNS / 4u, SCORE_STRIDE,
                gl_CooperativeMatrixLayoutRowMajor);
        }
    }
    barrier();
    for (uint i = gl_SubgroupInvocationID; i < QUERIES * VALUES / 4u; i += LANES) {
        uint row = i / (VALUES / 4u), c = i % (VALUES / 4u);
        uint token = gl_SubgroupID * QUERIES + row;
        vec4 value = uintBitsToFloat(staged[own + row * SCORE_STRIDE + c]) * inverse_sums[token];
        STORE(dst, token_pixel(token) * dst_stride + head * (VALUES / 4u) + c, value);
    }
}
