// What dense kernels on ordinary cores share. A workgroup computes OUTPUTS channels, 32 or 64, of two tiles of 8x8
// tokens, an invocation eight channels of eight tokens: for every four input channels of these it takes eight vectors
// of inputs and eight of weights from shared memory, for 256 products. A kernel defines before it includes this
// FACTOR_ROWS, rows of weights that are staged at a time, each of one input channel; and after it
// FACTOR(block, row, vector), what vector of a row is for the outputs of a packed block.
#extension GL_EXT_control_flow_attributes : require

const uint INVOCATIONS = 2u * OUTPUTS;
layout(local_size_x = INVOCATIONS) in;

const uint TILES = 2u;
const uint TOKENS = 64u * TILES;
const uint OWN = 8u;                             // tokens of an invocation
const uint TOKEN_GROUPS = TOKENS / OWN;
const uint OUTPUT_GROUPS = OUTPUTS / 8u;
const uint PACKED = 8u;                          // vectors of outputs of a packed block
const uint FACTORS = FACTOR_ROWS * (OUTPUTS / 4u);
const uint FACTOR_LOADS = (FACTORS + INVOCATIONS - 1u) / INVOCATIONS;

shared vec4 factors[FACTORS];
vec4 next_factors[FACTOR_LOADS];
// Of every token of this invocation, two vectors of outputs.
vec4 sums[2u * OWN];

uint lane = gl_LocalInvocationID.x;
// Neighbouring invocations compute neighbouring outputs of a token: their stores lie side by side.
uint own_outputs = lane % OUTPUT_GROUPS;
uint own_tokens = lane / OUTPUT_GROUPS;
uint first_output = gl_WorkGroupID.y * (OUTPUTS / 4u) + own_outputs;
// The first token of each tile; where there is no second one, that of the first again.
uvec2 origins[TILES];

// Not by an index that compilers do not know: they would keep both in memory.
uvec2 origin_of(uint tile) {
    return tile == 0u ? origins[0] : origins[1];
}

uvec2 token_at(uint token) {
    return origin_of(token / 64u) + uvec2(token % 8u, token / 8u % 8u);
}
#define OWN_TOKEN(p) ((p) * TOKEN_GROUPS + own_tokens)

// Sets every sum to its bias, the first vectors of the weights.
#define CLEAR_SUMS(weights) \
    [[unroll]] for (uint n = 0u; n < 2u; ++n) { \
        vec4 bias = LOAD_WEIGHTS(weights, min(first_output + n * OUTPUT_GROUPS, bias_vectors - 1u)); \
        [[unroll]] for (uint p = 0u; p < OWN; ++p) sums[2u * p + n] = bias; \
    }

#define FETCH_FACTORS \
    [[unroll]] for (uint n = 0u; n < FACTOR_LOADS; ++n) { \
        uint i = min(lane + n * INVOCATIONS, FACTORS - 1u), row = i / PACKED % FACTOR_ROWS; \
        uint block = gl_WorkGroupID.y * (OUTPUTS / 32u) + i / (PACKED * FACTOR_ROWS); \
        next_factors[n] = block * PACKED < bias_vectors ? FACTOR(block, row, i % PACKED) : vec4(0.0); \
    }

// [row][vector of outputs].
void stage_factors() {
    [[unroll]] for (uint n = 0u; n < FACTOR_LOADS; ++n) {
        uint i = lane + n * INVOCATIONS, row = i / PACKED % FACTOR_ROWS, block = i / (PACKED * FACTOR_ROWS);
        if (i < FACTORS) factors[row * (OUTPUTS / 4u) + block * PACKED + i % PACKED] = next_factors[n];
    }
}

// sums += the input vectors INPUT(p) of this invocation's tokens, times the staged rows from `row` on.
#define ADD_PRODUCTS(row, INPUT) { \
    vec4 values[OWN]; \
    [[unroll]] for (uint p = 0u; p < OWN; ++p) values[p] = INPUT(p); \
    [[unroll]] for (uint c = 0u; c < 4u; ++c) { \
        [[unroll]] for (uint n = 0u; n < 2u; ++n) { \
            vec4 factor = factors[((row) + c) * (OUTPUTS / 4u) + n * OUTPUT_GROUPS + own_outputs]; \
            [[unroll]] for (uint p = 0u; p < OWN; ++p) sums[2u * p + n] += values[p][c] * factor; \
        } \
    } \
}
