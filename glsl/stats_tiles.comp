// Log-luminance of every 8x8 tile of the frame, one invocation a tile.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/planes.glsl"
#include "shared/stats.glsl"

layout(local_size_x = 64) in;

#ifdef IMAGES
layout(set = 0, binding = 0) uniform texture2D color_image;
#define PLANE Uints
#else
#define PLANE Plane
#endif

layout(push_constant) uniform Push {
    PLANE color;
    Stats stats;
    Floats dst;
    uint color_offset;
    uint color_pixel;
    uint color_row;
    uint color_channel;
    uint width;
    uint height;
    uint tiles_x;
    uint tile_count;
    uint flags;
    uint unused;
};

#include "shared/read_color.glsl"

void main() {
    uint tile = group_index() * 64u + gl_LocalInvocationID.x;
    if (tile >= tile_count) return;
    float median = stats.median;
    uvec2 first = uvec2(tile % tiles_x, tile / tiles_x) * 8u;
    uvec2 end = min(first + 8u, uvec2(width, height));
    // Relative to the median, so that neither the sum nor a product leaves the range of floats.
    float sum = 0.0;
    uint valid = 0u;
    for (uint y = first.y; y < end.y; ++y) {
        for (uint x = first.x; x < end.x; ++x) {
            vec3 radiance = read_color(uvec2(x, y));
            // Bad pixels stay out; the key is not known yet, the median stands in.
            if (!is_valid(radiance) || max(radiance.x, max(radiance.y, radiance.z)) > BAD_PIXEL * median) continue;
            sum += median > 0.0 ? min(luminance(radiance) / median, TILE_CAP) : 0.0;
            ++valid;
        }
    }
    dst.v[tile] = sum > 0.0 ? log2(max(sum / float(valid), TILE_FLOOR)) : NO_LIGHT;
}
