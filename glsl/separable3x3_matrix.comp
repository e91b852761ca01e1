// Depthwise 3x3 convolution (zero padding, bias, activation) and the pointwise convolution after it as one, maps of
// halves: the depthwise sums are made in 32-bit floats, block by block of channels, and rounded to halves for the
// matrices.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define EPILOGUE_ID 4         // after those of matrix.glsl
#include "shared/epilogue.glsl"
layout(constant_id = 5) const uint TILES = 4;   // of a workgroup: 1, 2 or 4
layout(constant_id = 6) const uint HALVES = 1;  // subgroups that share the tokens of a tile: 1 or 2
#define SUBGROUPS (4u * HALVES)
#include "shared/matrix.glsl"
layout(constant_id = 7) const uint INPUTS = 32; // staged at a time, a divisor of all
layout(constant_id = 8) const uint INNER_EPILOGUE = 0u;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
    Weights weights;      // [bias | halves, packed] of the pointwise part
    Weights film;         // [gamma | beta] with FLAG_FILM
    Residual residual;    // with FLAG_RESIDUAL
    Weights depthwise;    // [bias | 9 taps], each of all channels
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint src_stride;      // strides and channel counts in vectors of four
    uint src_channels;
    uint dst_stride;
    uint dst_channels;
    uint residual_stride;
    uint bias_vectors;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

const uint VECTORS = INPUTS / 4u;               // of four halves
const uint STRIDE = INPUTS / 8u + 1u;           // of a token's row, in vectors of eight
const uint STAGED_INPUTS = TILES * 64u * STRIDE;
const uint STAGED_BLOCKS = 4u / TILES * INPUTS / 16u;
#include "shared/matrix_dense.glsl"
#include "shared/add_row.glsl"

// Stages the depthwise results of a tile for the inputs from vector `first` on: an invocation goes down a column of
// tokens, four channels wide, and adds every row that it loads to the three results that it touches. A tile lies inside
// the map: beyond it are at most the tokens left and right of a column, for which the taps are zero, and the rows above
// and below the tile.
void stage(uint rows, uvec2 origin, uint first) {
    for (uint i = tile_lane; i < 8u * VECTORS; i += TILE_LANES) {
        uint part = i % VECTORS, x = i / VECTORS;
        uint channel = first + part;
        vec4 taps[9];
        [[unroll]] for (uint t = 0u; t < 9u; ++t) taps[t] = LOAD_WEIGHTS(depthwise, (t + 1u) * src_channels + channel);
        vec4 bias = LOAD_WEIGHTS(depthwise, channel);
        uint center = origin.x + x;
        bool left = center > 0u, right = center + 1u < width;
        [[unroll]] for (uint ky = 0u; ky < 3u; ++ky) {
            taps[3u * ky] = mix(vec4(0.0), taps[3u * ky], bvec4(left));
            taps[3u * ky + 2u] = mix(vec4(0.0), taps[3u * ky + 2u], bvec4(right));
        }
        uint columns[3] = uint[](channel + (left ? center - 1u : center) * src_stride, channel + center * src_stride,
            channel + (right ? center + 1u : center) * src_stride);
        // Of the row of results above the row that is loaded, of its own, and of the one below.
        vec4 above = bias, own = bias;
        [[unroll]] for (uint y = 0u; y <= 9u; ++y) {
            uint sy = origin.y + y - 1u;
            bool inside = true;
            if (y == 0u || y == 9u) {
                inside = sy < height;
                sy = inside ? sy : origin.y;
            }
            vec4 row[3];
            [[unroll]] for (uint dx = 0u; dx < 3u; ++dx) {
                uvec2 halves = src.v[sy * width * src_stride + columns[dx]];
                row[dx] = widen(mix(uvec2(0u), halves, bvec2(inside)));
            }
            if (y >= 2u) {
                uvec2 halves = narrow(activate(add_row(above, row, taps, 2u), INNER_EPILOGUE));
                uint to = rows + ((y - 2u) * 8u + x) * STRIDE + part / 2u;
                staged[to][part % 2u * 2u] = halves.x;
                staged[to][part % 2u * 2u + 1u] = halves.y;
            }
            above = add_row(own, row, taps, 1u);
            own = add_row(bias, row, taps, 0u);
        }
    }
}

void finish(uvec2 at, uint channel, vec4 value) {
    uint pixel = at.y * width + at.x;
    if ((EPILOGUE & FLAG_FILM) != 0u) {
        value = LOAD_WEIGHTS(film, channel) * value + LOAD_WEIGHTS(film, dst_channels + channel);
    }
    if ((EPILOGUE & FLAG_RESIDUAL) != 0u) value += LOAD(residual, pixel * residual_stride + channel);
    STORE(dst, pixel * dst_stride + channel, activate(value, EPILOGUE));
}

void main() {
    uint slot = group_index() * TILES + own_tile;
    uint count = tiles_of(tile_count, flags, tiles);
    if (group_index() * TILES >= count) return;                                      // whole groups only
    bool live = slot < count;
    uvec2 origin = tile_origin(min(slot, count - 1u), first_tile, flags, tiles);
    uint rows = own_tile * TOKENS * STRIDE;
    uint inputs = 4u * src_channels;
    bool computes = live && own_outputs * (OUTPUTS / 4u) < dst_channels;
    const uint BLOCKS = INPUTS / 16u;

    clear_sums();
    for (uint first = 0u; first < inputs; first += INPUTS) {
        barrier();
        stage(rows, origin, first / 4u);
        stage_weights(Vectors(weights), first / 16u, inputs / 16u, 0u, BLOCKS, BLOCKS);
        barrier();
        if (computes) multiply_add(rows, STRIDE, own_split * BLOCKS, INPUTS);
    }
    FINISH_SUMS(finish)
}
