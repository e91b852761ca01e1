// The projection of albedo, normal and depth as one kernel on cooperative matrices, maps of halves: three steps of a
// pointwise convolution, a depthwise 3x3 convolution and a LeakyReLU, each of the one before, and a pointwise
// convolution with a LeakyReLU of the three results side by side. A workgroup computes 16x4 tokens.
//
// Two maps in shared memory hold what the steps make, as far around the tokens as the later steps reach: a pointwise
// convolution reads `steps` and writes `mixed`, without its bias; a depthwise one goes back. What lies beyond the frame
// is zero to it.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define SUBGROUPS 8u
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
    uint tile_columns;    // of 8x8 tokens; the halves of two of a row are a workgroup's
    uint tile_rows;
    uint unused;
};

const uint CHANNELS = 32u;
const uint OUT_WIDTH = 16u, OUT_HEIGHT = 4u;
const uint STEPS = 3u;
const uint TOKEN = CHANNELS / 8u + 1u;           // vectors of a token, padded so that rows begin in different banks
const uint FIRST_TOKEN = 3u;                     // the same of the source: eight channels and eight zeros
const uint COLUMN_TILES = CHANNELS / COLUMNS;
const uint OUT_TILES = OUT_WIDTH / ROWS;         // of a row
const float SLOPE = 0.01;

// Of step `i`: tokens around the workgroup's own of what its depthwise convolution reads, and the size of that.
uint reach(const uint i) { return STEPS - i; }
uint width_of(const uint i) { return OUT_WIDTH + 2u * reach(i); }
uint height_of(const uint i) { return OUT_HEIGHT + 2u * reach(i); }

// Tokens of the largest maps, filled up to whole matrices: 22x10 and 20x8.
const uint MIXED_TOKENS = 224u, STEPS_TOKENS = 160u;
shared uvec4 mixed[MIXED_TOKENS * TOKEN];
shared uvec4 steps[STEPS_TOKENS * TOKEN];

// DEPTH rows of weights from `k` on, of the outputs from `n` on.
void load_columns(out MatrixB columns, Halves weights, uint k, uint n) {
    uint from = CHANNELS * 2u + k / 16u * 16u * CHANNELS + n * 16u + k % 16u;
    coopMatLoad(columns, weights.v, from, 16u, gl_CooperativeMatrixLayoutColumnMajor);
}

// mixed = `tokens` tokens of steps, `stride` vectors each, times a matrix of `depth` inputs.
void pointwise(Weights weights, const uint tokens, const uint depth, const uint stride) {
    Halves matrix = Halves(weights);
    const uint blocks = (tokens + ROWS - 1u) / ROWS * COLUMN_TILES;
    for (uint block = gl_SubgroupID; block < blocks; block += SUBGROUPS) {
        uint row = block / COLUMN_TILES * ROWS, n = block % COLUMN_TILES * COLUMNS;
        MatrixSum sum = MatrixSum(0.0);
        for (uint k = 0u; k < depth; k += DEPTH) {
            MatrixA inputs;
            MatrixB columns;
            coopMatLoad(inputs, steps, row * stride + k / 8u, stride, gl_CooperativeMatrixLayoutRowMajor);
            load_columns(columns, matrix, k, n);
            sum = coopMatMulAdd(inputs, columns, sum);
        }
        coopmat<float16_t, gl_ScopeSubgroup, ROWS, COLUMNS, gl_MatrixUseAccumulator> halves =
            coopmat<float16_t, gl_ScopeSubgroup, ROWS, COLUMNS, gl_MatrixUseAccumulator>(sum);
        coopMatStore(halves, mixed, row * TOKEN + n / 8u, TOKEN, gl_CooperativeMatrixLayoutRowMajor);
    }
}

const uint RUN = 2u;                             // rows of results of an invocation at a time

// Step i's depthwise convolution and activation, of mixed to steps. An invocation makes RUN rows of a token's four
// channels.
void depthwise(Weights bias_before, Weights weights, const uint i, uvec2 origin) {
    const uint VECTORS = CHANNELS / 4u;
    const uint from_width = width_of(i), to_width = width_of(i) - 2u, to_height = height_of(i) - 2u;
    const uint runs = to_width * (to_height / RUN) * VECTORS;
    uint part = gl_LocalInvocationID.x % VECTORS;
    vec4 taps[9];
    [[unroll]] for (uint t = 0u; t < 9u; ++t) taps[t] = LOAD_WEIGHTS(weights, (t + 1u) * VECTORS + part);
    vec4 bias = LOAD_WEIGHTS(weights, part);
    vec4 before = LOAD_WEIGHTS(bias_before, part);
    for (uint run = gl_LocalInvocationID.x; run < runs; run += INVOCATIONS) {
        uint x = run / VECTORS % to_width, first = run / VECTORS / to_width * RUN;
        vec4 sums[RUN];
        [[unroll]] for (uint r = 0u; r < RUN; ++r) sums[r] = bias;
        [[unroll]] for (uint r = 0u; r < RUN + 2u; ++r) {
            int y = int(origin.y + first + r) - int(reach(i));
            bool row_inside = y >= 0 && y < int(height);
            [[unroll]] for (uint dx = 0u; dx < 3u; ++dx) {
                int at_x = int(origin.x + x + dx) - int(reach(i));
                bool inside = row_inside && at_x >= 0 && at_x < int(width);
                uvec4 halves = mixed[((first + r) * from_width + x + dx) * TOKEN + part / 2u];
                vec4 value = inside ? widen(part % 2u == 0u ? halves.xy : halves.zw) + before : vec4(0.0);
                [[unroll]] for (uint ky = 0u; ky < 3u; ++ky) {
                    if (r >= ky && r - ky < RUN) sums[r - ky] += taps[3u * ky + dx] * value;
                }
            }
        }
        [[unroll]] for (uint r = 0u; r < RUN; ++r) {
            uvec2 halves = narrow(max(sums[r], SLOPE * sums[r]));
            uint to = ((first + r) * to_width + x) * TOKEN + part / 2u;
            if (part % 2u == 0u) steps[to].xy = halves;
            else steps[to].zw = halves;
        }
    }
}

