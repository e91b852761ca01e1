// The kernels of every pixel, predicted and applied as in predict_kernels.comp, the outputs on cooperative matrices:
// maps of halves, sums in 32-bit floats.
//
// A workgroup of two subgroups works on 8x8 pixels; each computes the outputs of half of them, which go through shared
// memory to the invocations that apply them.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/kernels.glsl"
#define SUBGROUPS 2u
#include "shared/matrix.glsl"

layout(push_constant) uniform Push {
    Source hidden;
    Weights taps;
    Source albedo;
    Weights weights;      // [biases | halves, packed]
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint hidden_stride;   // strides in vectors of four
    uint taps_stride;
    uint albedo_stride;
    uint dst_stride;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint images;          // one or two
};

const uint TILES = 1u;
const uint HALVES = 2u;
#define OUTPUTS (4u * VECTORS)                 // of every pixel
#define SUMS_TOKENS 32u                        // all of a subgroup: one for each of its invocations
const uint TOKEN = 5u;                         // a pixel's hidden numbers in vectors of eight halves, and padding
const uint STAGED_INPUTS = 64u * TOKEN;
const uint BLOCKS = 2u;                        // of 16 rows
const uint STAGED_BLOCKS = BLOCKS;
const uint bias_vectors = MATRIX_OUTPUTS_AT;
const uint dst_channels = VECTORS;
#include "shared/matrix_dense.glsl"
#include "shared/pixel_taps.glsl"

const int SIDE = 12;                           // a tile and two pixels on each side
shared vec4 staged_taps[3 * SIDE * SIDE];      // a plane after the other

void stage(uvec2 origin) {
    Vectors from = Vectors(hidden);
    for (uint i = gl_LocalInvocationID.x; i < 64u * (TOKEN - 1u); i += INVOCATIONS) {
        uint token = i / (TOKEN - 1u), part = i % (TOKEN - 1u);
        uint at = (origin.y + token / 8u) * width + origin.x + token % 8u;
        staged[token * TOKEN + part] = from.v[at * (hidden_stride / 2u) + part];
    }
    for (int i = int(gl_LocalInvocationID.x); i < int(images + 1u) * SIDE * SIDE; i += int(INVOCATIONS)) {
        int j = i % (SIDE * SIDE);
        staged_taps[i] = load_tap(ivec2(origin) + ivec2(j % SIDE, j / SIDE) - 2, uint(i / (SIDE * SIDE)));
    }
}

// Four outputs of one of the subgroup's pixels.
vec4 predicted(uint token, uint vector) {
    return staged_sum(token, vector) + LOAD_WEIGHTS(weights, BIASES_AT + vector);
}

// Four of `taps` taps of a plane.
#define READ_TAPS(plane, offset_of, taps) \
    [[unroll]] for (uint i = 0u; i < 4u; ++i) { \
        uint tap = 4u * n + i; \
        ivec2 place = own + offset_of(tap) + 2; \
        read[i] = vec4(0.0); \
        if (tap < taps) read[i] = staged_taps[int(plane) * SIDE * SIDE + place.y * SIDE + place.x]; \
    }

// The means of the images around a pixel of the tile.
struct Means {
    vec3 full;
    vec3 plain;
};

Means mean_of_images(uint token, ivec2 own) {
    Average average = no_average();
    vec4 plain = vec4(0.0);
    [[unroll]] for (uint n = 0u; n < 7u; ++n) {
        vec4 read[4];
        READ_TAPS(FIRST_IMAGE, offset_in_5x5, 25u)
        Shares by = shares_of(average.largest, predicted(token, n), read);
        average = Average(with_read(average.sum, by, read), by.largest);
        if (images > 1u) {
            READ_TAPS(FIRST_IMAGE + 1u, offset_in_5x5, 25u)
            plain = with_read(plain, by, read);
        }
    }
    return Means(average.sum.xyz / average.sum.w, plain.xyz / average.sum.w);
}

vec3 mean_of_albedo(uint token, ivec2 own) {
    Average average = no_average();
    [[unroll]] for (uint n = 0u; n < 3u; ++n) {
        vec4 read[4];
        READ_TAPS(OF_ALBEDO, offset_in_3x3, 9u)
        average = with_taps(average, predicted(token, ALBEDO_AT + n), read);
    }
    return average.sum.xyz / average.sum.w;
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 origin = tile_origin(slot, first_tile, flags, tiles);

    clear_sums();
    stage(origin);
    stage_weights(Vectors(weights), 0u, BLOCKS, 0u, BLOCKS, BLOCKS);
    barrier();
    multiply_add(0u, TOKEN, 0u, 32u);
    stage_sums(0u);
    for (uint i = gl_SubgroupInvocationID; i < SUMS_TOKENS; i += LANES) {
        uint of_tile = own_half * OWN_TOKENS + i;
        uvec2 own = uvec2(of_tile % 8u, of_tile / 8u);
        Means means = mean_of_images(i, ivec2(own));
        vec3 of_albedo = mean_of_albedo(i, ivec2(own));
        vec4 first = predicted(i, SHARES_AT), last = predicted(i, SHARES_AT + 1u);
        uint to = ((origin.y + own.y) * width + origin.x + own.x) * dst_stride;
        STORE_PREDICTED(dst, to, images, means.full, means.plain, of_albedo, first, last)
    }
}
