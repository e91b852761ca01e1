// The network's residual to the denoised colour, cropped to the frame: an average of what came in, so at most its
// largest sample. Light that went around the network is added. Where a map says what is converged, converged pixels are
// the caller's, but for a blend beside those that are not. Of two members of an ensemble the first, turned by half a
// circle, goes to memory, and the second is averaged with it.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/stats.glsl"
#include "shared/log_exp.glsl"
#include "shared/target_plane.glsl"
#include "shared/planes.glsl"
#include "shared/converged.glsl"
#include "shared/energy.glsl"

layout(local_size_x = 64) in;

#ifdef IMAGES
layout(set = 0, binding = 0) uniform texture2D color_image;
layout(set = 0, binding = 1, TARGET_FORMAT) uniform writeonly image2D dst_image;
#endif

layout(push_constant) uniform Push {
    Source residual;
    Source log_color;
    Stats stats;
    Planes planes;
    TileList tiles;       // with FLAG_TILE_LIST
    Uints map;            // with FLAG_CONVERGED
    Floats turned;        // with FLAG_TURNED and FLAG_UPRIGHT: three floats for each pixel of the frame
    Weights gains;        // with FLAG_RADIANCE
    uint left;            // the pixels to write, ends excluded
    uint top;
    uint right;
    uint bottom;
    uint src_width;
    uint residual_stride; // in vectors of four
    uint residual_top;    // the frame's row that its first one is
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    float blend;
    uint width;           // of the frame
    uint height;
    uint pixels;
    uint gain_columns;
    uint unused;
};

#include "shared/read_color.glsl"

const uint FLAG_CONVERGED = 16u;
const uint FLAG_RADIANCE = 32u;    // the network's result is exposed radiance
#include "shared/converged_share.glsl"
#include "shared/ensemble.glsl"

// Where expm1 ends: the largest float's logarithm.
const float MAX_LOG = 88.0;

float unexposed(float radiance, float inverse_exposure) {
    // A frame's exposure may be tiny: the product may exceed a float.
    return min(max(radiance, 0.0) * inverse_exposure, MAX_FLOAT);
}

float linear_color(float log_value, float inverse_exposure) {
    return unexposed(expm1(min(log_value, MAX_LOG)), inverse_exposure);
}

// The result with what of the caller's own pixel the network was not given: `taken` is what it was, `otherwise` what
// counts for samples that are not finite. +Inf of a lamp is that and nothing else.
vec3 with_light_around(vec3 color, uvec2 at, vec3 taken, float otherwise, bool lamp) {
    vec3 own = read_color(at);
    vec3 light = mix(vec3(otherwise), light_of(own), are_finite(own));
    return mix(color + max(light - taken, 0.0), light, bvec3(uvec3(are_infinite(own)) & uint(lamp)));
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    at += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    if (at.x < left || at.x >= right || at.y < top || at.y >= bottom) return;

    float converged = (flags & FLAG_CONVERGED) != 0u ? converged_share(at) : 0.0;
    vec3 color = vec3(0.0);
    if (converged < 1.0) {
        vec4 noisy = LOAD(log_color, at.y * src_width + at.x);
        vec3 result = LOAD(residual, ((at.y - residual_top) * src_width + at.x) * residual_stride).xyz;
        bool is_radiance = (flags & FLAG_RADIANCE) != 0u;
        float inverse = 1.0 / stats.exposure;
        vec3 largest = vec3(stats.largest[0], stats.largest[1], stats.largest[2]);
        for (int i = 0; i < 3; ++i) {
            color[i] = is_radiance ? unexposed(result[i], inverse) : linear_color(noisy[i] + result[i], inverse);
        }
        if (is_radiance) {
            color *= 1.0 + energy_gain(gains, gain_columns, at, uvec2(width, height)) * energy_room(color, largest);
        }
        color = min(color, largest);
        for (int i = 0; i < 3; ++i) {
            if (blend > 0.0) color[i] = mix(color[i], linear_color(noisy[i], inverse), blend);
        }
        if (noisy.w != 0.0) {
            vec3 taken = vec3(0.0);
            for (int i = 0; i < 3; ++i) taken[i] = linear_color(noisy[i], inverse);
            float otherwise = linear_color(abs(noisy.w) - 1.0, inverse);
            color = with_light_around(color, at, taken, otherwise, noisy.w < 0.0);
        }
        color = min(color, vec3(TARGET_MAX));
    }
    if (converged > 0.0) {
        vec3 own = min(light_of(read_color(at)), vec3(TARGET_MAX));
        color = converged < 1.0 ? mix(color, own, converged) : own;
    }
    if (!is_averaged(at, 3u, color)) return;
#ifdef IMAGES
    ivec2 to = image_texel(planes.result.offset, planes.result.pixel, planes.result.channel, planes.result.row, at);
    imageStore(dst_image, to, vec4(color, texelFetch(color_image, image_texel(color_plane, at), 0).a));
#else
    store_target(planes.result, at, color, true);
#endif
}
