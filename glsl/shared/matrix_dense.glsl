// What the dense kernels on matrices share. A workgroup computes four tiles of 8x8 tokens, one a subgroup, times 32 channels.
// Both factors are staged in shared memory as rows of halves, padded by 16 bytes so that rows begin in different banks:
// tokens x inputs, and inputs x outputs. The sums go back through the same memory, because what follows (bias, FiLM,
// activation, shuffles) depends on the channel.
const uint LANES = INVOCATIONS / SUBGROUPS;
const uint TOKENS = 64u;                        // of a tile
const uint OUTPUTS = 32u;                       // of a workgroup
const uint ROW_TILES = TOKENS / ROWS;
const uint COLUMN_TILES = OUTPUTS / COLUMNS;
// Strides in vectors of 16 bytes: eight halves or four floats.
const uint OUTPUTS_STRIDE = OUTPUTS / 8u + 1u;
const uint SUMS_STRIDE = OUTPUTS / 4u + 1u;
const uint SUMS_TOKENS = 32u;                   // of a tile at a time

const float LARGEST_HALF = 65504.0;

shared uvec4 staged[STAGED];

MatrixSum sums[ROW_TILES * COLUMN_TILES];

void clear_sums() {
    [[unroll]] for (uint i = 0u; i < ROW_TILES * COLUMN_TILES; ++i) sums[i] = MatrixSum(0.0);
}

// Larger values would become infinite, and the sums NaN.
uvec4 to_halves(vec4 low, vec4 high) {
    low = clamp(low, -LARGEST_HALF, LARGEST_HALF);
    high = clamp(high, -LARGEST_HALF, LARGEST_HALF);
    return uvec4(packHalf2x16(low.xy), packHalf2x16(low.zw), packHalf2x16(high.xy), packHalf2x16(high.zw));
}

// Stages row `row` at `to` for the weights of one input channel, vectors of four outputs from `from` on; zeros if it is beyond the
// last one. Eight outputs by each of four invocations, this one being the `part`-th.
#define STAGE_WEIGHTS(to, row, part, from, inside) \
    staged[(to) + (row) * OUTPUTS_STRIDE + (part)] = (inside) \
        ? to_halves(LOAD_WEIGHTS(weights, (from) + 2u * (part)), LOAD_WEIGHTS(weights, (from) + 2u * (part) + 1u)) \
        : uvec4(0u);

// sums += `depth` columns of the tokens' rows, which begin at `a`, times as many rows of weights, which begin at `b`.
void multiply_add(uint a, uint a_stride, uint b, const uint depth) {
    [[unroll]] for (uint k = 0u; k < depth; k += DEPTH) {
        MatrixB columns[COLUMN_TILES];
        [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
            coopMatLoad(columns[n], staged, b + k * OUTPUTS_STRIDE + n * COLUMNS / 8u, OUTPUTS_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
        }
        [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
            MatrixA rows;
            coopMatLoad(rows, staged, a + m * ROWS * a_stride + k / 8u, a_stride, gl_CooperativeMatrixLayoutRowMajor);
            [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
                sums[m * COLUMN_TILES + n] = coopMatMulAdd(rows, columns[n], sums[m * COLUMN_TILES + n]);
            }
        }
    }
}

// Writes the sums of `part` (0 or 1: half of every tile's tokens) to shared memory, for `staged_sum`.
void stage_sums(uint part) {
    barrier();
    uint to = gl_SubgroupID * SUMS_TOKENS * SUMS_STRIDE;
    [[unroll]] for (uint m = 0u; m < SUMS_TOKENS / ROWS; ++m) {
        [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
            coopMatStore(sums[(part * (SUMS_TOKENS / ROWS) + m) * COLUMN_TILES + n], staged,
                to + m * ROWS * SUMS_STRIDE + n * COLUMNS / 4u, SUMS_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
        }
    }
    barrier();
}

// Four channels of a token of this subgroup's half tile.
vec4 staged_sum(uint token, uint vector) {
    return uintBitsToFloat(staged[(gl_SubgroupID * SUMS_TOKENS + token) * SUMS_STRIDE + vector]);
}

// Every vector of sums with its bias: `finish(at, channel, value)` is what becomes of it, `at` a token of the map and `channel` a
// vector of four.
#define FINISH_SUMS(finish) \
    [[unroll]] for (uint part = 0u; part < TOKENS / SUMS_TOKENS; ++part) { \
        stage_sums(part); \
        for (uint i = gl_SubgroupInvocationID; live && i < SUMS_TOKENS * OUTPUTS / 4u; i += LANES) { \
            uint token = i / (OUTPUTS / 4u), vector = i % (OUTPUTS / 4u); \
            uint channel = gl_WorkGroupID.y * (OUTPUTS / 4u) + vector; \
            if (channel >= dst_channels) continue; \
            vec4 value = staged_sum(token, vector) + LOAD_WEIGHTS(weights, channel); \
            uint of_tile = part * SUMS_TOKENS + token; \
            finish(origin + uvec2(of_tile % 8u, of_tile / 8u), channel, value); \
        } \
    }
