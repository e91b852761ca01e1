// What the dense kernels on matrices share. A workgroup computes TILES tiles of 8x8 tokens; a subgroup a HALVES-th of
// one, 32 of its outputs. Both factors are staged in shared memory: the tokens' inputs as rows of halves, padded by 16
// bytes so that rows begin in different banks; the weights as they are packed, [block of outputs][block of 16
// rows][output][row]. The sums go back through the same memory, because what follows (bias, FiLM, activation, shuffles)
// depends on the channel.
//
// A kernel defines before it includes this: STAGED_INPUTS, vectors of 16 bytes in which it stages inputs, and
// STAGED_BLOCKS, blocks of 16 rows of weights for 32 outputs; where it needs more shared memory for something else,
// STAGED_AT_LEAST, vectors in all.
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Vectors { uvec4 v[]; };

const uint SPLITS = SUBGROUPS / HALVES / TILES;  // subgroups that share the tokens of a tile
const uint TOKENS = 64u;                        // of a tile
const uint OWN_TOKENS = TOKENS / HALVES;        // of a subgroup
#ifndef OUTPUTS
#define OUTPUTS 32u                             // of a subgroup
#endif
const uint ROW_TILES = OWN_TOKENS / ROWS;
const uint COLUMN_TILES = OUTPUTS / COLUMNS;
const uint SUMS_STRIDE = OUTPUTS / 4u + 1u;     // in vectors of four floats
#ifndef SUMS_TOKENS
#define SUMS_TOKENS (32u / HALVES)              // of a subgroup at a time
#endif
const uint STAGED_SUMS = SUBGROUPS * SUMS_TOKENS * SUMS_STRIDE;

const uint BLOCK = 16u * OUTPUTS / 8u;           // vectors of a block of weights
const uint STAGED_FACTORS = STAGED_INPUTS + STAGED_BLOCKS * BLOCK;

const uint STAGED_DENSE = STAGED_FACTORS > STAGED_SUMS ? STAGED_FACTORS : STAGED_SUMS;
#ifndef STAGED_AT_LEAST
#define STAGED_AT_LEAST 0u
#endif

shared uvec4 staged[STAGED_DENSE > STAGED_AT_LEAST ? STAGED_DENSE : STAGED_AT_LEAST];

// This subgroup's tile among those of its workgroup, its half of that, and its block of outputs.
uint own_tile = gl_SubgroupID / (HALVES * SPLITS);
uint own_half = gl_SubgroupID % HALVES;
uint own_split = gl_SubgroupID / HALVES % SPLITS;
uint own_outputs = gl_WorkGroupID.y * SPLITS + own_split;
// This invocation among those that share a tile.
const uint TILE_LANES = HALVES * SPLITS * LANES;
uint tile_lane = gl_SubgroupID % (HALVES * SPLITS) * LANES + gl_SubgroupInvocationID;

MatrixSum sums[ROW_TILES * COLUMN_TILES];

void clear_sums() {
    [[unroll]] for (uint i = 0u; i < ROW_TILES * COLUMN_TILES; ++i) sums[i] = MatrixSum(0.0);
}

const uint WEIGHTS_AT_ONCE = 4u;                 // loads of an invocation

// Stages blocks of weights for all outputs of the workgroup: `count` from block `first` of each block of outputs on, of
// which a block of outputs has `all`. They follow the `before` that are staged already; there are PER_OUTPUTS for a
// block of outputs in all. Loads come before the stores, so that they overlap.
void stage_weights(Vectors packed, uint first, uint all, uint before, const uint count, const uint PER_OUTPUTS) {
    const uint vectors = SPLITS * count * BLOCK;
    [[dont_unroll]] for (uint begin = gl_LocalInvocationID.x; begin < vectors; begin += WEIGHTS_AT_ONCE * INVOCATIONS) {
        uvec4 halves[WEIGHTS_AT_ONCE];
        [[unroll]] for (uint n = 0u; n < WEIGHTS_AT_ONCE; ++n) {
            uint i = min(begin + n * INVOCATIONS, vectors - 1u);
            uint outputs = gl_WorkGroupID.y * SPLITS + i / (count * BLOCK);
            // Beyond the last block of outputs nobody computes.
            if (outputs * OUTPUTS < 4u * dst_channels) {
                halves[n] = packed.v[bias_vectors + (outputs * all + first) * BLOCK + i % (count * BLOCK)];
            }
        }
        [[unroll]] for (uint n = 0u; n < WEIGHTS_AT_ONCE; ++n) {
            uint i = begin + n * INVOCATIONS;
            uint to = STAGED_INPUTS + (i / (count * BLOCK) * PER_OUTPUTS + before) * BLOCK + i % (count * BLOCK);
            if (i < vectors) staged[to] = halves[n];
        }
    }
}

