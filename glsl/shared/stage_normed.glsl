// Tokens brought to mean 0 and variance 1 over their channels while they are staged. A kernel defines before it includes
// this NORMED_VECTORS, vectors of eight channels, a power of two.
#include "shared/norm_share.glsl"

const uint NORM_EACH = NORMED_VECTORS / NORM_SHARE;

// Stages the tokens of a tile of a map of `stride` vectors of four a token, as rows of `row_stride` from `rows` on.
void stage_normed(Vectors from, uint stride, uint rows, uint row_stride, uvec2 origin) {
    uint part = tile_lane % NORM_SHARE;
    for (uint token = tile_lane / NORM_SHARE; token < TOKENS; token += TILE_LANES / NORM_SHARE) {
        uint pixel = (origin.y + token / 8u) * width + origin.x + token % 8u;
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
