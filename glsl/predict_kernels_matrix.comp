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
    uint unused;
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
shared vec4 staged_taps[2 * SIDE * SIDE];      // the radiance's, then the albedo's

void stage(uvec2 origin) {
    Vectors from = Vectors(hidden);
    for (uint i = gl_LocalInvocationID.x; i < 64u * (TOKEN - 1u); i += INVOCATIONS) {
        uint token = i / (TOKEN - 1u), part = i % (TOKEN - 1u);
        uint at = (origin.y + token / 8u) * width + origin.x + token % 8u;
        staged[token * TOKEN + part] = from.v[at * (hidden_stride / 2u) + part];
    }
    for (int i = int(gl_LocalInvocationID.x); i < 2 * SIDE * SIDE; i += int(INVOCATIONS)) {
        int j = i % (SIDE * SIDE);
        staged_taps[i] = load_tap(ivec2(origin) + ivec2(j % SIDE, j / SIDE) - 2, i >= SIDE * SIDE);
    }
}

// Four outputs of one of the subgroup's pixels.
vec4 predicted(uint token, uint vector) {
    return staged_sum(token, vector) + LOAD_WEIGHTS(weights, BIASES_AT + vector);
}

// Of an image, and with gloss of what it was before it was divided by the albedo.
struct Means {
    vec3 mean;
    vec3 undivided;
};

// Over `taps` taps around a pixel of the tile, by the outputs of the vectors from `first` on.
Means means_of_taps(uint token, ivec2 own, bool of_albedo, uint first, const uint taps) {
    Average average = no_average();
    vec4 undivided = vec4(0.0);
    [[unroll]] for (uint n = 0u; n < (taps + 3u) / 4u; ++n) {
        vec4 read[4];
        int places[4];
        [[unroll]] for (uint i = 0u; i < 4u; ++i) {
            uint tap = 4u * n + i;
            ivec2 place = own + (of_albedo ? offset_in_3x3(tap) : offset_in_5x5(tap)) + 2;
            read[i] = vec4(0.0);
            places[i] = place.y * SIDE + place.x;
            if (tap < taps) read[i] = staged_taps[(of_albedo ? SIDE * SIDE : 0) + places[i]];
        }
        Shares by = shares_of(average.largest, predicted(token, first + n), read);
        average = Average(with_read(average.sum, by, read), by.largest);
        if (!of_albedo && (flags & FLAG_GLOSS) != 0u) {
            [[unroll]] for (uint i = 0u; i < 4u; ++i) {
                if (4u * n + i < taps) read[i] *= staged_taps[SIDE * SIDE + places[i]];
            }
            undivided = with_read(undivided, by, read);
        }
    }
    return Means(average.sum.xyz / average.sum.w, undivided.xyz / average.sum.w);
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
        Means full = means_of_taps(i, ivec2(own), false, 0u, 25u);
        vec3 of_albedo = means_of_taps(i, ivec2(own), true, ALBEDO_AT, 9u).mean;
        vec4 first = predicted(i, SHARES_AT), last = predicted(i, SHARES_AT + 1u);
        uint to = ((origin.y + own.y) * width + origin.x + own.x) * dst_stride;
        STORE_PREDICTED(dst, to, full.mean, full.undivided, of_albedo, first, last, flags)
    }
}
