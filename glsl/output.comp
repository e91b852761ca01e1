// The network's residual to the denoised colour, cropped to the frame.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/stats.glsl"
#include "shared/log_exp.glsl"
#ifdef TARGET_F16
#extension GL_EXT_shader_16bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#endif
#ifdef IMAGES
#extension GL_EXT_samplerless_texture_functions : require
#endif

layout(local_size_x = 64) in;

#ifdef IMAGES
layout(set = 0, binding = 0) uniform texture2D color_image;      // for its alpha
layout(set = 0, binding = 1, TARGET_FORMAT) uniform writeonly image2D dst_image;
#define PLANE Uints
#elif defined(TARGET_F16)
layout(buffer_reference, std430, buffer_reference_align = 2) writeonly buffer HalfPlane { float16_t v[]; };
#define PLANE HalfPlane
#define TARGET_MAX 65504.0
#else
layout(buffer_reference, std430, buffer_reference_align = 4) writeonly buffer FloatPlane { float v[]; };
#define PLANE FloatPlane
#endif
#ifndef TARGET_MAX
#define TARGET_MAX 3.402823466e38
#endif

layout(push_constant) uniform Push {
    Source residual;
    Source log_color;
    Stats stats;
    PLANE dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint dst_offset;      // in samples, like the strides
    uint dst_pixel;
    uint dst_row;
    uint dst_channel;
    uint left;            // the pixels to write, ends excluded
    uint top;
    uint right;
    uint bottom;
    uint src_width;
    uint residual_stride; // in vectors of four
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    float blend;
};

// Where expm1 ends: the largest float's logarithm.
const float MAX_LOG = 88.0;

float linear_color(float log_value, float inverse_exposure) {
    // A frame's exposure may be tiny: the product may exceed a float.
    return min(max(expm1(min(log_value, MAX_LOG)), 0.0) * inverse_exposure, TARGET_MAX);
}

void main() {
    uint slot = group_index();
    if (slot >= tile_count) return;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    at += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    if (at.x < left || at.x >= right || at.y < top || at.y >= bottom) return;

    uint pixel = at.y * src_width + at.x;
    vec3 noisy = LOAD(log_color, pixel).xyz;
    vec3 clean = noisy + LOAD(residual, pixel * residual_stride).xyz;
    float inverse = 1.0 / stats.exposure;
    vec3 color;
    for (int i = 0; i < 3; ++i) {
        color[i] = linear_color(clean[i], inverse);
        if (blend > 0.0) color[i] = mix(color[i], linear_color(noisy[i], inverse), blend);
    }
#ifdef IMAGES
    imageStore(dst_image, ivec2(at), vec4(color, texelFetch(color_image, ivec2(at), 0).a));
#else
    uint index = dst_offset + at.y * dst_row + at.x * dst_pixel;
#ifdef TARGET_F16
    for (int i = 0; i < 3; ++i) dst.v[index + i * dst_channel] = float16_t(color[i]);
#else
    for (int i = 0; i < 3; ++i) dst.v[index + i * dst_channel] = color[i];
#endif
#endif
}
