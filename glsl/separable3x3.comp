// A depthwise 3x3 convolution with its activation and the pointwise convolution after it, in one: act(film(W inner +
// bias) + residual), inner = inner_act(depthwise3x3(src) + its bias), zero padding. What is between them never reaches
// memory; every tile of output channels computes it again.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/epilogue.glsl"
const int PIXELS = TX * TY;
TEXELS_OF(0, src)
TEXELS_OF(1, weights)
TEXELS_OF(2, film)
TEXELS_OF(3, residual)
TEXELS_OF(4, depthwise)
#include "shared/microkernel.glsl"

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | packed weights] of the pointwise one
    Weights film;         // [gamma | beta] with FLAG_FILM
    Residual residual;    // with FLAG_RESIDUAL
    Weights depthwise;    // [bias | 9 taps], each of all channels
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint src_stride;      // strides and channel counts in vectors of four
    uint src_channels;
    uint dst_stride;
    uint dst_channels;
    uint residual_stride;
    uint bias_vectors;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

layout(constant_id = 1) const uint INNER_EPILOGUE = 0u;        // the activation between

const uint LANES_X = 8 / TX;
const uint LANES = 64 / PIXELS;

vec4 activations[PIXELS];

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
    uint block_base = bias_vectors + tile_n * src_channels * BLOCK;
#define ACTIVATION(p) activations[p]
    for (uint k = 0u; k < src_channels; ++k) {
        vec4 inner_bias = LOAD_WEIGHTS(depthwise, k);
        vec4 taps[9];
        [[unroll]] for (int t = 0; t < 9; ++t) taps[t] = LOAD_WEIGHTS(depthwise, (t + 1) * src_channels + k);
        [[unroll]] for (int p = 0; p < PIXELS; ++p) activations[p] = inner_bias;
        [[unroll]] for (int y = -1; y <= TY; ++y) {
            int sy = base.y + y;
            bool row_inside = sy >= 0 && sy < int(height);
            uint row_base = uint(clamp(sy, 0, int(height) - 1)) * width;
            [[unroll]] for (int x = -1; x <= TX; ++x) {
                int sx = base.x + x;
                bool inside = row_inside && sx >= 0 && sx < int(width);
                uint index = (row_base + uint(clamp(sx, 0, int(width) - 1))) * src_stride + k;
                vec4 value = LOAD_WHERE(inside, src, index);
                [[unroll]] for (int ky = 0; ky < 3; ++ky) {
                    [[unroll]] for (int kx = 0; kx < 3; ++kx) {
                        int py = y + 1 - ky;
                        int px = x + 1 - kx;
                        if (py >= 0 && py < TY && px >= 0 && px < TX) {
                            activations[py * TX + px] += taps[ky * 3 + kx] * value;
                        }
                    }
                }
            }
        }
        [[unroll]] for (int p = 0; p < PIXELS; ++p) activations[p] = activate(activations[p], INNER_EPILOGUE);
        MULTIPLY_ADD(weights, block_base, ACTIVATION)
        block_base += BLOCK;
    }
    if (!live) return;

    [[unroll]] for (int n = 0; n < NV; ++n) {
        uint channel = tile_n * NV + n;
        if (channel >= dst_channels) continue;
        [[unroll]] for (int p = 0; p < PIXELS; ++p) {
            uint pixel = uint((base.y + p / TX) * int(width) + base.x + p % TX);
            vec4 value = accumulators[p * NV + n];
            if ((EPILOGUE & FLAG_FILM) != 0u) {
                value = LOAD_WEIGHTS(film, channel) * value + LOAD_WEIGHTS(film, dst_channels + channel);
            }
            if ((EPILOGUE & FLAG_RESIDUAL) != 0u) value += LOAD(residual, pixel * residual_stride + channel);
            STORE(dst, pixel * dst_stride + channel, activate(value, EPILOGUE));
        }
    }
}