// A matrix of results for every subgroup, or several.
const uint RESULTS = OUT_HEIGHT * OUT_TILES * COLUMN_TILES / SUBGROUPS;
MatrixSum results[RESULTS];

// results += the products of the workgroup's own tokens of step i's result.
void add_results(Weights weights, const uint i) {
    Halves matrix = Halves(weights);
    const uint own = reach(i) - 1u, pitch = width_of(i) - 2u;
    [[unroll]] for (uint r = 0u; r < RESULTS; ++r) {
        uint at = gl_SubgroupID * RESULTS + r;
        uint n = at % COLUMN_TILES * COLUMNS, m = at / COLUMN_TILES;
        uint token = (m / OUT_TILES + own) * pitch + m % OUT_TILES * ROWS + own;
        for (uint k = 0u; k < CHANNELS; k += DEPTH) {
            MatrixA inputs;
            MatrixB columns;
            coopMatLoad(inputs, steps, token * TOKEN + k / 8u, TOKEN, gl_CooperativeMatrixLayoutRowMajor);
            load_columns(columns, matrix, k, n);
            results[r] = coopMatMulAdd(inputs, columns, results[r]);
        }
    }
}

void main() {
    uint pairs = (tile_columns + 1u) / 2u;
    uint group = group_index();
    if (group >= pairs * tile_rows * 2u) return;                                     // whole groups only
    uvec2 first = uvec2(first_tile & 0xffffu, first_tile >> 16) * 4u;
    uvec2 origin = first + uvec2(group % pairs * OUT_WIDTH, group / pairs * OUT_HEIGHT);
    uint end = first.x + tile_columns * 8u;

    Vectors from = Vectors(src);
    for (uint token = gl_LocalInvocationID.x; token < MIXED_TOKENS; token += INVOCATIONS) {
        ivec2 at = ivec2(origin) + ivec2(token % width_of(0u), token / width_of(0u)) - int(reach(0u));
        bool inside = at.x >= 0 && at.x < int(width) && at.y >= 0 && at.y < int(height);
        uvec4 halves = from.v[uint(inside ? at.y * int(width) + at.x : 0) * (src_stride / 2u)];
        steps[token * FIRST_TOKEN] = inside ? halves : uvec4(0u);
        steps[token * FIRST_TOKEN + 1u] = uvec4(0u);
    }
    [[unroll]] for (uint i = 0u; i < RESULTS; ++i) results[i] = MatrixSum(0.0);
    barrier();
    pointwise(pointwise_0, width_of(0u) * height_of(0u), 16u, FIRST_TOKEN);
    barrier();
    depthwise(pointwise_0, depthwise_0, 0u, origin);
    barrier();
    add_results(out_0, 0u);
    pointwise(pointwise_1, width_of(1u) * height_of(1u), CHANNELS, TOKEN);
    barrier();
    depthwise(pointwise_1, depthwise_1, 1u, origin);
    barrier();
    add_results(out_1, 1u);
    pointwise(pointwise_2, width_of(2u) * height_of(2u), CHANNELS, TOKEN);
    barrier();
    depthwise(pointwise_2, depthwise_2, 2u, origin);
    barrier();
    add_results(out_2, 2u);

    // The sums go through the shared memory of `mixed`, which nobody reads any more, because the bias depends on the
    // channel.
    const uint SUMS_STRIDE = CHANNELS / 4u + 1u;
    [[unroll]] for (uint r = 0u; r < RESULTS; ++r) {
        uint at = gl_SubgroupID * RESULTS + r;
        coopMatStore(results[r], mixed, at / COLUMN_TILES * ROWS * SUMS_STRIDE + at % COLUMN_TILES * COLUMNS / 4u, SUMS_STRIDE,
            gl_CooperativeMatrixLayoutRowMajor);
    }
    barrier();
    for (uint i = gl_LocalInvocationID.x; i < OUT_HEIGHT * OUT_WIDTH * CHANNELS / 4u; i += INVOCATIONS) {
        uint part = i % (CHANNELS / 4u), token = i / (CHANNELS / 4u);
        uvec2 at = origin + uvec2(token % OUT_WIDTH, token / OUT_WIDTH);
        if (at.x >= end) continue;
        vec4 value = uintBitsToFloat(mixed[token * SUMS_STRIDE + part]) + LOAD_WEIGHTS(out_2, part);
        STORE(dst, (at.y * width + at.x) * dst_stride + part, max(value, SLOPE * value));
    }
}
