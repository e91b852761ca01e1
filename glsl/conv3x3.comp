// Dense 3x3 convolution, zero padding, stride STRIDE, with its epilogue: act(film(sum + bias) + residual), stored plain,
// pixel-shuffled or pixel-unshuffled.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/epilogue.glsl"
// One invocation: TX x TY neighbouring outputs.
const int PIXELS = TX * TY;
TEXELS_OF(0, src)
TEXELS_OF(1, weights)
TEXELS_OF(2, film)
TEXELS_OF(3, residual)
#include "shared/microkernel.glsl"

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | packed weights]
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

const uint LANES_X = 8 / TX;
const uint LANES = 64 / PIXELS;                // invocations per tile

// Three taps of a row share what they load. TAP_BY_TAP loads for every tap anew, which keeps the loop a third as long:
// with wide tiles CPU drivers unroll it beyond the instruction cache.
const int PATCH_X = (TX - 1) * STRIDE + 3;
vec4 row[TY * PATCH_X];

void main() {
    uint slot = group_index() * (64u / LANES) + gl_LocalInvocationID.x / LANES;
    uint count = tiles_of(tile_count, flags, tiles);
    if (count == 0u) return;
    bool live = slot < count;
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint lane = gl_LocalInvocationID.x % LANES;
    ivec2 base = ivec2(origin) + ivec2(lane % LANES_X, lane / LANES_X) * ivec2(TX, TY);
    uint tile_n = gl_WorkGroupID.y;

    clear_accumulators(weights, tile_n);
    uint weight_base = bias_vectors + tile_n * 9u * src_channels * BLOCK;
    ivec2 corner = base * STRIDE - 1;
#ifdef TAP_BY_TAP
    for (int tap = 0; tap < 9; ++tap) {
        uint from[PIXELS];
        bool inside[PIXELS];
        [[unroll]] for (int p = 0; p < PIXELS; ++p) {
            ivec2 at = corner + ivec2(tap % 3, tap / 3) + ivec2(p % TX, p / TX) * STRIDE;
            inside[p] = at.x >= 0 && at.x < int(src_width) && at.y >= 0 && at.y < int(src_height);
            from[p] = inside[p] ? uint(at.y * int(src_width) + at.x) * src_stride : 0u;
        }
        for (uint k = 0u; k < src_channels; ++k) {
            [[unroll]] for (int p = 0; p < PIXELS; ++p) row[p] = LOAD_WHERE(inside[p], src, from[p] + k);
#define TAP_PIXEL(p) row[p]
            MULTIPLY_ADD(weights, weight_base + (tap * src_channels + k) * BLOCK, TAP_PIXEL)
        }
    }
#else
    for (int ky = 0; ky < 3; ++ky) {
        for (uint k = 0u; k < src_channels; ++k) {
            [[unroll]] for (int y = 0; y < TY; ++y) {
                int sy = corner.y + y * STRIDE + ky;
                bool row_inside = sy >= 0 && sy < int(src_height);
                uint row_base = uint(clamp(sy, 0, int(src_height) - 1)) * src_width;
                [[unroll]] for (int x = 0; x < PATCH_X; ++x) {
                    int sx = corner.x + x;
                    bool inside = row_inside && sx >= 0 && sx < int(src_width);
                    uint index = (row_base + uint(clamp(sx, 0, int(src_width) - 1))) * src_stride + k;
                    row[y * PATCH_X + x] = LOAD_WHERE(inside, src, index);
                }
            }
            [[unroll]] for (int kx = 0; kx < 3; ++kx) {
                uint block_base = weight_base + ((ky * 3 + kx) * src_channels + k) * BLOCK;
#define PATCH(p) row[((p) / TX) * PATCH_X + ((p) % TX) * STRIDE + kx]
                MULTIPLY_ADD(weights, block_base, PATCH)
            }
        }
    }
#endif
    if (!live) return;

    [[unroll]] for (int p = 0; p < PIXELS; ++p) {
        uvec2 at = uvec2(base + ivec2(p % TX, p / TX));
        [[unroll]] for (int n = 0; n < NV; ++n) {
            uint channel = tile_n * NV + n;
            if (channel < dst_channels) store_result(at, channel, accumulators[p * NV + n]);
        }
    }
}
