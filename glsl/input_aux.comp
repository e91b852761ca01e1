// Albedo, normal and depth to the network's seven auxiliary channels, padded by reflection.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/planes.glsl"
#include "shared/input_grid.glsl"

layout(local_size_x = 64) in;

#ifdef IMAGES
layout(set = 0, binding = 0) uniform texture2D albedo_image;
layout(set = 0, binding = 1) uniform texture2D normal_image;
layout(set = 0, binding = 2) uniform texture2D depth_image;
#endif

layout(push_constant) uniform Push {
    Planes planes;
    ReadFloats depth_scale;
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint dst_width;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

#include "shared/read_depth.glsl"

Plane albedo_plane = planes.albedo;
Plane normal_plane = planes.normal;

vec3 read_albedo(uvec2 at) {
#ifdef IMAGES
    return texelFetch(albedo_image, ivec2(at), 0).rgb;
#else
    return plane_samples(albedo_plane, at);
#endif
}

vec3 read_normal(uvec2 at) {
#ifdef IMAGES
    return texelFetch(normal_image, ivec2(at), 0).rgb;
#else
    return plane_samples(normal_plane, at);
#endif
}

// Finite values clamped to [0, 1]; others, as if missing, `otherwise`.
float unit_or(float x, float otherwise) {
    return is_finite(x) ? clamp(x, 0.0, 1.0) : otherwise;
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 to = tile_origin(slot, first_tile, flags, tiles);
    to += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uvec2 at = uvec2(reflect_index(to.x, width), reflect_index(to.y, height));

    vec3 a = vec3(0.0);
    if (is_present(albedo_plane.format)) {
        a = read_albedo(at);
        a = vec3(unit_or(a.x, 0.0), unit_or(a.y, 0.0), unit_or(a.z, 0.0));
    }
    vec3 n = vec3(0.5);
    if (is_present(normal_plane.format)) {
        n = read_normal(at) * 0.5 + 0.5;
        n = vec3(unit_or(n.x, 0.5), unit_or(n.y, 0.5), unit_or(n.z, 0.5));
    }
    float d = 0.0;
    if (is_present(depth_plane.format)) d = min(read_depth(at) / depth_scale.v[0], 1.0);
    uint index = (to.y * dst_width + to.x) * 2u;
    STORE(dst, index, vec4(a, n.x));
    STORE(dst, index + 1u, vec4(n.yz, d, 0.0));
}
