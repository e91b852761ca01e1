// Dense 3x3 convolution, zero padding, stride 1, by Winograd's minimal filtering F(OUT x OUT, 3x3) (Lavin and Gray,
// "Fast Algorithms for Convolutional Neural Networks", 2015): A^T [sum over inputs of (G g G^T) * (B^T d B)] A. The
// weights come transformed. With the epilogue of conv3x3.comp.
//
// An invocation keeps its tiles' sums at all points in registers: TX tiles side by side, 4 * NV output channels.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/epilogue.glsl"

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | [output / 4][input / 4][point][4 inputs]]
    Weights film;         // [gamma | beta] with FLAG_FILM
    Residual residual;    // with FLAG_RESIDUAL
    TileList tiles;       // with FLAG_TILE_LIST
    uint src_width;
    uint src_height;
    uint src_stride;      // strides and channel counts in vectors of four
    uint src_channels;
    uint dst_width;       // of the convolution's result, before any shuffle
    uint dst_stride;
    uint dst_channels;
    uint residual_stride;
    uint bias_vectors;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

#include "shared/conv_store.glsl"

const int IN = OUT + 2;
const int POINTS = IN * IN;
const int COLUMNS = OUT * TX + 2;              // of the inputs of an invocation's tiles
const uint LANES_X = 8 / (OUT * TX);
const uint LANES = LANES_X * (8 / OUT);        // invocations per tile of 8x8

vec4 sums[NV * TX * POINTS];
vec4 inputs[IN * COLUMNS];
vec4 points[TX * POINTS];

#if OUT == 2
// Points 0, 1, -1 and infinity.
#define TRANSFORM_IN(to, a, from, b) { \
    vec4 x0 = from[b(0)], x1 = from[b(1)], x2 = from[b(2)], x3 = from[b(3)]; \
    to[a(0)] = x0 - x2; \
    to[a(1)] = x1 + x2; \
    to[a(2)] = x2 - x1; \
    to[a(3)] = x1 - x3; \
}
#define TRANSFORM_OUT(to, a, from, b) { \
    vec4 x0 = from[b(0)], x1 = from[b(1)], x2 = from[b(2)], x3 = from[b(3)]; \
    to[a(0)] = x0 + x1 + x2; \
    to[a(1)] = x1 - x2 - x3; \
}
#else
// Points 0, 1, -1, 2, -2 and infinity.
#define TRANSFORM_IN(to, a, from, b) { \
    vec4 x0 = from[b(0)], x1 = from[b(1)], x2 = from[b(2)], x3 = from[b(3)], x4 = from[b(4)], x5 = from[b(5)]; \
    vec4 even = x4 - 4.0 * x2; \
    vec4 odd = x3 - 4.0 * x1; \
    vec4 even2 = x4 - x2; \
    vec4 odd2 = 2.0 * (x3 - x1); \
    to[a(0)] = 4.0 * (x0 - x2) + even2; \
    to[a(1)] = even + odd; \
    to[a(2)] = even - odd; \
    to[a(3)] = even2 + odd2; \
    to[a(4)] = even2 - odd2; \
    to[a(5)] = 4.0 * (x1 - x3) + x5 - x3; \
}
#define TRANSFORM_OUT(to, a, from, b) { \
    vec4 x0 = from[b(0)], x1 = from[b(1)], x2 = from[b(2)], x3 = from[b(3)], x4 = from[b(4)], x5 = from[b(5)]; \
    vec4 even = x1 + x2; \
    vec4 odd = x1 - x2; \
    vec4 even2 = x3 + x4; \
    vec4 odd2 = x3 - x4; \
    to[a(0)] = x0 + even + even2; \
    to[a(1)] = odd + 2.0 * odd2; \
    to[a(2)] = even + 4.0 * even2; \
    to[a(3)] = odd + 8.0 * odd2 + x5; \
}
#endif

