// What the dense kernels on matrices share. A workgroup computes TILES tiles of 8x8 tokens; SPLITS subgroups share a tile, each
// with 32 of its outputs. The tokens' inputs are staged in shared memory as rows of halves, padded by 16 bytes so that rows
// begin in different banks. The weights come straight from memory, packed as [32 outputs][row][32 halves]. The sums go back
// through the shared memory, because what follows (bias, FiLM, activation, shuffles) depends on the channel.
//
// A kernel defines STAGED_INPUTS, vectors of 16 bytes in which it stages, before it includes this.
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Vectors { uvec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Halves { float16_t v[]; };

const uint SPLITS = SUBGROUPS / TILES;
const uint TOKENS = 64u;                        // of a tile
#ifndef OUTPUTS
#define OUTPUTS 32u                             // of a subgroup
#endif
const uint ROW_TILES = TOKENS / ROWS;
const uint COLUMN_TILES = OUTPUTS / COLUMNS;
const uint SUMS_STRIDE = OUTPUTS / 4u + 1u;     // in vectors of four floats
const uint SUMS_TOKENS = 32u;                   // of a tile at a time
const uint STAGED_SUMS = SUBGROUPS * SUMS_TOKENS * SUMS_STRIDE;

shared uvec4 staged[STAGED_INPUTS > STAGED_SUMS ? STAGED_INPUTS : STAGED_SUMS];

// This subgroup's tile among those of its workgroup, and its block of outputs.
uint own_tile = gl_SubgroupID / SPLITS;
uint own_outputs = gl_WorkGroupID.y * SPLITS + gl_SubgroupID % SPLITS;
// This invocation among those that share a tile.
const uint TILE_LANES = SPLITS * LANES;
uint tile_lane = gl_SubgroupID % SPLITS * LANES + gl_SubgroupInvocationID;

MatrixSum sums[ROW_TILES * COLUMN_TILES];

void clear_sums() {
    [[unroll]] for (uint i = 0u; i < ROW_TILES * COLUMN_TILES; ++i) sums[i] = MatrixSum(0.0);
}

// The weights of DEPTH rows, which begin `at` halves into the packed ones.
void load_weights(Halves weights, uint at, out MatrixB columns[COLUMN_TILES]) {
    [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
        coopMatLoad(columns[n], weights.v, at + n * COLUMNS, OUTPUTS, gl_CooperativeMatrixLayoutRowMajor);
    }
}

// sums += `depth` columns of the tokens' rows, which begin at vector `a`, times as many rows of weights from `at` on.
void multiply_add(uint a, uint a_stride, Halves weights, uint at, const uint depth) {
    [[unroll]] for (uint k = 0u; k < depth; k += DEPTH) {
        MatrixB columns[COLUMN_TILES];
        load_weights(weights, at + k * OUTPUTS, columns);
        [[unroll]] for (uint m = 0u; m < ROW_TILES; ++m) {
            MatrixA rows;
            coopMatLoad(rows, staged, a + m * ROWS * a_stride + k / 8u, a_stride, gl_CooperativeMatrixLayoutRowMajor);
            [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
                sums[m * COLUMN_TILES + n] = coopMatMulAdd(rows, columns[n], sums[m * COLUMN_TILES + n]);
            }
        }
    }
}

// Writes the sums of `part` (0 or 1: half of the tile's tokens) to shared memory, for `staged_sum`.
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
            uint channel = own_outputs * (OUTPUTS / 4u) + vector; \
            if (channel >= dst_channels) continue; \
            vec4 value = staged_sum(token, vector) + LOAD_WEIGHTS(weights, channel); \
            uint of_tile = part * SUMS_TOKENS + token; \
            finish(origin + uvec2(of_tile % 8u, of_tile / 8u), channel, value); \
        } \
    }