// The weights of DEPTH rows, from row `row` of the staged block `block` on.
void load_weights(uint block, uint row, out MatrixB columns[COLUMN_TILES]) {
    [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
        uint from = STAGED_INPUTS + block * BLOCK + n * COLUMNS * 2u + row / 8u;
        coopMatLoad(columns[n], staged, from, 2u, gl_CooperativeMatrixLayoutColumnMajor);
    }
}

// sums += `depth` columns of the rows of this subgroup's tokens, times the staged blocks of weights from `block` on.
// The tile's rows begin at vector `a`.
void multiply_add(uint a, uint a_stride, uint block, const uint depth) {
    // Not all unrolled: CPU drivers spell every product out.
    [[dont_unroll]] for (uint first = 0u; first < depth; first += 16u) {
        [[unroll]] for (uint k = 0u; k < 16u; k += DEPTH) {
            MatrixB columns[COLUMN_TILES];
            load_weights(block + first / 16u, k, columns);
            [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
                MatrixA rows;
                uint from = a + (own_half * OWN_TOKENS + m * ROWS) * a_stride + (first + k) / 8u;
                coopMatLoad(rows, staged, from, a_stride, gl_CooperativeMatrixLayoutRowMajor);
                [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
                    sums[m * COLUMN_TILES + n] = coopMatMulAdd(rows, columns[n], sums[m * COLUMN_TILES + n]);
                }
            }
        }
    }
}

// Writes the sums of `part` (0 or 1: half of the subgroup's tokens) to shared memory, for `staged_sum`. Every subgroup
// has a place of its own, where at first others may still read what was staged.
void stage_sums(uint part) {
    if (part == 0u) barrier();
    else subgroupBarrier();
    uint to = gl_SubgroupID * SUMS_TOKENS * SUMS_STRIDE;
    [[unroll]] for (uint m = 0u; m < SUMS_TOKENS / ROWS; ++m) {
        [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
            coopMatStore(sums[(part * (SUMS_TOKENS / ROWS) + m) * COLUMN_TILES + n], staged,
                to + m * ROWS * SUMS_STRIDE + n * COLUMNS / 4u, SUMS_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
        }
    }
    subgroupBarrier();
}

// Four channels of one of those tokens.
vec4 staged_sum(uint token, uint vector) {
    return uintBitsToFloat(staged[(gl_SubgroupID * SUMS_TOKENS + token) * SUMS_STRIDE + vector]);
}

// Every vector of sums with its bias: `finish(at, channel, value)` is what becomes of it, `at` a token of the map and
// `channel` a vector of four.
#define FINISH_SUMS(finish) \
    [[unroll]] for (uint part = 0u; part < OWN_TOKENS / SUMS_TOKENS; ++part) { \
        stage_sums(part); \
        for (uint i = gl_SubgroupInvocationID; live && i < SUMS_TOKENS * OUTPUTS / 4u; i += LANES) { \
            uint token = i / (OUTPUTS / 4u), vector = i % (OUTPUTS / 4u); \
            uint channel = own_outputs * (OUTPUTS / 4u) + vector; \
            if (channel >= dst_channels) continue; \
            vec4 value = staged_sum(token, vector) + LOAD_WEIGHTS(weights, channel); \
            uint of_tile = own_half * OWN_TOKENS + part * SUMS_TOKENS + token; \
            finish(origin + uvec2(of_tile % 8u, of_tile / 8u), channel, value); \
        } \
    }
