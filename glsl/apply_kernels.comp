// Kernels of every token over images stored as sums and their weight. A group works on one tile of 8x8 tokens. On GPUs
// what they read of an image lies in shared memory; CPU drivers read that more slowly than texels.
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

// What a tap reads; zeros outside the map.
vec4 load_tap(ivec2 at, uint image) {
    bool inside = min(at.x, at.y) >= 0 && at.x < int(width) && at.y < int(height);
    uvec2 clamped = uvec2(clamp(at, ivec2(0), ivec2(width, height) - 1));
    return mix(vec4(0.0), LOAD_WEIGHTS(sums, (clamped.y * width + clamped.x) * sums_stride + image), bvec4(inside));
}

#ifndef TEXELS
const int SIDE = 12;      // the tile and two tokens on each side
shared vec4 taps[SIDE * SIDE];
#endif

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    ivec2 origin = ivec2(tile_origin(slot, first_tile, flags, tiles));
    ivec2 own = ivec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uint at = uint(origin.y + own.y) * width + uint(origin.x + own.x);
    for (uint image = 0u; image < images; ++image) {
#ifndef TEXELS
        barrier();
        for (int i = int(gl_LocalInvocationID.x); i < SIDE * SIDE; i += 64) {
            taps[i] = load_tap(origin + ivec2(i % SIDE, i / SIDE) - 2, image);
        }
        barrier();
#endif
        Average average = no_average();
        for (uint n = 0u; n < 7u; ++n) {
            vec4 read[4];
            [[unroll]] for (uint i = 0u; i < 4u; ++i) {
                ivec2 offset = offset_in_5x5(4u * n + i);
#ifdef TEXELS
                read[i] = load_tap(origin + own + offset, image);
#else
                read[i] = taps[(own.y + offset.y + 2) * SIDE + own.x + offset.x + 2];
#endif
                if (4u * n + i > 24u) read[i] = vec4(0.0);
            }
            average = with_taps(average, LOAD(logits, at * logits_stride + n), read);
        }
        // Where nothing has a weight (beside tiles that are not computed) there is no mean.
        bool any = average.sum.w > 0.0;
        STORE(dst, at * dst_stride + image, any ? vec4(average.sum.xyz / average.sum.w, 1.0) : vec4(0.0));
    }
}
