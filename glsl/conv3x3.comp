// Dense 3x3 convolution, zero padding, stride STRIDE, with its epilogue: act(film(sum + bias) + residual), stored
// plain, pixel-shuffled or pixel-unshuffled. For CPU drivers; on GPUs to at most 16 channels, the others are those of
// conv3x3_staged.comp.
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

// Three taps of a row share what they load. ROLLED keeps a turn of the loop to one tap, as CPU drivers take longer over
// a turn of three, and all nine taps share by moving on what was loaded. BY_TAP loads for every tap anew, in one loop
// of less code, which at a stride of 2, where taps share less, is faster.
#ifndef BY_TAP
const int PATCH_X = (TX - 1) * STRIDE + 3;
vec4 row[TY * PATCH_X];

// Row `number` of `rows` from the inputs to the right of `from`.
#define LOAD_ROW(rows, number, from, k) { \
    ivec2 at = from; \
    bool row_inside = at.y >= 0 && at.y < int(src_height); \
    uint row_base = uint(clamp(at.y, 0, int(src_height) - 1)) * src_width; \
    [[unroll]] for (int x = 0; x < PATCH_X; ++x) { \
        bool inside = row_inside && at.x + x >= 0 && at.x + x < int(src_width); \
        uint index = (row_base + uint(clamp(at.x + x, 0, int(src_width) - 1))) * src_stride + k; \
        rows[(number) * PATCH_X + x] = LOAD_WHERE(inside, src, index); \
    } \
}
#endif

void main() {
    uint slot = group_index() * (64u / LANES) + gl_LocalInvocationID.x / LANES;
    uint count = tiles_of(tile_count, flags, tiles);
    bool live = slot < count;
    LEAVE_UNLESS(live)
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint lane = gl_LocalInvocationID.x % LANES;
    ivec2 base = ivec2(origin) + ivec2(lane % LANES_X, lane / LANES_X) * ivec2(TX, TY);
    uint tile_n = gl_WorkGroupID.y;

    clear_accumulators(weights, tile_n);
    uint weight_base = bias_vectors + tile_n * 9u * src_channels * BLOCK;
    ivec2 corner = base * STRIDE - 1;
#ifdef ROLLED
    const int ROWS = (TY - 1) * STRIDE + 1;        // of inputs that the tokens need at a time
    for (uint k = 0u; k < src_channels; ++k) {
        vec4 rows[ROWS * PATCH_X];
        [[unroll]] for (int y = 1; y < ROWS; ++y) LOAD_ROW(rows, y, corner + ivec2(0, y - 1), k);
        [[dont_unroll]] for (int ky = 0; ky < 3; ++ky) {
            [[unroll]] for (int i = 0; i < (ROWS - 1) * PATCH_X; ++i) rows[i] = rows[i + PATCH_X];
            LOAD_ROW(rows, ROWS - 1, corner + ivec2(0, ROWS - 1 + ky), k);
            [[unroll]] for (int y = 0; y < TY; ++y) {
                [[unroll]] for (int x = 0; x < PATCH_X; ++x) row[y * PATCH_X + x] = rows[y * STRIDE * PATCH_X + x];
            }
            [[dont_unroll]] for (int kx = 0; kx < 3; ++kx) {
                uint block_base = weight_base + (uint(ky * 3 + kx) * src_channels + k) * BLOCK;
#define MOVED(p) row[(p) / TX * PATCH_X + (p) % TX * STRIDE]
                MULTIPLY_ADD(weights, block_base, MOVED)
                [[unroll]] for (int i = 0; i < TY * PATCH_X - 1; ++i) row[i] = row[i + 1];
            }
        }
    }
#elif defined(BY_TAP)
    [[dont_unroll]] for (int tap = 0; tap < 9; ++tap) {
        uint from[PIXELS];
        bool inside[PIXELS];
        [[unroll]] for (int p = 0; p < PIXELS; ++p) {
            ivec2 at = corner + ivec2(tap % 3, tap / 3) + ivec2(p % TX, p / TX) * STRIDE;
            ivec2 nearest = clamp(at, ivec2(0), ivec2(src_width, src_height) - 1);
            inside[p] = at == nearest;
            from[p] = uint(nearest.y * int(src_width) + nearest.x) * src_stride;
        }
        for (uint k = 0u; k < src_channels; ++k) {
            vec4 inputs[PIXELS];
            [[unroll]] for (int p = 0; p < PIXELS; ++p) inputs[p] = LOAD_WHERE(inside[p], src, from[p] + k);
            uint block_base = weight_base + (uint(tap) * src_channels + k) * BLOCK;
#define OF_TAP(p) inputs[p]
            MULTIPLY_ADD(weights, block_base, OF_TAP)
        }
    }
#else
    for (int ky = 0; ky < 3; ++ky) {
        for (uint k = 0u; k < src_channels; ++k) {
            [[unroll]] for (int y = 0; y < TY; ++y) LOAD_ROW(row, y, corner + ivec2(0, y * STRIDE + ky), k);
            [[unroll]] for (int kx = 0; kx < 3; ++kx) {
                uint block_base = weight_base + ((ky * 3 + kx) * src_channels + k) * BLOCK;
#define PATCH(p) row[((p) / TX) * PATCH_X + ((p) % TX) * STRIDE + kx]
                MULTIPLY_ADD(weights, block_base, PATCH)
            }
        }
    }
#endif
#if defined(BROADCAST) && !defined(DST_F16)
    // Two vectors of eight sums are stored as one of eight 64-bit words. A sum that is stored as it is would be a part
    // of those from the start: lavapipe's compiler keeps it so through the whole loop, in twice the room. A factor of 1
    // that it cannot know keeps them apart. (Halves are packed first, and Mesa 22.3's takes longer so.)
    if ((EPILOGUE & ~FLAG_SHUFFLE) == 0u) {
        [[unroll]] for (int i = 0; i < PIXELS * NV; ++i) accumulators[i] *= live ? 1.0 : 0.0;
    }
#endif
    if (!live) return;

    [[unroll]] for (int n = 0; n < NV; ++n) {
        uint channel = tile_n * NV + n;
        if (channel >= dst_channels) continue;
        [[unroll]] for (int p = 0; p < PIXELS; ++p) {
            store_result(uvec2(base + ivec2(p % TX, p / TX)), channel, accumulators[p * NV + n]);
        }
    }
}
