// Joint attention of one 8x8 window and one head, maps of halves, on cooperative matrices
// (shared/attention_matrix.glsl).
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#define SUBGROUPS (64u / ROWS)                  // of a window
#include "shared/matrix.glsl"

layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Vectors { uvec4 v[]; };

layout(push_constant) uniform Push {
    Source x;             // [Q | K | V], head-major
    Source f;             // [Qf | Kf], head-major
    ReadFloats bias;      // for every head [query][key]
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint x_stride;        // strides and widths in vectors of four
    uint f_stride;
    uint dst_stride;
    uint heads;
    uint key_vectors;
    uint value_vectors;
    float scale;          // 1 / sqrt(d)
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

#include "shared/attention_sizes.glsl"
shared uvec4 staged[STAGED_ATTENTION];
#include "shared/attention_matrix.glsl"

uint window_pixel;

uint token_pixel(uint token) {
    return window_pixel + (token / 8u) * width + token % 8u;
}

// Stages `vectors` of eight channels of every token, of which `real` exist.
void stage(Vectors from, uint stride, uint first, uint to, uint to_stride, const uint vectors, const uint real) {
    for (uint i = gl_LocalInvocationID.x; i < WINDOW * vectors; i += INVOCATIONS) {
        uint token = i / vectors, part = i % vectors;
        uvec4 halves = uvec4(0u);
        if (part < real) halves = from.v[token_pixel(token) * (stride / 2u) + first + part];
        staged[to + token * to_stride + part] = halves;
    }
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;                          // whole groups only
    uint head = gl_WorkGroupID.y;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    window_pixel = at.y * width + at.x;

    const uint REAL = KEYS / 8u;
    stage(Vectors(x), x_stride, head * REAL, 0u, KEY_STRIDE, DEPTH_KEYS / 8u, REAL);
    stage(Vectors(x), x_stride, (heads + head) * REAL, WINDOW * KEY_STRIDE, KEY_STRIDE, DEPTH_KEYS / 8u, REAL);
    stage(Vectors(f), f_stride, head * REAL, 2u * WINDOW * KEY_STRIDE, KEY_STRIDE, DEPTH_KEYS / 8u, REAL);
    stage(Vectors(f), f_stride, (heads + head) * REAL, 3u * WINDOW * KEY_STRIDE, KEY_STRIDE, DEPTH_KEYS / 8u, REAL);
    uint first_value = 2u * heads * REAL + head * (VALUES / 8u);
    stage(Vectors(x), x_stride, first_value, VALUES_AT, VALUE_STRIDE, VALUES / 8u, VALUES / 8u);
    barrier();

    attend(head);
    for (uint i = gl_SubgroupInvocationID; i < QUERIES * VALUES / 4u; i += LANES) {
        uint row = i / (VALUES / 4u), c = i % (VALUES / 4u);
        uint token = gl_SubgroupID * QUERIES + row;
        vec4 value = uintBitsToFloat(staged[own_scores + row * SCORE_STRIDE + c]) * inverse_sums[token];
        STORE(dst, token_pixel(token) * dst_stride + head * (VALUES / 4u) + c, value);
    }
}
