// What kernels are predicted from, 32 numbers a pixel, and what their taps read: the reliability times the image, and
// the reliability.
//
// A workgroup works on 8x8 tokens of 2x2 pixels. An invocation works on TX tokens in a row, in each on the pixel of one
// phase: the four phases take weights of their own.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/log_exp.glsl"
#include "shared/kernels.glsl"
// 32-bit floats, whatever the hidden numbers are.
layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Taps { vec4 v[]; };
TEXELS_OF(0, early)
TEXELS_OF(1, tokens)
TEXELS_OF(2, albedo)
TEXELS_OF(3, color)
TEXELS_OF(4, residual)
TEXELS_OF(5, weights)
#include "shared/products.glsl"

layout(local_size_x = 256 / TX) in;

layout(push_constant) uniform Push {
    Source early;
    Source tokens;
    Source albedo;
    Weights color;
    Weights residual;
    Weights weights;
    Target hidden;
    Taps taps;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;           // of the tokens
    uint early_stride;    // strides in vectors of four
    uint tokens_stride;
    uint albedo_stride;
    uint color_stride;
    uint residual_stride;
    uint hidden_stride;
    uint taps_stride;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

const uint LANES_X = 8 / TX;
const uint OF_PHASE = 64 / TX;                 // invocations
const int INPUTS = 10;                         // tokens, colour and residual, three channels and a zero each

vec4 inputs[TX * INPUTS];
vec4 values[TX];
#define INPUT(p, k) inputs[(p) * INPUTS + (k) / 4][(k) % 4]

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uint phase = gl_LocalInvocationID.x / OF_PHASE;
    uint lane = gl_LocalInvocationID.x % OF_PHASE;
    uvec2 first = tile_origin(slot, first_tile, flags, tiles) + uvec2(lane % LANES_X * TX, lane / LANES_X);
    uint pixels[TX];
    float raw[TX];
    [[unroll]] for (int p = 0; p < TX; ++p) {
        uvec2 at = first + uvec2(p, 0);
        pixels[p] = (2u * at.y + (phase >> 1)) * (2u * width) + 2u * at.x + (phase & 1u);
        uint from = (at.y * width + at.x) * tokens_stride;
        [[unroll]] for (int k = 0; k < INPUTS - 2; ++k) inputs[p * INPUTS + k] = LOAD(tokens, from + k);
        inputs[p * INPUTS + INPUTS - 2] = LOAD_WEIGHTS(color, pixels[p] * color_stride);
        inputs[p * INPUTS + INPUTS - 1] = LOAD_WEIGHTS(residual, pixels[p] * residual_stride);
        raw[p] = LOAD_WEIGHTS(weights, RELIABILITY_AT).y;
    }
    for (uint n = 0u; n < HIDDEN; ++n) {
        vec4 bias = LOAD_WEIGHTS(weights, phase * HIDDEN + n);
        [[unroll]] for (int p = 0; p < TX; ++p) values[p] = bias + LOAD(early, pixels[p] * early_stride + n);
        ADD_PRODUCTS(values, INPUT, 4 * INPUTS, HIDDEN_AT + (phase * HIDDEN + n) * (4 * INPUTS))
        vec4 row = LOAD_WEIGHTS(weights, ROW_AT + n);
        [[unroll]] for (int p = 0; p < TX; ++p) {
            vec4 value = max(values[p], 0.01 * values[p]);
            raw[p] += dot(value, row);
            STORE(hidden, pixels[p] * hidden_stride + n, value);
        }
    }
    [[unroll]] for (int p = 0; p < TX; ++p) {
        vec3 log_color = inputs[p * INPUTS + INPUTS - 2].xyz;
        vec3 radiance = vec3(expm1(log_color.x), expm1(log_color.y), expm1(log_color.z));
        vec3 image = radiance / demodulator(LOAD(albedo, pixels[p] * albedo_stride).xyz);
        float b = reliability(raw[p]);
        taps.v[pixels[p] * taps_stride] = vec4(b * image, b);
    }
}
