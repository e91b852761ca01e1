// Colour to the network's input: bad pixels mended, exposed, log1p, padded by reflection.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/planes.glsl"
#include "shared/stats.glsl"
#include "shared/log_exp.glsl"
#include "shared/input_grid.glsl"

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
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint color_offset;
    uint color_pixel;
    uint color_row;
    uint color_channel;
    uint width;
    uint height;
    uint dst_width;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

#include "shared/read_color.glsl"
#include "shared/good_pixel.glsl"

const float MAX_EXPOSED = 65504.0;

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 to = tile_origin(slot, first_tile, flags, tiles);
    to += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uvec2 at = uvec2(reflect_index(to.x, width), reflect_index(to.y, height));

    vec3 radiance = read_color(at);
    if (!is_good(at, radiance)) {
        uvec4 box = around(at);
        vec3 sum = vec3(0.0);
        float count = 0.0;
        for (uint y = box.y; y <= box.w; ++y) {
            for (uint x = box.x; x <= box.z; ++x) {
                vec3 neighbour = read_color(uvec2(x, y));
                if (!is_good(uvec2(x, y), neighbour)) continue;
                sum += neighbour * stats.exposure;       // exposed: eight large values may exceed a float
                count += 1.0;
            }
        }
        radiance = count > 0.0 ? sum / count : vec3(0.0);
    } else {
        radiance *= stats.exposure;
    }
    radiance = min(radiance, vec3(MAX_EXPOSED));
    STORE(dst, to.y * dst_width + to.x, vec4(log1p(radiance.x), log1p(radiance.y), log1p(radiance.z), 0.0));
}
