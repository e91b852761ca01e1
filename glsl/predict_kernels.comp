// The kernels of every pixel, predicted and applied at full size: nothing of what is predicted but the other levels'
// shares goes to memory.
//
// An invocation works on TX pixels in a row. On GPUs what taps read lies in shared memory; CPU drivers read that more
// slowly than texels.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/kernels.glsl"
TEXELS_OF(0, hidden)
TEXELS_OF(1, taps)
TEXELS_OF(2, albedo)
TEXELS_OF(3, weights)
#include "shared/products.glsl"

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source hidden;
    Weights taps;
    Source albedo;
    Weights weights;
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

const uint LANES_X = 8 / TX;
const uint LANES = 64 / TX;                    // invocations per tile

#include "shared/pixel_taps.glsl"

#ifndef TEXELS
const int SIDE = 12;                           // a tile and two pixels on each side
shared vec4 staged[TX * 2 * SIDE * SIDE];      // of every tile the radiance's, then the albedo's
#endif

vec4 inputs[TX * HIDDEN];
vec4 outputs[TX];
#define INPUT(p, k) inputs[(p) * HIDDEN + (k) / 4][(k) % 4]

// What four taps of pixel p of the row read, of the image or of the albedo.
#ifdef TEXELS
#define TAP(p, offset, plane) load_tap(ivec2(at) + ivec2(p, 0) + offset, plane)
#else
int place(ivec2 at) { return at.y * SIDE + at.x; }
#define TAP(p, offset, plane) \
    staged[of_tile + ((plane) ? SIDE * SIDE : 0) + place(ivec2(own) + ivec2(p, 0) + offset + 2)]
#endif
#define READ_TAPS(plane) \
    [[unroll]] for (uint i = 0u; i < 4u; ++i) { \
        uint tap = 4u * (of_albedo ? n - ALBEDO_AT : n) + i; \
        ivec2 offset = of_albedo ? offset_in_3x3(tap) : offset_in_5x5(tap); \
        bool counts = tap < (of_albedo ? 9u : 25u); \
        read[i] = TAP(p, offset, plane); \
        if (!counts) read[i] = vec4(0.0); \
    }

void main() {
    uint slot = group_index() * (64u / LANES) + gl_LocalInvocationID.x / LANES;
    uint count = tiles_of(tile_count, flags, tiles);
    bool live = slot < count;
    if (count == 0u) return;
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint lane = gl_LocalInvocationID.x % LANES;
    uvec2 own = uvec2(lane % LANES_X * TX, lane / LANES_X);
    uvec2 at = origin + own;
#ifndef TEXELS
    int of_tile = int(gl_LocalInvocationID.x / LANES) * 2 * SIDE * SIDE;
    for (int i = int(lane); i < 2 * SIDE * SIDE; i += int(LANES)) {
        int j = i % (SIDE * SIDE);
        staged[of_tile + i] = load_tap(ivec2(origin) + ivec2(j % SIDE, j / SIDE) - 2, i >= SIDE * SIDE);
    }
    barrier();
#endif
    Average averages[TX];
    vec4 undivided[TX];                        // with gloss the sums of the radiance as it is
    bool gloss = (flags & FLAG_GLOSS) != 0u;
    [[unroll]] for (int p = 0; p < TX; ++p) {
        uint from = (at.y * width + at.x + p) * hidden_stride;
        [[unroll]] for (int k = 0; k < HIDDEN; ++k) inputs[p * HIDDEN + k] = LOAD(hidden, from + k);
        averages[p] = no_average();
        undivided[p] = vec4(0.0);
    }
    vec3 full[TX];
    vec4 first[TX];
    for (uint n = 0u; n < VECTORS; ++n) {
        vec4 bias = LOAD_WEIGHTS(weights, BIASES_AT + n);
        [[unroll]] for (int p = 0; p < TX; ++p) outputs[p] = bias;
        ADD_PRODUCTS(outputs, INPUT, 4 * HIDDEN, OUTPUTS_AT + n * (4 * HIDDEN))
        if (n >= SHARES_AT) {
            if (n == SHARES_AT) {
                [[unroll]] for (int p = 0; p < TX; ++p) first[p] = outputs[p];
            }
            continue;
        }
        bool of_albedo = n >= ALBEDO_AT;
        if (n == ALBEDO_AT) {
            [[unroll]] for (int p = 0; p < TX; ++p) {
                full[p] = averages[p].sum.xyz / averages[p].sum.w;
                undivided[p] /= averages[p].sum.w;
                averages[p] = no_average();
            }
        }
        [[unroll]] for (int p = 0; p < TX; ++p) {
            vec4 read[4];
            READ_TAPS(of_albedo)
            Shares by = shares_of(averages[p].largest, outputs[p], read);
            averages[p] = Average(with_read(averages[p].sum, by, read), by.largest);
            if (gloss && !of_albedo) {
                vec4 divided[4] = read;
                READ_TAPS(true)
                [[unroll]] for (uint i = 0u; i < 4u; ++i) read[i] *= divided[i];
                undivided[p] = with_read(undivided[p], by, read);
            }
        }
    }
    if (!live) return;
    [[unroll]] for (int p = 0; p < TX; ++p) {
        uint to = (at.y * width + at.x + p) * dst_stride;
        vec3 mean_albedo = averages[p].sum.xyz / averages[p].sum.w;
        STORE_PREDICTED(dst, to, full[p], undivided[p].xyz, mean_albedo, first[p], outputs[p], flags)
    }
}
