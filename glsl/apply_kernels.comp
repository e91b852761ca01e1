// Kernels of every token over images stored as sums and their weight. A group works on one tile of 8x8 tokens; what they read of an
// image lies in shared memory.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/kernels.glsl"
TEXELS_OF(0, logits)
TEXELS_OF(1, sums)

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source logits;
    Weights sums;
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint logits_stride;   // strides in vectors of four
    uint sums_stride;
    uint dst_stride;
    uint images;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

const int SIDE = 12;      // the tile and two tokens on each side

shared vec4 taps[SIDE * SIDE];

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    ivec2 origin = ivec2(tile_origin(slot, first_tile, flags, tiles));
    ivec2 own = ivec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uint at = uint(origin.y + own.y) * width + uint(origin.x + own.x);
    for (uint image = 0u; image < images; ++image) {
        barrier();
        for (int i = int(gl_LocalInvocationID.x); i < SIDE * SIDE; i += 64) {
            ivec2 from = origin + ivec2(i % SIDE, i / SIDE) - 2;
            bool inside = min(from.x, from.y) >= 0 && from.x < int(width) && from.y < int(height);
            uvec2 clamped = uvec2(clamp(from, ivec2(0), ivec2(width, height) - 1));
            taps[i] = inside ? LOAD_WEIGHTS(sums, (clamped.y * width + clamped.x) * sums_stride + image) : vec4(0.0);
        }
        barrier();
        Average average = no_average();
        for (uint n = 0u; n < 7u; ++n) {
            vec4 read[4];
            [[unroll]] for (uint i = 0u; i < 4u; ++i) {
                uint tap = min(4u * n + i, 24u);
                read[i] = taps[(own.y + int(tap / 5u)) * SIDE + own.x + int(tap % 5u)];
                if (4u * n + i > 24u) read[i] = vec4(0.0);
            }
            average = with_taps(average, LOAD(logits, at * logits_stride + n), read);
        }
        // Where nothing has a weight (beside tiles that are not computed) there is no mean.
        bool any = average.sum.w > 0.0;
        STORE(dst, at * dst_stride + image, any ? vec4(average.sum.xyz / average.sum.w, 1.0) : vec4(0.0));
    }
}
