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

// The outputs that a subgroup computes of every matrix of tokens: the same throughout, so that it loads weights once.
uint own_column = gl_SubgroupID % COLUMN_TILES * COLUMNS;
const uint ROW_STRIDE = SUBGROUPS / COLUMN_TILES;

// Those weights of the next matrix to mixed, and of the next one to the results.
MatrixB mixing[CHANNELS / DEPTH];
MatrixB adding[CHANNELS / DEPTH];

// DEPTH rows of them from `k` on.
void load_columns(out MatrixB columns, Weights weights, uint k) {
    uint from = CHANNELS * 2u + k / 16u * 16u * CHANNELS + own_column * 16u + k % 16u;
    coopMatLoad(columns, Halves(weights).v, from, 16u, gl_CooperativeMatrixLayoutColumnMajor);
}
void load_mixing(Weights weights, const uint depth) {
    [[unroll]] for (uint i = 0u; i < depth / DEPTH; ++i) load_columns(mixing[i], weights, i * DEPTH);
}
void load_adding(Weights weights) {
    [[unroll]] for (uint i = 0u; i < CHANNELS / DEPTH; ++i) load_columns(adding[i], weights, i * DEPTH);
}

// mixed = `tokens` tokens of steps, `stride` vectors each, times `mixing`, a matrix of `depth` inputs.
void pointwise(const uint tokens, const uint depth, const uint stride) {
    for (uint row = gl_SubgroupID / COLUMN_TILES * ROWS; row < tokens; row += ROW_STRIDE * ROWS) {
        MatrixSum sum = MatrixSum(0.0);
        [[unroll]] for (uint i = 0u; i < depth / DEPTH; ++i) {
            MatrixA inputs;
            coopMatLoad(inputs, steps, row * stride + i * DEPTH / 8u, stride, gl_CooperativeMatrixLayoutRowMajor);
            sum = coopMatMulAdd(inputs, mixing[i], sum);
        }
        uint to = row * TOKEN + own_column / 8u;
        coopMatStore(MatrixHalves(sum), mixed, to, TOKEN, gl_CooperativeMatrixLayoutRowMajor);
    }
}

const uint RUN = 2u;                             // rows of results of an invocation at a time
const uint VECTORS = CHANNELS / 4u;

// Of a depthwise convolution, for four channels.
struct Taps {
    vec4 taps[9];
    vec4 bias;
    vec4 before;      // the bias of the pointwise convolution before it
};

Taps load_taps(Weights bias_before, Weights weights) {
    uint part = gl_LocalInvocationID.x % VECTORS;
    Taps of;
    [[unroll]] for (uint t = 0u; t < 9u; ++t) of.taps[t] = LOAD_WEIGHTS(weights, (t + 1u) * VECTORS + part);
    of.bias = LOAD_WEIGHTS(weights, part);
    of.before = LOAD_WEIGHTS(bias_before, part);
    return of;
}

// Step i's depthwise convolution and activation, of mixed to steps. An invocation makes RUN rows of a token's four
// channels. Beyond the frame steps is zero, and so is mixed, which has no bias yet: what the taps make of that is added
// here, for those taps that lie inside the frame. `whole`: all of them do.
void depthwise(Taps of, const uint i, uvec2 origin, bool whole) {
    const uint from_width = width_of(i), to_width = width_of(i) - 2u, to_height = height_of(i) - 2u;
    const uint runs = to_width * (to_height / RUN) * VECTORS;
    uint part = gl_LocalInvocationID.x % VECTORS;
    uint half_vector = part % 2u * 2u;
    vec4 with_all = of.bias;
    [[unroll]] for (uint t = 0u; t < 9u; ++t) with_all += of.taps[t] * of.before;
    for (uint run = gl_LocalInvocationID.x; run < runs; run += INVOCATIONS) {
        uint x = run / VECTORS % to_width, first = run / VECTORS / to_width * RUN;
        // The frame's coordinates of the first tap; what is less than zero is more than any size.
        uvec2 size = uvec2(width, height);
        uvec2 corner = origin + uvec2(x, first) - reach(i);
        vec4 sums[RUN];
        [[unroll]] for (uint r = 0u; r < RUN; ++r) sums[r] = with_all;
        if (!whole) {
            [[unroll]] for (uint r = 0u; r < RUN; ++r) {
                sums[r] = of.bias;
                [[unroll]] for (uint t = 0u; t < 9u; ++t) {
                    bool inside = all(lessThan(corner + uvec2(t % 3u, r + t / 3u), size));
                    sums[r] += mix(vec4(0.0), of.taps[t] * of.before, bvec4(inside));
                }
            }
        }
        uint from = (first * from_width + x) * TOKEN + part / 2u;
        [[unroll]] for (uint r = 0u; r < RUN + 2u; ++r) {
            [[unroll]] for (uint dx = 0u; dx < 3u; ++dx) {
                uint at = from + (r * from_width + dx) * TOKEN;
                vec4 value = widen(uvec2(mixed[at][half_vector], mixed[at][half_vector + 1u]));
                [[unroll]] for (uint ky = 0u; ky < 3u; ++ky) {
                    if (r >= ky && r - ky < RUN) sums[r - ky] += of.taps[3u * ky + dx] * value;
                }
            }
        }
        uint to = (first * to_width + x) * TOKEN + part / 2u;
        [[unroll]] for (uint r = 0u; r < RUN; ++r) {
            bool inside = all(lessThan(corner + uvec2(1u, 1u + r), size));
            uvec2 halves = mix(uvec2(0u), narrow(max(sums[r], SLOPE * sums[r])), bvec2(inside));
            steps[to + r * to_width * TOKEN][half_vector] = halves.x;
            steps[to + r * to_width * TOKEN][half_vector + 1u] = halves.y;
        }
    }
}

