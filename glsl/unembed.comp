// Tokens of 2x2 pixels to pixels of three channels: a 3x3 convolution, a pixel shuffle and another 3x3 convolution as
// one sum over 4x4 tokens for every pixel. An invocation computes one row of pixels of TX tokens in a row.
//
// On the frame's border the second convolution reads zeros, so that the sums there have weights of their own. Every set
// of weights that a token nearby needs is gone through by all, and every token stores the result of its own.
#version 460
#extension GL_EXT_control_flow_attributes : require
#ifdef LANES_SHARE
#include "shared/lanes.glsl"
#extension GL_KHR_shader_subgroup_vote : require
#endif
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
TEXELS_OF(0, src)
TEXELS_OF(1, weights)

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    // [bias | [row of pixels][set][row of tokens][input channel / 4][4 inputs][pixel of 2][token of 4]]
    Weights weights;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;           // of the tokens
    uint height;
    uint src_stride;      // strides and channel counts in vectors of four
    uint channels;
    uint dst_stride;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

const uint LANES_X = 8 / TX;
const uint LANES = 64 / TX;                    // invocations per tile
const uint ROWS = 4u;
const uint SETS = 6u;
const int BLOCK = 32;                          // vectors of weights for four input channels

#ifdef LANES_SHARE
vec4 lane_weights[PER_LANE(BLOCK)];
#define FETCH_WEIGHTS(base) \
    { uint from = (base) + SHARED_FIRST(BLOCK); \
      [[unroll]] for (int i = 0; i < PER_LANE(BLOCK); ++i) lane_weights[i] = LOAD_WEIGHTS(weights, from + i); }
#define WEIGHT(base, j) SHARED(lane_weights, BLOCK, j).xyz
#define FOR_ANY(condition) subgroupAny(condition)
#else
#define FETCH_WEIGHTS(base)
#define WEIGHT(base, j) LOAD_WEIGHTS(weights, (base) + (j)).xyz
#define FOR_ANY(condition) (condition)
#endif

vec3 sums[2 * TX];
vec4 row[TX + 4];

void main() {
    uint slot = group_index() * (64u / LANES) + gl_LocalInvocationID.x / LANES;
    uint count = tiles_of(tile_count, flags, tiles);
    bool live = slot < count;
    LEAVE_UNLESS(live)
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint lane = gl_LocalInvocationID.x % LANES;
    ivec2 base = ivec2(origin) + ivec2(lane % LANES_X * TX, lane / LANES_X);
    uint dy = gl_WorkGroupID.y;

    uint border_y = (dy == 0u ? base.y == 0 : base.y + 1 == int(height)) ? 1u : 0u;
    bool left = base.x == 0;
    bool right = base.x + TX == int(width);
    vec3 bias = LOAD_WEIGHTS(weights, 0).xyz;
    for (uint set = 0u; set < SETS; ++set) {
        uint side = set % 3u;
        bool own = set / 3u == border_y && (side == 0u || (side == 1u ? left : right));
        if (!FOR_ANY(own)) continue;
        uint weight_base = 1u + (dy * SETS + set) * ROWS * channels * BLOCK;
        [[unroll]] for (int i = 0; i < 2 * TX; ++i) sums[i] = bias;
        for (uint y = 0u; y < ROWS; ++y) {
            int sy = base.y + int(dy + y) - 2;
            bool row_inside = sy >= 0 && sy < int(height);
            uint row_base = uint(clamp(sy, 0, int(height) - 1)) * width;
            for (uint k = 0u; k < channels; ++k) {
                [[unroll]] for (int x = 0; x < TX + 4; ++x) {
                    int sx = base.x + x - 2;
                    bool inside = row_inside && sx >= 0 && sx < int(width);
                    uint index = (row_base + uint(clamp(sx, 0, int(width) - 1))) * src_stride + k;
                    row[x] = LOAD_WHERE(inside, src, index);
                }
                uint block_base = weight_base + (y * channels + k) * BLOCK;
                FETCH_WEIGHTS(block_base)
                [[unroll]] for (int j = 0; j < 8; ++j) {
                    vec3 w0 = WEIGHT(block_base, j);
                    vec3 w1 = WEIGHT(block_base, 8 + j);
                    vec3 w2 = WEIGHT(block_base, 16 + j);
                    vec3 w3 = WEIGHT(block_base, 24 + j);
                    [[unroll]] for (int p = 0; p < TX; ++p) {
                        vec4 a = row[p + j / 4 + j % 4];
                        sums[2 * p + j / 4] += a.x * w0 + a.y * w1 + a.z * w2 + a.w * w3;
                    }
                }
            }
        }
        if (!live || !own) continue;
        [[unroll]] for (int p = 0; p < TX; ++p) {
            uvec2 at = uvec2(base) + uvec2(p, 0);
            uint its_side = at.x == 0u ? 1u : at.x + 1u == width ? 2u : 0u;
            if (its_side != side) continue;
            uint pixel = ((2u * at.y + dy) * width + at.x) * 2u;
            STORE(dst, pixel * dst_stride, vec4(sums[2 * p], 0.0));
            STORE(dst, (pixel + 1u) * dst_stride, vec4(sums[2 * p + 1], 0.0));
        }
    }
}
