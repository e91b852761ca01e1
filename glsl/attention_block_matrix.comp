// The attention of a block as one kernel, single-headed, maps of halves, on cooperative matrices: x + W [attended | raw
// rest of x] + bias, where the first VALUES channels of x attend. Queries, keys and values are Linears of the normed
// tokens of x, queries and keys of the features those of f. A workgroup computes one 8x8 window and four times 32
// outputs; where there are more, others make the same attention again.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define SUBGROUPS (64u / ROWS)                  // of a window
#include "shared/matrix.glsl"
layout(constant_id = 6) const uint INPUTS = 16;  // of the rest, staged at a time: a divisor of all

layout(push_constant) uniform Push {
    Source x;              // the attending channels come first
    Source f;
    Weights x_weights;     // [bias | halves, packed] of queries, keys and values
    ReadFloats x_biases;   // the same biases, sixteen times
    Weights f_weights;     // of queries and keys
    ReadFloats f_biases;
    ReadFloats bias;       // [query][key]
    Weights weights;       // [bias | halves, packed] of the projection
    Target dst;
    TileList tiles;        // with FLAG_TILE_LIST
    uint width;
    uint x_stride;         // strides and channel counts in vectors of four
    uint f_stride;
    uint dst_stride;
    uint dst_channels;
    uint bias_vectors;
    float scale;           // 1 / sqrt(d)
    uint first_tile;       // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

const uint TILES = 1u;
const uint HALVES = SUBGROUPS / 4u;
const uint STRIDE = INPUTS / 8u + 1u;            // of a token's row of the rest, in vectors of eight
const uint STAGED_INPUTS = 64u * STRIDE;
// What the projection stages of weights and then of sums, beside the attended tokens.
const uint STAGED_BLOCKS = 4u * (INPUTS > 32u ? INPUTS : 32u) / 16u;
const uint STAGED_PROJECTION = STAGED_INPUTS + 64u * STAGED_BLOCKS;
const uint PROJECTED_SUMS = 4u * 32u * 9u;
#define STAGED_BEFORE_VALUES (STAGED_PROJECTION > PROJECTED_SUMS ? STAGED_PROJECTION : PROJECTED_SUMS)
#include "shared/attention_sizes.glsl"
#define STAGED_AT_LEAST STAGED_ATTENTION
const uint ATTENDED = VALUES < 32u ? VALUES : 32u; // channels of the attended tokens that are multiplied at a time
#include "shared/matrix_dense.glsl"
#define NORMED_VECTORS (VALUES / 8u)
#include "shared/stage_normed.glsl"
#include "shared/attention_matrix.glsl"

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Halves { float16_t v[]; };

// The normed tokens of this subgroup's queries.
const uint STEPS = VALUES / DEPTH;
MatrixA rows_of_x[STEPS];
MatrixA rows_of_f[STEPS];

// Outputs from `n` on of a Linear with `outputs` biases, of this subgroup's tokens, staged in `stride` vectors a token
// from `to` on.
#define PROJECT(rows, packed, biases, outputs, n, to, stride) { \
    MatrixB columns[STEPS]; \
    [[unroll]] for (uint k = 0u; k < STEPS; ++k) { \
        uint block = (n) / 32u * (VALUES / 16u) + k * DEPTH / 16u; \
        uint from = 2u * (outputs) + block * 512u + (n) % 32u * 16u + k * DEPTH % 16u; \
        coopMatLoad(columns[k], Halves(packed).v, from, 16u, gl_CooperativeMatrixLayoutColumnMajor); \
    } \
    MatrixSum sum; \
    coopMatLoad(sum, biases.v, n, outputs, gl_CooperativeMatrixLayoutRowMajor); \
    [[unroll]] for (uint k = 0u; k < STEPS; ++k) sum = coopMatMulAdd(rows[k], columns[k], sum); \
    coopMatStore(MatrixHalves(sum), staged, (to) + gl_SubgroupID * QUERIES * (stride), stride, \
        gl_CooperativeMatrixLayoutRowMajor); \
    }

