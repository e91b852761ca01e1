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
    Source residual;      // with FLAG_RESIDUAL
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
    uint tiles_x;
    uint tile_count;
    uint flags;
};

const uint LANES_X = 8 / TX;
const uint LANES = 64 / PIXELS;                // invocations per tile
const int PATCH_X = (TX - 1) * STRIDE + 3;

vec4 row[TY * PATCH_X];

void main() {
    uint slot = group_index() * (64u / LANES) + gl_LocalInvocationID.x / LANES;
    bool live = slot < tile_count;
    uvec2 tile = tile_position(min(slot, tile_count - 1u), tiles_x, flags, tiles);
    uint lane = gl_LocalInvocationID.x % LANES;
    ivec2 base = ivec2(tile * 8u) + ivec2(lane % LANES_X, lane / LANES_X) * ivec2(TX, TY);
    uint tile_n = gl_WorkGroupID.y;

    clear_accumulators(weights, tile_n);
    uint weight_base = bias_vectors + tile_n * 9u * src_channels * BLOCK;
    ivec2 corner = base * STRIDE - 1;
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
                    row[y * PATCH_X + x] = inside ? LOAD(src, index) : vec4(0.0);
                }
            }
            [[unroll]] for (int kx = 0; kx < 3; ++kx) {
                uint block_base = weight_base + ((ky * 3 + kx) * src_channels + k) * BLOCK;
#define PATCH(p) row[((p) / TX) * PATCH_X + ((p) % TX) * STRIDE + kx]
                MULTIPLY_ADD(weights, block_base, PATCH)
            }
        }
    }
    if (!live) return;

    [[unroll]] for (int p = 0; p < PIXELS; ++p) {
        uvec2 at = uvec2(base + ivec2(p % TX, p / TX));
        uint pixel = at.y * dst_width + at.x;
        [[unroll]] for (int n = 0; n < NV; ++n) {
            uint channel = tile_n * NV + n;
            if (channel >= dst_channels) continue;
            vec4 value = accumulators[p * NV + n];
            if ((flags & FLAG_FILM) != 0u) value = LOAD_WEIGHTS(film, channel) * value + LOAD_WEIGHTS(film, dst_channels + channel);
            if ((flags & FLAG_RESIDUAL) != 0u) value += LOAD(residual, pixel * residual_stride + channel);
            value = activate(value, flags);
            if ((flags & FLAG_SHUFFLE) != 0u) {
                // The packer has ordered the outputs [phase][channel], so that a vector stays within one phase.
                uint quarter = dst_channels / 4u;
                uint phase = channel / quarter;
                uvec2 to = at * 2u + uvec2(phase & 1u, phase >> 1);
                STORE(dst, (to.y * dst_width * 2u + to.x) * dst_stride + channel % quarter, value);
            } else if ((flags & FLAG_UNSHUFFLE) != 0u) {
                // Channel c of pixel (2x + dx, 2y + dy) becomes channel 4c + 2dy + dx of (x, y): one scalar of four vectors.
                uint to = ((at.y / 2u) * (dst_width / 2u) + at.x / 2u) * dst_stride + channel * 4u;
                uint component = (at.y & 1u) * 2u + (at.x & 1u);
                TargetScalars scalars = TargetScalars(dst);
                [[unroll]] for (int c = 0; c < 4; ++c) STORE_SCALAR(scalars, (to + c) * 4u + component, value[c]);
            } else {
                STORE(dst, pixel * dst_stride + channel, value);
            }
        }
    }
}
