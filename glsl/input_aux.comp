// Albedo, normal and depth to the network's seven auxiliary channels, padded by reflection. FILTERED: the albedo is a
// mean where it is noisy.
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
    return texelFetch(albedo_image, image_texel(albedo_plane, at), 0).rgb;
#else
    uint index = plane_index(albedo_plane, at);
    return vec3(any_sample(albedo_plane, index, 0u), any_sample(albedo_plane, index, 1u),
        any_sample(albedo_plane, index, 2u));
#endif
}

// A point of the octahedron's map (Cigolle et al., "A Survey of Efficient Representations for Independent Unit
// Vectors", 2014).
vec3 of_octahedron(vec2 e) {
    vec3 n = vec3(e, 1.0 - abs(e.x) - abs(e.y));
    if (n.z < 0.0) n.xy = (1.0 - abs(n.yx)) * mix(vec2(-1.0), vec2(1.0), greaterThanEqual(n.xy, vec2(0.0)));
    return normalize(n);
}

vec3 read_normal(uvec2 at) {
    uint format = normal_plane.format;
    bool octahedral = (format & FORMAT_OCTAHEDRAL) != 0u;
#ifdef IMAGES
    vec3 n = texelFetch(normal_image, image_texel(normal_plane, at), 0).rgb;
    if (octahedral) n.z = 0.0;
#else
    uint index = plane_index(normal_plane, at);
    vec3 n = vec3(any_sample(normal_plane, index, 0u), any_sample(normal_plane, index, 1u), 0.0);
    if (!octahedral) n.z = any_sample(normal_plane, index, 2u);
#endif
    // Zeros are no normal, also where they are stored.
    if ((format & FORMAT_HALVED) != 0u && (octahedral || n != vec3(0.0))) n = n * 2.0 - 1.0;
    return octahedral ? of_octahedron(n.xy) : n;
}

// Finite values clamped to [0, 1]; others, as if missing, `otherwise`.
float unit_or(float x, float otherwise) {
    return is_finite(x) ? clamp(x, 0.0, 1.0) : otherwise;
}

vec3 unit_albedo(uvec2 at) {
    if (!is_present(albedo_plane.format)) return vec3(0.0);
    vec3 a = read_albedo(at);
    return vec3(unit_or(a.x, 0.0), unit_or(a.y, 0.0), unit_or(a.z, 0.0));
}

vec3 unit_normal(uvec2 at) {
    if (!is_present(normal_plane.format)) return vec3(0.5);
    vec3 n = read_normal(at) * 0.5 + 0.5;
    return vec3(unit_or(n.x, 0.5), unit_or(n.y, 0.5), unit_or(n.z, 0.5));
}

#ifdef FILTERED
#include "shared/noisy_albedo.glsl"
#endif

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 origin = tile_origin(slot, first_tile, flags, tiles);
    uvec2 to = origin + uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uvec2 at = uvec2(reflect_index(to.x, width), reflect_index(to.y, height));

#ifdef FILTERED
    vec3 a;
    // Both are needed to tell noise from texture. The same for all invocations.
    if (is_present(albedo_plane.format) && is_present(normal_plane.format)) {
        a = filtered_albedo(origin, uvec2(width, height));
    } else {
        a = unit_albedo(at);
    }
#else
    vec3 a = unit_albedo(at);
#endif
    vec3 n = unit_normal(at);
    float d = 0.0;
    if (is_present(depth_plane.format)) d = min(read_depth(at) / depth_scale.v[0], 1.0);
    uint index = (to.y * dst_width + to.x) * 2u;
    STORE(dst, index, vec4(a, n.x));
    STORE(dst, index + 1u, vec4(n.yz, d, 0.0));
}
