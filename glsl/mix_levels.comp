// The levels of predicted kernels to one picture: enlarged bilinearly, mixed by their shares, times the albedo; GATED:
// mixed with the network's own estimate, in the logarithm; GLOSS: of two images a level, one as it was before it was
// divided by the albedo. Exposed radiance.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/log_exp.glsl"
#include "shared/kernels.glsl"
TEXELS_OF(0, pixels)
TEXELS_OF(1, level_0)
TEXELS_OF(2, level_1)
TEXELS_OF(3, level_2)
TEXELS_OF(4, level_3)
TEXELS_OF(5, color)
TEXELS_OF(6, residual)

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source pixels;
    Source level_0;
    Source level_1;
    Source level_2;       // read where there are so many levels
    Source level_3;
    Source color;         // read with FLAG_GATED
    Source residual;
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint pixels_stride;   // strides in vectors of four
    uint level_strides;   // a byte each
    uint color_stride;
    uint residual_stride;
    uint dst_stride;
    uint images;
    uint levels;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

const uint FLAG_GATED = 2u;

// Four tokens of a level around a pixel, and how near they are.
struct Around {
    uvec4 from;
    vec4 shares;
};

Around around(uvec2 at, uint level) {
    uint shift = level + 1u;
    uvec2 size = uvec2(width, height) >> shift;
    vec2 middle = (vec2(at) + 0.5) / float(1u << shift) - 0.5;
    ivec2 first = ivec2(floor(middle));
    vec2 far = middle - vec2(first);
    uvec2 low = uvec2(max(first, ivec2(0)));
    uvec2 high = min(uvec2(first + 1), size - 1u);
    vec2 near = 1.0 - far;
    uvec4 tokens = uvec4(low.y, low.y, high.y, high.y) * size.x + uvec4(low.x, high.x, low.x, high.x);
    vec4 shares = vec4(near.x, far.x, near.x, far.x) * vec4(near.y, near.y, far.y, far.y);
    return Around(tokens * ((level_strides >> (8u * level)) & 255u), shares);
}

#define ENLARGED(map, place, image) \
    ((place).shares.x * LOAD(map, (place).from.x + (image)) + (place).shares.y * LOAD(map, (place).from.y + (image)) \
    + (place).shares.z * LOAD(map, (place).from.z + (image)) + (place).shares.w * LOAD(map, (place).from.w + (image)))

// A level's part of a pixel.
#define ADD_LEVEL(share, map, place) \
    if (gloss) { \
        vec4 divided = ENLARGED(map, place, 0u); \
        vec4 undivided = ENLARGED(map, place, 1u); \
        mixed += (share) * vec4(with_gloss(divided.xyz, undivided.xyz, albedo.xyz, albedo.w), divided.w); \
    } else { \
        mixed += (share) * ENLARGED(map, place, image); \
    }

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    at += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uint pixel = at.y * width + at.x;
    uint from = pixel * pixels_stride;
    vec4 albedo = LOAD(pixels, from + images);
    vec4 shares = LOAD(pixels, from + images + 1u);
    Around place_0 = around(at, 0u);
    Around place_1 = around(at, 1u);
    Around place_2 = around(at, 2u);
    Around place_3 = around(at, 3u);
    bool gloss = (flags & FLAG_GLOSS) != 0u;
    for (uint image = 0u; image < images; ++image) {
        // Three channels, and the share of what there is.
        vec4 mixed = LOAD(pixels, from + image);
        ADD_LEVEL(shares.x, level_0, place_0)
        ADD_LEVEL(shares.y, level_1, place_1)
        if (levels > 2u) {
            ADD_LEVEL(shares.z, level_2, place_2)
            ADD_LEVEL(shares.w, level_3, place_3)
        }
        vec3 radiance = mixed.xyz / mixed.w;
        if (!gloss) radiance *= albedo.xyz;
        if ((flags & FLAG_GATED) != 0u && image == 0u) {
            vec3 direct = LOAD(color, pixel * color_stride).xyz + LOAD(residual, pixel * residual_stride).xyz;
            for (int i = 0; i < 3; ++i) {
                float averaged = log1p(max(radiance[i], 0.0));
                radiance[i] = expm1(min(direct[i] + albedo.w * (averaged - direct[i]), 88.0));
            }
        }
        STORE(dst, pixel * dst_stride + image, vec4(radiance, 0.0));
    }
}
