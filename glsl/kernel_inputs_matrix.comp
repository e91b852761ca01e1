// What kernels are predicted from, and what their taps read, as kernel_inputs.comp has it, on cooperative matrices:
// maps of halves, sums in 32-bit floats.
//
// A workgroup works on 8x8 tokens of 2x2 pixels, each subgroup on the pixels of one phase, which take weights of their
// own. Colour and residual, 32-bit floats, are staged as halves and as halves of what those leave, so that no digit
// that counts is lost: their rows of weights are packed twice.
#version 460
#extension GL_KHR_shader_subgroup_shuffle : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/log_exp.glsl"
#include "shared/kernels.glsl"
#include "shared/matrix.glsl"
// 32-bit floats, whatever the hidden numbers are.
layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Taps { vec4 v[]; };

layout(push_constant) uniform Push {
    Source early;
    Source tokens;
    Source albedo;
    Weights color;
    Weights residual;
    Weights weights;      // [biases and the reliability's row | halves, packed]
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

const uint TILES = 1u;
const uint HALVES = 1u;
const uint PHASES = SUBGROUPS;
const uint TOKEN = 5u;                         // a token's channels in vectors of eight halves, and padding
const uint GUESS = 3u;                         // a pixel's colour and residual, what is left of them, and padding
const uint GUESSES_AT = 64u * TOKEN;
const uint STAGED_INPUTS = GUESSES_AT + PHASES * 64u * GUESS;
const uint BLOCKS = 3u;                        // of 16 rows: two of the tokens' channels, one of the guesses
const uint STAGED_BLOCKS = PHASES * BLOCKS;
const uint bias_vectors = HIDDEN_AT;
const uint dst_channels = PHASES * uint(HIDDEN);
#include "shared/matrix_dense.glsl"

// What the pixels' reliabilities are made of, by phase and token.
shared float raw[PHASES * 64u];

const float LARGEST_HALF = 65504.0;

// A pixel of the workgroup's 16x16, row by row: where it lies in the maps.
uint pixel_of(uvec2 origin, uint i) {
    return (2u * origin.y + i / 16u) * (2u * width) + 2u * origin.x + i % 16u;
}

// The same pixel by phase and token.
uint by_phase(uint i) {
    uint x = i % 16u, y = i / 16u;
    return (y % 2u * 2u + x % 2u) * 64u + y / 2u * 8u + x / 2u;
}

void stage(uvec2 origin) {
    Vectors from = Vectors(tokens);
    for (uint i = gl_LocalInvocationID.x; i < 64u * (TOKEN - 1u); i += INVOCATIONS) {
        uint token = i / (TOKEN - 1u), part = i % (TOKEN - 1u);
        uint at = (origin.y + token / 8u) * width + origin.x + token % 8u;
        staged[token * TOKEN + part] = from.v[at * (tokens_stride / 2u) + part];
    }
    for (uint i = gl_LocalInvocationID.x; i < PHASES * 64u; i += INVOCATIONS) {
        uint pixel = pixel_of(origin, i);
        vec4 own = vec4(LOAD_WEIGHTS(color, pixel * color_stride).xyz, 0.0);
        vec4 guess = vec4(LOAD_WEIGHTS(residual, pixel * residual_stride).xyz, 0.0);
        guess = clamp(guess, vec4(-LARGEST_HALF), vec4(LARGEST_HALF));
        uvec4 halves = pack_halves(own, guess);
        vec4 own_half, guess_half;
        unpack_halves(halves, own_half, guess_half);
        uint to = GUESSES_AT + by_phase(i) * GUESS;
        staged[to] = halves;
        staged[to + 1u] = pack_halves(own - own_half, guess - guess_half);
    }
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 origin = tile_origin(slot, first_tile, flags, tiles);
    uint phase = own_split;

    clear_sums();
    stage(origin);
    stage_weights(Vectors(weights), 0u, BLOCKS, 0u, BLOCKS, BLOCKS);
    barrier();
    multiply_add(0u, TOKEN, phase * BLOCKS, 32u);
    multiply_add(GUESSES_AT + phase * 64u * GUESS, GUESS, phase * BLOCKS + 2u, 16u);

    [[unroll]] for (uint part = 0u; part < OWN_TOKENS / SUMS_TOKENS; ++part) {
        stage_sums(part);
        // The eight vectors of a token lie side by side in the subgroup.
        for (uint i = gl_SubgroupInvocationID; i < SUMS_TOKENS * uint(HIDDEN); i += LANES) {
            uint token = i / uint(HIDDEN), vector = i % uint(HIDDEN);
            uint of_tile = part * SUMS_TOKENS + token;
            uint pixel = pixel_of(origin, (of_tile / 8u * 2u + phase / 2u) * 16u + of_tile % 8u * 2u + phase % 2u);
            vec4 value = staged_sum(token, vector) + LOAD_WEIGHTS(weights, phase * uint(HIDDEN) + vector);
            value += LOAD(early, pixel * early_stride + vector);
            value = max(value, 0.01 * value);
            STORE(hidden, pixel * hidden_stride + vector, value);
            float sum = dot(value, LOAD_WEIGHTS(weights, ROW_AT + vector));
            [[unroll]] for (uint lanes = 1u; lanes < uint(HIDDEN); lanes *= 2u) sum += subgroupShuffleXor(sum, lanes);
            if (vector == 0u) raw[phase * 64u + of_tile] = sum;
        }
    }
    barrier();
    for (uint i = gl_LocalInvocationID.x; i < PHASES * 64u; i += INVOCATIONS) {
        uint pixel = pixel_of(origin, i);
        vec3 log_color = LOAD_WEIGHTS(color, pixel * color_stride).xyz;
        vec3 radiance = vec3(expm1(log_color.x), expm1(log_color.y), expm1(log_color.z));
        vec3 image = radiance / demodulator(LOAD(albedo, pixel * albedo_stride).xyz);
        float b = reliability(raw[by_phase(i)] + LOAD_WEIGHTS(weights, RELIABILITY_AT).y);
        taps.v[pixel * taps_stride] = vec4(b * image, b);
    }
}
