// The projection of albedo, normal and depth as one kernel on cooperative matrices, maps of halves: three steps of a pointwise
// convolution, a depthwise 3x3 convolution and a LeakyReLU, each of the one before, and a pointwise convolution with a LeakyReLU of
// the three results side by side. A workgroup computes 16x8 tokens.
//
// One map in shared memory holds what a step works on, as far around the tokens as the later steps reach. Results of a
// pointwise convolution take the place of its inputs row by row, without their bias; depthwise results are held back until all
// are made. What lies beyond the frame is zero to a depthwise convolution.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/matrix.glsl"

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Vectors { uvec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Halves { float16_t v[]; };

layout(push_constant) uniform Push {
    Source src;           // eight channels
    Target dst;           // 32 channels
    Weights pointwise_0;  // [bias | halves, packed], of 8, 32 and 32 inputs
    Weights pointwise_1;
    Weights pointwise_2;
    Weights depthwise_0;  // [bias | 9 taps], each of all channels
    Weights depthwise_1;
    Weights depthwise_2;
    Weights out_0;        // [bias | halves, packed]; the last one's bias counts
    Weights out_1;
    Weights out_2;
    uint width;
    uint height;
    uint src_stride;      // in vectors of four
    uint dst_stride;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_columns;    // of 8x8 tokens; two of a row are a workgroup's
    uint tile_rows;
    uint unused;
};

const uint CHANNELS = 32u;
const uint OUT_WIDTH = 16u, OUT_HEIGHT = 8u;
const uint STEPS = 3u;
// Tokens of the first step's map, filled up to whole matrices.
const uint MOST_TOKENS = 320u;
const uint TOKEN = CHANNELS / 8u + 1u;           // vectors of a token, padded so that rows begin in different banks
const uint COLUMN_TILES = CHANNELS / COLUMNS;
const uint OUT_ROWS = OUT_HEIGHT / SUBGROUPS;    // of a subgroup
const uint OUT_TILES = OUT_WIDTH / ROWS;         // of a row
const float SLOPE = 0.01;

shared uvec4 map[MOST_TOKENS * TOKEN];

MatrixSum results[OUT_ROWS * OUT_TILES * COLUMN_TILES];

// Of step `i`: tokens around the workgroup's own of what its depthwise convolution reads, and the size of that.
uint reach(const uint i) { return STEPS - i; }
uint width_of(const uint i) { return OUT_WIDTH + 2u * reach(i); }
uint height_of(const uint i) { return OUT_HEIGHT + 2u * reach(i); }

// The first `tokens` tokens times a matrix of `depth` inputs, in place.
void pointwise(Weights weights, const uint tokens, const uint depth) {
    Halves matrix = Halves(weights);
    const uint MOST_DEPTHS = CHANNELS / 8u;
    for (uint block = gl_SubgroupID; block < (tokens + ROWS - 1u) / ROWS; block += SUBGROUPS) {
        MatrixA inputs[MOST_DEPTHS];
        [[unroll]] for (uint k = 0u; k < depth / DEPTH; ++k) {
            coopMatLoad(inputs[k], map, block * ROWS * TOKEN + k * DEPTH / 8u, TOKEN, gl_CooperativeMatrixLayoutRowMajor);
        }
        [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
            MatrixSum sum = MatrixSum(0.0);
            [[unroll]] for (uint k = 0u; k < depth / DEPTH; ++k) {
                MatrixB columns;
                coopMatLoad(columns, matrix.v, CHANNELS * 2u + k * DEPTH * CHANNELS + n * COLUMNS, CHANNELS,
                    gl_CooperativeMatrixLayoutRowMajor);
                sum = coopMatMulAdd(inputs[k], columns, sum);
            }
            coopmat<float16_t, gl_ScopeSubgroup, ROWS, COLUMNS, gl_MatrixUseAccumulator> halves =
                coopmat<float16_t, gl_ScopeSubgroup, ROWS, COLUMNS, gl_MatrixUseAccumulator>(sum);
            coopMatStore(halves, map, block * ROWS * TOKEN + n * COLUMNS / 8u, TOKEN, gl_CooperativeMatrixLayoutRowMajor);
        }
    }
}

const uint RUN = 4u;                             // rows of results of an invocation at a time
const uint MOST_RUNS = 20u * 3u * (CHANNELS / 4u);
const uint HELD = (MOST_RUNS + INVOCATIONS - 1u) / INVOCATIONS;

// Step i's depthwise convolution and activation, of the map to the map of the next step's size.
void depthwise(Weights bias_before, Weights weights, const uint i, uvec2 origin) {
    const uint VECTORS = CHANNELS / 4u;
    const uint from_width = width_of(i), to_width = width_of(i) - 2u, to_height = height_of(i) - 2u;
    const uint runs = to_width * ((to_height + RUN - 1u) / RUN) * VECTORS;
    uvec2 held[HELD * RUN];
    [[unroll]] for (uint turn = 0u; turn < HELD; ++turn) {
        // The last turn may be one too many for some, who do the last run again and do not store it.
        uint run = min(turn * INVOCATIONS + gl_LocalInvocationID.x, runs - 1u);
        uint part = run % VECTORS, x = run / VECTORS % to_width, first = run / VECTORS / to_width * RUN;
        vec4 taps[9];
        [[unroll]] for (uint t = 0u; t < 9u; ++t) taps[t] = LOAD_WEIGHTS(weights, (t + 1u) * VECTORS + part);
        vec4 bias = LOAD_WEIGHTS(weights, part);
        vec4 before = LOAD_WEIGHTS(bias_before, part);
        vec4 sums[RUN];
        [[unroll]] for (uint r = 0u; r < RUN; ++r) sums[r] = bias;
        [[unroll]] for (uint r = 0u; r < RUN + 2u; ++r) {
            uint row = first + r;
            int y = int(origin.y + row) - int(reach(i));
            // Rows of results beyond the last one are not stored.
            bool row_inside = row < height_of(i) && y >= 0 && y < int(height);
            [[unroll]] for (uint dx = 0u; dx < 3u; ++dx) {
                int at_x = int(origin.x + x + dx) - int(reach(i));
                bool inside = row_inside && at_x >= 0 && at_x < int(width);
                uvec4 halves = map[min(row * from_width + x + dx, MOST_TOKENS - 1u) * TOKEN + part / 2u];
                vec4 value = inside ? widen(part % 2u == 0u ? halves.xy : halves.zw) + before : vec4(0.0);
                [[unroll]] for (uint ky = 0u; ky < 3u; ++ky) {
                    if (r >= ky && r - ky < RUN) sums[r - ky] += taps[3u * ky + dx] * value;
                }
            }
        }
        [[unroll]] for (uint r = 0u; r < RUN; ++r) held[turn * RUN + r] = narrow(max(sums[r], SLOPE * sums[r]));
    }
    barrier();
    [[unroll]] for (uint turn = 0u; turn < HELD; ++turn) {
        uint run = turn * INVOCATIONS + gl_LocalInvocationID.x;
        if (run >= runs) continue;
        uint part = run % VECTORS, x = run / VECTORS % to_width, first = run / VECTORS / to_width * RUN;
        [[unroll]] for (uint r = 0u; r < RUN; ++r) {
            if (first + r >= to_height) continue;
            uint to = ((first + r) * to_width + x) * TOKEN + part / 2u;
            if (part % 2u == 0u) map[to].xy = held[turn * RUN + r];
            else map[to].zw = held[turn * RUN + r];
        }
    }
    barrier();
}

// results += the products of the workgroup's own tokens of step i's result.
void add_results(Weights weights, const uint i) {
    Halves matrix = Halves(weights);
    const uint own = reach(i) - 1u, pitch = width_of(i) - 2u;
    [[unroll]] for (uint k = 0u; k < CHANNELS; k += DEPTH) {
        MatrixB columns[COLUMN_TILES];
        [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
            coopMatLoad(columns[n], matrix.v, CHANNELS * 2u + k * CHANNELS + n * COLUMNS, CHANNELS, gl_CooperativeMatrixLayoutRowMajor);
        }
        [[unroll]] for (uint m = 0u; m < OUT_ROWS * OUT_TILES; ++m) {
            uint row = gl_SubgroupID * OUT_ROWS + m / OUT_TILES + own, column = m % OUT_TILES * ROWS + own;
            MatrixA inputs;
            coopMatLoad(inputs, map, (row * pitch + column) * TOKEN + k / 8u, TOKEN, gl_CooperativeMatrixLayoutRowMajor);
            [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
                results[m * COLUMN_TILES + n] = coopMatMulAdd(inputs, columns[n], results[m * COLUMN_TILES + n]);
            }
        }
    }
}

void main() {
    uint pairs = (tile_columns + 1u) / 2u;
    uint group = group_index();
    if (group >= pairs * tile_rows) return;                                          // whole groups only
    uvec2 first = uvec2(first_tile & 0xffffu, first_tile >> 16) * 4u;
    uvec2 origin = first + uvec2(group % pairs * OUT_WIDTH, group / pairs * OUT_HEIGHT);
    uint end = first.x + tile_columns * 8u;

    // A row of the first matrix: eight channels and eight zeros.
    Vectors from = Vectors(src);
    for (uint token = gl_LocalInvocationID.x; token < MOST_TOKENS; token += INVOCATIONS) {
        ivec2 at = ivec2(origin) + ivec2(token % width_of(0u), token / width_of(0u)) - int(reach(0u));
        bool inside = at.x >= 0 && at.x < int(width) && at.y >= 0 && at.y < int(height);
        uvec4 halves = from.v[uint(inside ? at.y * int(width) + at.x : 0) * (src_stride / 2u)];
        map[token * TOKEN] = inside ? halves : uvec4(0u);
        map[token * TOKEN + 1u] = uvec4(0u);
    }
    [[unroll]] for (uint i = 0u; i < OUT_ROWS * OUT_TILES * COLUMN_TILES; ++i) results[i] = MatrixSum(0.0);
    barrier();
    pointwise(pointwise_0, width_of(0u) * height_of(0u), 16u);
    barrier();
    depthwise(pointwise_0, depthwise_0, 0u, origin);
    add_results(out_0, 0u);
    barrier();
    pointwise(pointwise_1, width_of(1u) * height_of(1u), CHANNELS);
    barrier();
    depthwise(pointwise_1, depthwise_1, 1u, origin);
    add_results(out_1, 1u);
    barrier();
    pointwise(pointwise_2, width_of(2u) * height_of(2u), CHANNELS);
    barrier();
    depthwise(pointwise_2, depthwise_2, 2u, origin);
    add_results(out_2, 2u);
    barrier();

    // The sums go back through the shared memory, because the bias depends on the channel.
    const uint SUMS_STRIDE = CHANNELS / 4u + 1u;
    uint own = gl_SubgroupID * OUT_ROWS * OUT_WIDTH * SUMS_STRIDE;
    [[unroll]] for (uint m = 0u; m < OUT_ROWS * OUT_TILES; ++m) {
        [[unroll]] for (uint n = 0u; n < COLUMN_TILES; ++n) {
            coopMatStore(results[m * COLUMN_TILES + n], map, own + m * ROWS * SUMS_STRIDE + n * COLUMNS / 4u, SUMS_STRIDE,
                gl_CooperativeMatrixLayoutRowMajor);
        }
    }
    barrier();
    for (uint i = gl_SubgroupInvocationID; i < OUT_ROWS * OUT_WIDTH * CHANNELS / 4u; i += LANES) {
        uint part = i % (CHANNELS / 4u), token = i / (CHANNELS / 4u);
        uvec2 at = origin + uvec2(token % OUT_WIDTH, gl_SubgroupID * OUT_ROWS + token / OUT_WIDTH);
        if (at.x >= end) continue;
        vec4 value = uintBitsToFloat(map[own + token * SUMS_STRIDE + part]) + LOAD_WEIGHTS(out_2, part);
        STORE(dst, (at.y * width + at.x) * dst_stride + part, max(value, SLOPE * value));
    }
}