// A matrix of results for every subgroup, or several: one in ROW_STRIDE of the workgroup's.
const uint RESULTS = OUT_HEIGHT * OUT_TILES / ROW_STRIDE;
MatrixSum results[RESULTS];

uint result_rows(const uint r) { return r * ROW_STRIDE + gl_SubgroupID / COLUMN_TILES; }

// results += the products of the workgroup's own tokens of step i's result with `adding`.
void add_results(const uint i) {
    const uint own = reach(i) - 1u, pitch = width_of(i) - 2u;
    [[unroll]] for (uint r = 0u; r < RESULTS; ++r) {
        uint m = result_rows(r);
        uint token = (m / OUT_TILES + own) * pitch + m % OUT_TILES * ROWS + own;
        [[unroll]] for (uint j = 0u; j < CHANNELS / DEPTH; ++j) {
            MatrixA inputs;
            coopMatLoad(inputs, steps, token * TOKEN + j * DEPTH / 8u, TOKEN, gl_CooperativeMatrixLayoutRowMajor);
            results[r] = coopMatMulAdd(inputs, adding[j], results[r]);
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
        uvec2 at = origin + uvec2(token % width_of(0u), token / width_of(0u)) - reach(0u);
        bool inside = all(lessThan(at, uvec2(width, height)));
        uvec4 halves = from.v[(inside ? at.y * width + at.x : 0u) * (src_stride / 2u)];
        steps[token * FIRST_TOKEN] = mix(uvec4(0u), halves, bvec4(inside));
        steps[token * FIRST_TOKEN + 1u] = uvec4(0u);
    }
    [[unroll]] for (uint i = 0u; i < RESULTS; ++i) results[i] = MatrixSum(0.0);
    // Whether the frame has all tokens around.
    uvec2 corner = origin - reach(0u);
    uvec2 around = uvec2(width_of(0u), height_of(0u)), size = uvec2(width, height);
    bool whole = all(lessThan(corner, size)) && all(lessThanEqual(corner + around, size));

    // Weights are loaded before the barrier after which they are used, so that they are there by then.
    load_mixing(pointwise_0, 16u);
    barrier();
    pointwise(width_of(0u) * height_of(0u), 16u, FIRST_TOKEN);
    Taps of = load_taps(pointwise_0, depthwise_0);
    barrier();
    depthwise(of, 0u, origin, whole);
    load_adding(out_0);
    load_mixing(pointwise_1, CHANNELS);
    barrier();
    add_results(0u);
    pointwise(width_of(1u) * height_of(1u), CHANNELS, TOKEN);
    of = load_taps(pointwise_1, depthwise_1);
    barrier();
    depthwise(of, 1u, origin, whole);
    load_adding(out_1);
    load_mixing(pointwise_2, CHANNELS);
    barrier();
    add_results(1u);
    pointwise(width_of(2u) * height_of(2u), CHANNELS, TOKEN);
    of = load_taps(pointwise_2, depthwise_2);
    barrier();
    depthwise(of, 2u, origin, whole);
    load_adding(out_2);
    barrier();
    add_results(2u);

    // The sums go through the shared memory of `mixed`, which nobody reads any more, because the bias depends on the
    // channel.
    const uint SUMS_STRIDE = CHANNELS / 4u + 1u;
    [[unroll]] for (uint r = 0u; r < RESULTS; ++r) {
        coopMatStore(results[r], mixed, result_rows(r) * ROWS * SUMS_STRIDE + own_column / 4u, SUMS_STRIDE,
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
