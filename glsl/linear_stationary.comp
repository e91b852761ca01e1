// Pointwise convolution with its inputs held: act(film(W a + bias) + residual), 4*INPUTS input channels of one map. An
// invocation loads all channels of its TX x TY tokens once, then makes four outputs after another from them. Where
// linear_cpu.comp holds the sums and streams the inputs, no sum lives here longer than a turn of the loop: CPU drivers
// keep a mask for every loop, by which they select and store whatever a turn changes.
//
// NORM: every token is brought to mean 0 and variance 1 over its channels first; gain and bias are in the weights.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/lanes.glsl"
#include "shared/tiles.glsl"
#include "shared/epilogue.glsl"
const int PIXELS = TX * TY;
const int PACKED_NV = 8;      // weights are packed as glsl/shared/microkernel.glsl says
TEXELS_OF(0, src)
TEXELS_OF(1, weights)
TEXELS_OF(2, film)
TEXELS_OF(3, residual)
TEXELS_OF(4, src_b)           // of glsl/linear_cpu.comp, which takes the same push constants and bindings

// Input channels whose weights are loaded at a time. All at once are more than the registers hold; fewer are faster
// where lanes share by broadcast, slower elsewhere (docs/lavapipe.md).
#ifdef BROADCAST
const int CHUNK = min(4 * INPUTS, 16);
#else
const int CHUNK = 4 * INPUTS;
#endif

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Source src_b;
    Target dst;
    Weights weights;      // [bias | packed weights]
    Weights film;         // [gamma | beta] with FLAG_FILM
    Residual residual;    // with FLAG_RESIDUAL
    TileList tiles;       // with FLAG_TILE_LIST
    uint src_stride;      // strides and channel counts in vectors of four
    uint src_channels;
    uint src_b_stride;
    uint src_b_channels;
    uint width;
    uint dst_stride;
    uint dst_channels;
    uint residual_stride;
    uint bias_vectors;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

#ifdef NORM
#include "shared/norm.glsl"
#endif

const uint LANES_X = 8 / TX;
const uint LANES = 64 / PIXELS;

void main() {
    uint slot = group_index() * (64u / LANES) + gl_LocalInvocationID.x / LANES;
    uint count = tiles_of(tile_count, flags, tiles);
    bool live = slot < count;
    LEAVE_UNLESS(live)
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint lane = gl_LocalInvocationID.x % LANES;
    uvec2 base = origin + uvec2(lane % LANES_X, lane / LANES_X) * uvec2(TX, TY);

    uint pixels[PIXELS];
    vec4 inputs[PIXELS * INPUTS];
    [[unroll]] for (int p = 0; p < PIXELS; ++p) pixels[p] = (base.y + p / TX) * width + base.x + p % TX;
    [[unroll]] for (int i = 0; i < INPUTS; ++i) {
        // Other lines of the processor's cache one after another, so that it waits for many at a time.
        int k = INPUTS < 4 ? i : i % (INPUTS / 4) * 4 + i / (INPUTS / 4);
        [[unroll]] for (int p = 0; p < PIXELS; ++p) inputs[p * INPUTS + k] = LOAD(src, pixels[p] * src_stride + k);
    }
    [[unroll]] for (int p = 0; p < PIXELS; ++p) {
#ifdef NORM
        vec4 sum = vec4(0.0);
        [[unroll]] for (int k = 0; k < INPUTS; ++k) sum += inputs[p * INPUTS + k];
        float mean = mean_of(sum, INPUTS);
        vec4 squares = vec4(0.0);
        [[unroll]] for (int k = 0; k < INPUTS; ++k) {
            vec4 d = inputs[p * INPUTS + k] - mean;
            squares += d * d;
            inputs[p * INPUTS + k] = d;
        }
        float scale = scale_of(squares, INPUTS);
        [[unroll]] for (int k = 0; k < INPUTS; ++k) inputs[p * INPUTS + k] *= scale;
#endif
    }

    for (uint n = 0u; n < dst_channels; ++n) {
        vec4 bias = LOAD_WEIGHTS(weights, n);
        vec4 sums[PIXELS];
        [[unroll]] for (int p = 0; p < PIXELS; ++p) sums[p] = bias;
        [[unroll]] for (int from = 0; from < 4 * INPUTS; from += CHUNK) {
            // Every lane loads the weights of other input channels, for four outputs, and hands them round.
            uint input_channel = from + min(LANE, uint(CHUNK - 1));
            uint block = bias_vectors + (n / PACKED_NV * uint(4 * INPUTS) + input_channel) * PACKED_NV + n % PACKED_NV;
            vec4 lane_weights[PER_LANE(CHUNK)];
            [[unroll]] for (int i = 0; i < PER_LANE(CHUNK); ++i) {
                lane_weights[i] = LOAD_WEIGHTS(weights, block + i * SHARING * PACKED_NV);
            }
            [[unroll]] for (int k = 0; k < CHUNK; ++k) {
                vec4 w = FROM_LANE(lane_weights[k / SHARING], uint(k % SHARING));
                [[unroll]] for (int p = 0; p < PIXELS; ++p) sums[p] += inputs[p * INPUTS + (from + k) / 4][k % 4] * w;
            }
        }
        [[unroll]] for (int p = 0; p < PIXELS; ++p) {
            vec4 value = sums[p];
            if ((EPILOGUE & FLAG_FILM) != 0u) {
                value = LOAD_WEIGHTS(film, n) * value + LOAD_WEIGHTS(film, dst_channels + n);
            }
            if ((EPILOGUE & FLAG_RESIDUAL) != 0u) value += LOAD(residual, pixels[p] * residual_stride + n);
            if (live) STORE(dst, pixels[p] * dst_stride + n, activate(value, EPILOGUE));
        }
    }
}
