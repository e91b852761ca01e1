// The relative noise of every square of 16x16 pixels: from the renderer's variance or sample counts where it gives
// them, else from the frame itself. One group a square.
//
// From the frame: the second difference in both directions of log(exposed + floor), which is 0 for everything that is
// linear in x or in y, and of six times the deviation of noise (Immerkaer, "Fast Noise Variance Estimation", 1996). Its
// root mean square over 8x8 pixels, the largest of the four and of the channels: texture counts as noise, and a single
// noisy pixel shows.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/planes.glsl"
#include "shared/stats.glsl"
#include "shared/input_grid.glsl"
#include "shared/converged.glsl"

layout(local_size_x = 64) in;

#ifdef IMAGES
layout(set = 0, binding = 0) uniform texture2D color_image;
layout(set = 0, binding = 1) uniform texture2D depth_image;
layout(set = 0, binding = 2) uniform texture2D noise_image;
#endif

layout(push_constant) uniform Push {
    Planes planes;
    Stats stats;
    Floats dst;
    uint width;
    uint height;
    uint columns;
    uint tile_count;
};

#include "shared/read_color.glsl"
#include "shared/read_depth.glsl"
#include "shared/samples.glsl"


// Of the exposed colour: relative noise below it counts for less.
const float FLOOR = 0.01;
const uint SIDE = MAP_TILE + 2u;

shared vec3 logs[SIDE * SIDE];
shared vec3 squares[64];
shared uint counts[64];
shared float layers[64];
shared bool grounds[64];

Plane noise_plane = planes.noise;

float read_noise(uvec2 at) {
#ifdef IMAGES
    return texelFetch(noise_image, image_texel(noise_plane, at), 0).r;
#else
    return float_sample(noise_plane, plane_index(noise_plane, at));
#endif
}

// The relative deviation of a pixel as the renderer knows it. One sample deviates by its own size.
float layer_noise(uvec2 at, vec3 radiance) {
    float value = read_noise(at);
    if (!is_finite(value) || value < 0.0) return ALWAYS;
    if ((noise_plane.format & FORMAT_COUNTS) != 0u) return value > 0.0 ? inversesqrt(value) : ALWAYS;
    return min(sqrt(value) / (luminance(light_of(radiance)) + FLOOR / stats.exposure), ALWAYS);
}

// Whether nothing is missing of a pixel, and it is no lone bright one.
bool is_sound(uvec2 at, vec3 radiance) {
    if (!all(are_finite(radiance))) return false;
    float light = largest_of(radiance);
    if (light <= FIREFLY_KEYS * stats.key) return true;
    vec2 neighbours = brightest_around(at);
    return !is_absurd(light, stats.key, neighbours) && !is_firefly(light, stats.key, neighbours);
}

vec3 log_at(uint x, uint y) {
    return logs[y * SIDE + x];
}

void main() {
    uint tile = group_index();
    if (tile >= tile_count) return;
    uvec2 origin = uvec2(tile % columns, tile / columns) * MAP_TILE;
    uint lane = gl_LocalInvocationID.x;
    if (origin.x >= width || origin.y >= height) {
        if (lane == 0u) dst.v[tile] = 0.0;
        return;
    }

    // Beyond the frame it is mirrored, which makes noise at its border count double.
    for (uint i = lane; i < SIDE * SIDE; i += 64u) {
        ivec2 at = abs(ivec2(origin) + ivec2(i % SIDE, i / SIDE) - 1);
        vec3 radiance = read_color(uvec2(reflect_index(uint(at.x), width), reflect_index(uint(at.y), height)));
        vec3 exposed = min(light_of(radiance) * stats.exposure, vec3(MAX_FLOAT));
        logs[i] = all(are_finite(radiance)) ? log(exposed + FLOOR) : vec3(0.0);
    }
    barrier();

    // Four pixels of a quarter, one below the other.
    uvec2 corner = uvec2(lane / 16u % 2u, lane / 32u) * 8u + uvec2(lane % 8u, lane % 16u / 8u);
    vec3 sum = vec3(0.0);
    uint count = 0u;
    float layer = 0.0;
    bool ground = false;
    for (uint i = 0u; i < 4u; ++i) {
        uvec2 local = corner + uvec2(0u, 2u * i);
        uvec2 at = origin + local;
        if (at.x >= width || at.y >= height) continue;
        vec3 radiance = read_color(at);
        if (!is_sound(at, radiance)) sum = vec3(ALWAYS);
        if (is_present(noise_plane.format)) layer = max(layer, layer_noise(at, radiance));
        if (!is_present(depth_plane.format) || read_depth(at) > 0.0) ground = true;
        vec3 response = vec3(0.0);
        for (uint y = 0u; y < 3u; ++y) {
            float weight = y == 1u ? -2.0 : 1.0;
            uvec2 at = uvec2(local.x, local.y + y);
            response += weight * (log_at(at.x, at.y) - 2.0 * log_at(at.x + 1u, at.y) + log_at(at.x + 2u, at.y));
        }
        sum += response * response;
        ++count;
    }
    squares[lane] = sum;
    counts[lane] = count;
    layers[lane] = layer;
    grounds[lane] = ground;
    barrier();
    if (lane != 0u) return;

    float estimate = 0.0;
    bool bad = false;
    for (uint quarter = 0u; quarter < 64u; quarter += 16u) {
        vec3 total = vec3(0.0);
        uint pixels = 0u;
        for (uint i = quarter; i < quarter + 16u; ++i) {
            bad = bad || squares[i].x >= ALWAYS;
            total += squares[i];
            pixels += counts[i];
            layer = max(layer, layers[i]);
            ground = ground || grounds[i];
        }
        if (pixels > 0u) estimate = max(estimate, max(total.x, max(total.y, total.z)) / float(pixels));
    }
    estimate = sqrt(estimate) / 6.0;
    // A line of pixels has no second difference across.
    if (width < 3u || height < 3u) estimate = ALWAYS;
    float value = estimate;
    if ((noise_plane.format & FORMAT_VARIANCE) != 0u) value = layer;
    // Few samples are enough where there is nothing to light.
    if ((noise_plane.format & FORMAT_COUNTS) != 0u) value = ground ? layer : min(layer, estimate);
    dst.v[tile] = bad ? ALWAYS : min(value, ALWAYS);
}
