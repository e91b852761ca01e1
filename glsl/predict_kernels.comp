// The kernels of every pixel, predicted and applied at full size, and the sums that the coarser levels are made of. Nothing of what is
// predicted but the other levels' shares goes to memory.
//
// A workgroup works on 8x8 tokens of 2x2 pixels. An invocation works on TX tokens in a row, in each on the pixel of one phase: the
// four phases take weights of their own. First the ring of tokens around, of whose pixels the reliability alone counts, then its
// own; both leave what taps read in shared memory.
#version 460
#extension GL_EXT_control_flow_attributes : require
#ifdef LANES_SHARE
#include "shared/lanes.glsl"
#endif
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/log_exp.glsl"
#include "shared/kernels.glsl"
TEXELS_OF(0, early)
TEXELS_OF(1, tokens)
TEXELS_OF(2, albedo)
TEXELS_OF(3, color)
TEXELS_OF(4, residual)
TEXELS_OF(5, weights)

layout(local_size_x = 256 / TX) in;

layout(push_constant) uniform Push {
    Source early;
    Source tokens;
    Source albedo;
    Weights color;
    Weights residual;
    Weights weights;
    Target dst;
    Target sums;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;           // of the tokens
    uint height;
    uint early_stride;    // strides in vectors of four
    uint tokens_stride;
    uint albedo_stride;
    uint color_stride;
    uint residual_stride;
    uint dst_stride;
    uint sums_stride;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

const uint LANES_X = 8 / TX;
const uint OF_PHASE = 64 / TX;                 // invocations
const int SIDE = 20;                           // of what taps read, in pixels: the tile's 16 and two on each side
const uint RING = 36u;                         // tokens around the tile

// Weights: [biases of h, by phase | the reliability's row | biases of the outputs | h, by phase | outputs], rows of four outputs.
const int HIDDEN = 8;                          // vectors of four
const int INPUTS = 10;                         // tokens, colour and residual, three channels and a zero each
const uint ROW_AT = 4u * HIDDEN;
const uint BIASES_AT = ROW_AT + HIDDEN;
const uint HIDDEN_AT = BIASES_AT + 12u;
const uint OUTPUTS_AT = HIDDEN_AT + 4u * HIDDEN * 4u * INPUTS;
// Outputs: 25 logits, nine of the albedo's kernel from the eighth vector on, five shares and the gate from the eleventh on.
const uint ALBEDO_AT = 7u;
const uint SHARES_AT = 10u;
const uint VECTORS = 12u;

// What taps read: of every pixel b times the image, and b; then what its radiance is divided by, and 1. Zeros outside the frame.
shared vec4 taps[2 * SIDE * SIDE];

// CPU drivers compile such kernels for seconds where loops are unrolled.
#ifdef TEXELS
#define ROLLED
#else
#define ROLLED [[unroll]]
#endif

vec4 hidden[TX * HIDDEN];
vec4 outputs[TX];

// value += the products of 4 * `count` inputs of every pixel, `input(p, k)` being the k-th, with the rows of weights from `base` on.
#ifdef LANES_SHARE
#define ADD_PRODUCTS(value, input, count, base) { \
    vec4 lane_weights[PER_LANE(4 * (count))]; \
    [[unroll]] for (int i = 0; i < PER_LANE(4 * (count)); ++i) { \
        lane_weights[i] = LOAD_WEIGHTS(weights, (base) + min(LANE + uint(i * SHARING), uint(4 * (count) - 1))); \
    } \
    [[unroll]] for (int k = 0; k < 4 * (count); ++k) { \
        vec4 w = FROM_LANE(lane_weights[k / SHARING], uint(k % SHARING)); \
        [[unroll]] for (int p = 0; p < TX; ++p) value[p] += input(p, k) * w; \
    } }
#else
#define ADD_PRODUCTS(value, input, count, base) \
    [[unroll]] for (int k = 0; k < 4 * (count); ++k) { \
        vec4 w = LOAD_WEIGHTS(weights, (base) + k); \
        [[unroll]] for (int p = 0; p < TX; ++p) value[p] += input(p, k) * w; \
    }