void main() {
    uint slot = group_index() * (64u / LANES) + gl_LocalInvocationID.x / LANES;
    uint count = tiles_of(tile_count, flags, tiles);
    if (slot >= count) return;
    uvec2 origin = tile_origin(slot, first_tile, flags, tiles);
    uint lane = gl_LocalInvocationID.x % LANES;
    ivec2 base = ivec2(origin) + ivec2(lane % LANES_X, lane / LANES_X) * ivec2(OUT * TX, OUT);
    uint first_channel = gl_WorkGroupID.y * NV;

    [[unroll]] for (int i = 0; i < NV * TX * POINTS; ++i) sums[i] = vec4(0.0);
    for (uint k = 0u; k < src_channels; ++k) {
        [[unroll]] for (int y = 0; y < IN; ++y) {
            int sy = base.y + y - 1;
            bool row_inside = sy >= 0 && sy < int(src_height);
            uint row_base = uint(clamp(sy, 0, int(src_height) - 1)) * src_width;
            [[unroll]] for (int x = 0; x < COLUMNS; ++x) {
                int sx = base.x + x - 1;
                bool inside = row_inside && sx >= 0 && sx < int(src_width);
                uint index = (row_base + uint(clamp(sx, 0, int(src_width) - 1))) * src_stride + k;
                inputs[y * COLUMNS + x] = LOAD_WHERE(inside, src, index);
            }
        }
        [[unroll]] for (int x = 0; x < COLUMNS; ++x) {
#define COLUMN(i) (i) * COLUMNS + x
            TRANSFORM_IN(inputs, COLUMN, inputs, COLUMN)
        }
        [[unroll]] for (int t = 0; t < TX; ++t) {
            [[unroll]] for (int y = 0; y < IN; ++y) {
#define INPUT_ROW(i) y * COLUMNS + t * OUT + (i)
#define POINT_ROW(i) t * POINTS + y * IN + (i)
                TRANSFORM_IN(points, POINT_ROW, inputs, INPUT_ROW)
            }
        }
        [[unroll]] for (int n = 0; n < NV; ++n) {
            uint block_base = bias_vectors + ((first_channel + n) * src_channels + k) * POINTS * 4u;
            [[unroll]] for (int y = 0; y < IN; ++y) {
                [[unroll]] for (int x = 0; x < IN; ++x) {
                    vec4 w0 = weights.v[block_base + uint((y * IN + x) * 4)];
                    vec4 w1 = weights.v[block_base + uint((y * IN + x) * 4 + 1)];
                    vec4 w2 = weights.v[block_base + uint((y * IN + x) * 4 + 2)];
                    vec4 w3 = weights.v[block_base + uint((y * IN + x) * 4 + 3)];
                    [[unroll]] for (int t = 0; t < TX; ++t) {
                        vec4 a = points[t * POINTS + y * IN + x];
                        sums[(n * TX + t) * POINTS + y * IN + x] += a.x * w0 + a.y * w1 + a.z * w2 + a.w * w3;
                    }
                }
            }
        }
    }

    [[unroll]] for (int n = 0; n < NV; ++n) {
        uint channel = first_channel + n;
        if (channel >= dst_channels) continue;
        vec4 bias = LOAD_WEIGHTS(weights, channel);
        [[unroll]] for (int t = 0; t < TX; ++t) {
            vec4 rows[OUT * IN];
            vec4 results[OUT * OUT];
            [[unroll]] for (int x = 0; x < IN; ++x) {
#define SUM_COLUMN(i) (n * TX + t) * POINTS + (i) * IN + x
#define ROWS_COLUMN(i) (i) * IN + x
                TRANSFORM_OUT(rows, ROWS_COLUMN, sums, SUM_COLUMN)
            }
            [[unroll]] for (int y = 0; y < OUT; ++y) {
#define ROWS_ROW(i) y * IN + (i)
#define RESULT_ROW(i) y * OUT + (i)
                TRANSFORM_OUT(results, RESULT_ROW, rows, ROWS_ROW)
            }
            [[unroll]] for (int p = 0; p < OUT * OUT; ++p) {
                uvec2 at = uvec2(base + ivec2(t * OUT + p % OUT, p / OUT));
                store_result(at, channel, results[p] + bias);
            }
        }
    }
}
