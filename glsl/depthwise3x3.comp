// Depthwise 3x3 convolution, zero padding, bias, activation. An invocation computes TX x TY tokens of four
// channels.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/epilogue.glsl"
TEXELS_OF(0, src)
TEXELS_OF(1, weights)

const uint RUNS = 64 / (TX * TY);             // per tile
layout(local_size_x = 8 * RUNS) in;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | 9 taps], each of all channels
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint src_stride;      // strides and channel counts in vectors of four
    uint dst_stride;
    uint channels;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

void main() {
    uint slot = group_index();
    uint channel = gl_WorkGroupID.y * 8u + gl_LocalInvocationID.x % 8u;
    if (slot >= tiles_of(tile_count, flags, tiles) || channel >= channels) return;
    uvec2 origin = tile_origin(slot, first_tile, flags, tiles);
    uint run = gl_LocalInvocationID.x / 8u;
    ivec2 base = ivec2(origin) + ivec2(run % (8u / TX), run / (8u / TX)) * ivec2(TX, TY);

    // All loads first, then one channel after another: a CPU driver saves all registers at every load, and has few.
    vec4 patch_rows[(TX + 2) * (TY + 2)];
    [[unroll]] for (int y = 0; y < TY + 2; ++y) {
        int sy = base.y + y - 1;
        bool row_inside = sy >= 0 && sy < int(height);
        uint row_base = uint(clamp(sy, 0, int(height) - 1)) * width;
        [[unroll]] for (int x = 0; x < TX + 2; ++x) {
            int sx = base.x + x - 1;
            bool inside = row_inside && sx >= 0 && sx < int(width);
            uint index = (row_base + uint(clamp(sx, 0, int(width) - 1))) * src_stride + channel;
            patch_rows[y * (TX + 2) + x] = LOAD_WHERE(inside, src, index);
        }
    }
    vec4 taps[9];
    [[unroll]] for (int t = 0; t < 9; ++t) taps[t] = LOAD_WEIGHTS(weights, (t + 1) * channels + channel);
    vec4 bias = LOAD_WEIGHTS(weights, channel);
    vec4 sums[TX * TY];
    [[unroll]] for (int c = 0; c < 4; ++c) {
        [[unroll]] for (int p = 0; p < TX * TY; ++p) {
            float sum = bias[c];
            [[unroll]] for (int t = 0; t < 9; ++t) {
                sum += taps[t][c] * patch_rows[(p / TX + t / 3) * (TX + 2) + p % TX + t % 3][c];
            }
            sums[p][c] = sum;
        }
    }
    [[unroll]] for (int p = 0; p < TX * TY; ++p) {
        uint pixel = uint((base.y + p / TX) * int(width) + base.x + p % TX);
        STORE(dst, pixel * dst_stride + channel, activate(sums[p], EPILOGUE));
    }
}