#endif
#define TO_HIDDEN(p, k) inputs[(p) * INPUTS + (k) / 4][(k) % 4]
#define TO_OUTPUT(p, k) hidden[(p) * HIDDEN + (k) / 4][(k) % 4]

// Four outputs of every pixel, from those of `vector` on.
void predict(uint vector) {
    vec4 bias = LOAD_WEIGHTS(weights, BIASES_AT + vector);
    [[unroll]] for (int p = 0; p < TX; ++p) outputs[p] = bias;
    ADD_PRODUCTS(outputs, TO_OUTPUT, HIDDEN, OUTPUTS_AT + vector * 4u * HIDDEN)
}

// The first token in a row of a tile's ring: above, below, left, right.
ivec2 ring_token(uint i) {
    if (i < 20u) return ivec2(int(i % 10u) - 1, i < 10u ? -1 : 8);
    return ivec2(i < 28u ? -1 : 8, int(i - 20u) % 8);
}

int place(ivec2 token, uint phase) {
    return (2 * token.y + 2 + int(phase >> 1)) * SIDE + 2 * token.x + 2 + int(phase & 1u);
}

void main() {
    uint slot = group_index();
    uint count = tiles_of(tile_count, flags, tiles);
    if (slot >= count) return;
    ivec2 origin = ivec2(tile_origin(slot, first_tile, flags, tiles));
    uint phase = gl_LocalInvocationID.x / OF_PHASE;
    uint lane = gl_LocalInvocationID.x % OF_PHASE;
    ivec2 own = ivec2(lane % LANES_X * TX, lane / LANES_X);
    uvec2 last = uvec2(width, height) - 1u;

    for (uint round = 0u; round < 2u; ++round) {
        vec4 inputs[TX * INPUTS];
        uint pixels[TX];
        [[unroll]] for (int p = 0; p < TX; ++p) {
            ivec2 token = round == 0u ? ring_token(lane * TX + p) : own + ivec2(p, 0);
            uvec2 at = uvec2(clamp(origin + token, ivec2(0), ivec2(last)));
            pixels[p] = (2u * at.y + (phase >> 1)) * (2u * width) + 2u * at.x + (phase & 1u);
            uint from = (at.y * width + at.x) * tokens_stride;
            [[unroll]] for (int k = 0; k < HIDDEN; ++k) inputs[p * INPUTS + k] = LOAD(tokens, from + k);
            inputs[p * INPUTS + HIDDEN] = LOAD_WEIGHTS(color, pixels[p] * color_stride);
            inputs[p * INPUTS + HIDDEN + 1] = LOAD_WEIGHTS(residual, pixels[p] * residual_stride);
        }
        ROLLED for (int n = 0; n < HIDDEN; ++n) {
            vec4 bias = LOAD_WEIGHTS(weights, phase * HIDDEN + n);
            vec4 values[TX];
            [[unroll]] for (int p = 0; p < TX; ++p) values[p] = bias + LOAD(early, pixels[p] * early_stride + n);
            ADD_PRODUCTS(values, TO_HIDDEN, INPUTS, HIDDEN_AT + (phase * HIDDEN + n) * (4 * INPUTS))
            [[unroll]] for (int p = 0; p < TX; ++p) {
                values[p] = max(values[p], 0.01 * values[p]);
                [[unroll]] for (int to = 0; to < HIDDEN; ++to) {
                    if (to == n) hidden[p * HIDDEN + to] = values[p];
                }
            }
        }
        // The reliability's bias stands among those of the outputs, where no output is.
        float raw[TX];
        [[unroll]] for (int p = 0; p < TX; ++p) raw[p] = LOAD_WEIGHTS(weights, BIASES_AT + ALBEDO_AT - 1u).y;
        [[unroll]] for (int n = 0; n < HIDDEN; ++n) {
            vec4 row = LOAD_WEIGHTS(weights, ROW_AT + n);
            [[unroll]] for (int p = 0; p < TX; ++p) raw[p] += dot(hidden[p * HIDDEN + n], row);
        }
        [[unroll]] for (int p = 0; p < TX; ++p) {
            uint in_ring = lane * TX + p;
            if (round == 0u && in_ring >= RING) continue;
            ivec2 token = round == 0u ? ring_token(in_ring) : own + ivec2(p, 0);
            ivec2 at = origin + token;
            bool inside = min(at.x, at.y) >= 0 && at.x <= int(last.x) && at.y <= int(last.y);
            vec3 log_color = inputs[p * INPUTS + HIDDEN].xyz;
            vec3 a = demodulator(LOAD(albedo, pixels[p] * albedo_stride).xyz);
            vec3 image = vec3(expm1(log_color.x), expm1(log_color.y), expm1(log_color.z)) / a;
            float b = reliability(raw[p]);
            int to = place(token, phase);
            taps[to] = inside ? vec4(b * image, b) : vec4(0.0);
            taps[SIDE * SIDE + to] = inside ? vec4(a, 1.0) : vec4(0.0);
        }
    }
    barrier();

    int places[TX];
    Average averages[TX];
    [[unroll]] for (int p = 0; p < TX; ++p) {
        places[p] = place(own + ivec2(p, 0), phase);
        averages[p] = no_average();
    }
    vec3 full[TX];
    vec4 first[TX];
    for (uint n = 0u; n < VECTORS; ++n) {
        predict(n);
        if (n >= SHARES_AT) {
            if (n == SHARES_AT) {
                [[unroll]] for (int p = 0; p < TX; ++p) first[p] = outputs[p];
            }
            continue;
        }
        bool of_albedo = n >= ALBEDO_AT;
        uint side = of_albedo ? 3u : 5u;
        uint tap_0 = 4u * (of_albedo ? n - ALBEDO_AT : n);
        int from = of_albedo ? SIDE * SIDE : 0;
        [[unroll]] for (int p = 0; p < TX; ++p) {
            if (n == ALBEDO_AT) {
                full[p] = averages[p].sum.xyz / averages[p].sum.w;
                averages[p] = no_average();
            }
            vec4 read[4];
            [[unroll]] for (uint i = 0u; i < 4u; ++i) {
                uint tap = min(tap_0 + i, side * side - 1u);
                ivec2 offset = ivec2(tap % side, tap / side) - int(side / 2u);
                read[i] = taps[from + places[p] + offset.y * SIDE + offset.x];
                if (tap_0 + i >= side * side) read[i] = vec4(0.0);
            }
            averages[p] = with_taps(averages[p], outputs[p], read);
        }
    }
    [[unroll]] for (int p = 0; p < TX; ++p) {
        // The shares of five levels, of which the last may be impossible.
        float most = max(max(max(first[p].x, first[p].y), max(first[p].z, first[p].w)), outputs[p].x);
        vec4 shares = exp(first[p] - most);
        float last_share = exp(outputs[p].x - most);
        float inverse = 1.0 / (shares.x + shares.y + shares.z + shares.w + last_share);
        float gate = 1.0 / (1.0 + exp(clamp(-outputs[p].y, -60.0, 60.0)));
        uvec2 at = 2u * uvec2(origin + own + ivec2(p, 0)) + uvec2(phase & 1u, phase >> 1);
        uint to = (at.y * 2u * width + at.x) * dst_stride;
        float share = shares.x * inverse;
        STORE(dst, to, vec4(full[p] * share, share));
        STORE(dst, to + 1u, vec4(averages[p].sum.xyz / averages[p].sum.w, gate));
        STORE(dst, to + 2u, vec4(shares.yzw, last_share) * inverse);
    }
    for (uint i = gl_LocalInvocationID.x; i < 64u; i += 256u / TX) {
        ivec2 token = ivec2(i % 8u, i / 8u);
        int from = place(token, 0u);
        vec4 mean = 0.25 * (taps[from] + taps[from + 1] + taps[from + SIDE] + taps[from + SIDE + 1]);
        uvec2 at = uvec2(origin + token);
        STORE(sums, (at.y * width + at.x) * sums_stride, mean);
    }
}
