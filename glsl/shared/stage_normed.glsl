// Tokens brought to mean 0 and variance 1 over their channels while they are staged. A kernel defines before it
// includes this NORMED_VECTORS, vectors of eight channels, a power of two; where it takes the tokens around a tile too,
// NORMED_SIDE: of these with the tile. Beyond the map they are the nearest ones of it.
#include "shared/norm_share.glsl"
#ifndef NORMED_SIDE
#define NORMED_SIDE 8u
#define NORMED_PIXEL(at) (at.y * width + at.x)
#else
#define NORMED_PIXEL(at) pixel_around(at)
uint pixel_around(uvec2 at) {
    uvec2 inside = min(max(at, uvec2(1u)) - 1u, uvec2(width, height) - 1u);
    return inside.y * width + inside.x;
}
#endif

const uint NORM_EACH = NORMED_VECTORS / NORM_SHARE;

// Stages the tokens of a tile of a map of `stride` vectors of four a token, as rows of `row_stride` from `rows` on.
void stage_normed(Vectors from, uint stride, uint rows, uint row_stride, uvec2 origin) {
    uint part = tile_lane % NORM_SHARE;
    for (uint token = tile_lane / NORM_SHARE; token < NORMED_SIDE * NORMED_SIDE; token += TILE_LANES / NORM_SHARE) {
        uvec2 at = origin + uvec2(token % NORMED_SIDE, token / NORMED_SIDE);
        uint pixel = NORMED_PIXEL(at);
        vec4 low[NORM_EACH], high[NORM_EACH];
        vec4 sum = vec4(0.0);
        [[unroll]] for (uint i = 0u; i < NORM_EACH; ++i) {
            unpack_halves(from.v[pixel * (stride / 2u) + i * NORM_SHARE + part], low[i], high[i]);
            sum += low[i] + high[i];
        }
        float mean = mean_of(norm_sum(sum), 2u * NORMED_VECTORS);
        vec4 squares = vec4(0.0);
        [[unroll]] for (uint i = 0u; i < NORM_EACH; ++i) {
            low[i] -= mean;
            high[i] -= mean;
            squares += low[i] * low[i] + high[i] * high[i];
        }
        float scale = scale_of(norm_sum(squares), 2u * NORMED_VECTORS);
        [[unroll]] for (uint i = 0u; i < NORM_EACH; ++i) {
            staged[rows + token * row_stride + i * NORM_SHARE + part] = pack_halves(low[i] * scale, high[i] * scale);
        }
    }
}