// Queries, keys and values of this window, from its normed tokens.
void stage_projections(uvec2 origin) {
    // Of x where the values will lie, of f where queries and keys will.
    stage_normed(Vectors(x), x_stride, VALUES_AT, VALUE_STRIDE, origin);
    stage_normed(Vectors(f), f_stride, 0u, VALUE_STRIDE, origin);
    barrier();
    [[unroll]] for (uint k = 0u; k < STEPS; ++k) {
        uint from = gl_SubgroupID * QUERIES * VALUE_STRIDE + k * DEPTH / 8u;
        coopMatLoad(rows_of_x[k], staged, VALUES_AT + from, VALUE_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
        coopMatLoad(rows_of_f[k], staged, from, VALUE_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
    }
    barrier();
    const uint X_OUTPUTS = (2u * KEYS + VALUES + 31u) / 32u * 32u;
    const uint F_OUTPUTS = (2u * KEYS + 31u) / 32u * 32u;
    const uint MATRIX = WINDOW * KEY_STRIDE;
    // Where a matrix is wider than what it is of, its last columns are of what comes next.
    [[dont_unroll]] for (uint n = 0u; n < DEPTH_KEYS; n += COLUMNS) {
        uint to = n / 8u;
        PROJECT(rows_of_x, x_weights, x_biases, X_OUTPUTS, n, to, KEY_STRIDE)
        PROJECT(rows_of_x, x_weights, x_biases, X_OUTPUTS, n + KEYS, to + MATRIX, KEY_STRIDE)
        PROJECT(rows_of_f, f_weights, f_biases, F_OUTPUTS, n, to + 2u * MATRIX, KEY_STRIDE)
        PROJECT(rows_of_f, f_weights, f_biases, F_OUTPUTS, n + KEYS, to + 3u * MATRIX, KEY_STRIDE)
    }
    [[dont_unroll]] for (uint n = 0u; n < VALUES; n += COLUMNS) {
        PROJECT(rows_of_x, x_weights, x_biases, X_OUTPUTS, n + 2u * KEYS, VALUES_AT + n / 8u, VALUE_STRIDE)
    }
    barrier();
    if (KEYS < DEPTH_KEYS) {
        // What multiplies the columns beyond the keys.
        for (uint i = gl_LocalInvocationID.x; i < 2u * WINDOW; i += INVOCATIONS) {
            staged[i / WINDOW * 2u * MATRIX + i % WINDOW * KEY_STRIDE + KEYS / 8u] = uvec4(0u);
        }
        barrier();
    }
}

// The attended tokens as halves, where the values were.
void stage_attended() {
    for (uint i = gl_SubgroupInvocationID; i < QUERIES * VALUES / 8u; i += LANES) {
        uint row = i / (VALUES / 8u), part = i % (VALUES / 8u);
        uint token = gl_SubgroupID * QUERIES + row;
        uint from = own_scores + row * SCORE_STRIDE + 2u * part;
        vec4 low = uintBitsToFloat(staged[from]) * inverse_sums[token];
        vec4 high = uintBitsToFloat(staged[from + 1u]) * inverse_sums[token];
        staged[VALUES_AT + token * VALUE_STRIDE + part] = pack_halves(low, high);
    }
}

// Channels of the window from vector `first` of eight on.
void stage_rest(uvec2 origin, uint first) {
    const uint VECTORS = INPUTS / 8u;
    Vectors from = Vectors(x);
    for (uint i = tile_lane; i < TOKENS * VECTORS; i += TILE_LANES) {
        uint token = i / VECTORS, part = i % VECTORS;
        uint pixel = (origin.y + token / 8u) * width + origin.x + token % 8u;
        staged[token * STRIDE + part] = from.v[pixel * (x_stride / 2u) + first + part];
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

    stage_projections(origin);
    attend(0u);
    barrier();
    stage_attended();

    uint inputs = 4u * dst_channels;
    bool computes = own_outputs * (OUTPUTS / 4u) < dst_channels;
    clear_sums();
    for (uint first = 0u; first < VALUES; first += ATTENDED) {
        const uint BLOCKS = ATTENDED / 16u;
        barrier();
        stage_weights(Vectors(weights), first / 16u, inputs / 16u, 0u, BLOCKS, BLOCKS);
        barrier();
        if (computes) multiply_add(VALUES_AT + first / 8u, VALUE_STRIDE, own_split * BLOCKS, ATTENDED);
    }
    for (uint first = VALUES; first < inputs; first += INPUTS) {
        const uint BLOCKS = INPUTS / 16u;
        barrier();
        stage_rest(origin, first / 8u);
        stage_weights(Vectors(weights), first / 16u, inputs / 16u, 0u, BLOCKS, BLOCKS);
        barrier();
        if (computes) multiply_add(0u, STRIDE, own_split * BLOCKS, INPUTS);
    }
    FINISH_SUMS(finish)
}
