// Light and noise of every 8x8 tile of the frame, and of every eight tiles together. An invocation takes a row of a
// tile.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/planes.glsl"
#include "shared/stats.glsl"

layout(local_size_x = 64) in;

#ifdef IMAGES
layout(set = 0, binding = 0) uniform texture2D color_image;
#endif

layout(push_constant) uniform Push {
    Planes planes;
    Stats stats;
    Uints tile_stats;
    Floats runs;
    uint width;
    uint height;
    uint tiles_x;
    uint tile_count;
};

#include "shared/read_color.glsl"
#include "shared/samples.glsl"

// A lit pixel is noisy if it differs from the mean of its neighbours on the left and on the right by more than this
// share of what the three have: a quarter of the pixels do where independent noise has a deviation of 11 %.
const float NOISY = 0.08;

shared vec4 means[64];        // of the channels, and luminance
shared vec3 largest[64];
shared uvec4 counts[64];      // good samples of the channels, pixels of luminance
shared uvec2 pixels[64];      // lit ones, noisy ones
// Of a tile.
shared float logs[RUN_TILES];
shared uint lights[RUN_TILES];
shared uint gaps[RUN_TILES];

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint tile = group_index() * RUN_TILES + lane / 8u;
    uvec2 first = uvec2(tile % tiles_x * 8u, tile / tiles_x * 8u + lane % 8u);
    float median = stats.median;
    // Relative to the median, so that neither the sum nor a product leaves the range of floats.
    float unit = median > 0.0 ? 1.0 / median : 0.0;
    vec4 mean = vec4(0.0);
    vec3 most = vec3(0.0);
    uvec4 count = uvec4(0u);
    uvec2 seen = uvec2(0u);
    if (tile < tile_count && first.y < height) {
        uint end = min(first.x + 8u, width);
        // Luminance of the last pixel and of the one before it; below 0 where there is none.
        vec2 last = vec2(-1.0);
        for (uint x = first.x; x < end; ++x) {
            vec3 color = read_color(uvec2(x, first.y));
            bvec3 finite = are_finite(color);
            vec3 light = light_of(color);
            float brightest = largest_of(light);
            bool bright = brightest > ABSURD_KEYS * median;
            // The key is not known yet; the median stands in.
            if (!bright || !is_absurd(brightest, median, brightest_around(uvec2(x, first.y)))) most = max(most, light);
            mean.xyz += min(light, vec3(TILE_CAP * median)) / 64.0;
            count.xyz += uvec3(finite);
            float l = all(finite) ? luminance(light) : -1.0;
            if (l >= 0.0 && !bright) {
                mean.w += min(l * unit, TILE_CAP);
                ++count.w;
            }
            if (last.y >= 0.0 && last.x > 0.0 && l >= 0.0) {
                // Exact but for one rounding each.
                precise float outer = 0.25 * last.y + 0.25 * l;
                precise float apart = abs(outer - 0.5 * last.x);
                precise float all_three = outer + 0.5 * last.x;
                seen += uvec2(1u, apart > NOISY * all_three ? 1u : 0u);
            }
            last = vec2(l, last.x);
        }
    }
    means[lane] = mean;
    largest[lane] = most;
    counts[lane] = count;
    pixels[lane] = seen;
    barrier();

    // The rows of a tile.
    tile = group_index() * RUN_TILES + lane;
    if (lane < RUN_TILES && tile < tile_count) {
        mean = means[8u * lane];
        most = largest[8u * lane];
        count = counts[8u * lane];
        seen = pixels[8u * lane];
        for (uint row = 8u * lane + 1u; row < 8u * lane + 8u; ++row) {
            mean += means[row];
            most = max(most, largest[row]);
            count += counts[row];
            seen += pixels[row];
        }
        bool gap = false;
        for (uint i = 0u; i < 3u; ++i) {
            bool has = count[i] > 0u;
            float value = mean[i] * (64.0 / max(float(count[i]), 1.0));
            tile_stats.v[tile * TILE_WORDS + i] = has ? floatBitsToUint(value) : NO_SAMPLE;
            gap = gap || !has;
        }
        tile_stats.v[tile * TILE_WORDS + 3u] = seen.x | seen.y << 16;
        bool lit = mean.w > 0.0;
        logs[lane] = lit ? log2(max(mean.w / float(count.w), TILE_FLOOR)) : 0.0;
        lights[lane] = lit ? 1u : 0u;
        gaps[lane] = gap ? 1u : 0u;
    }
    barrier();
    if (lane < RUN_TILES && tile < tile_count) {
        // What the tile's first row was is no longer needed.
        largest[8u * lane] = most;
        pixels[8u * lane] = seen;
    }
    barrier();

    uint run = group_index();
    if (lane > 0u || run * RUN_TILES >= tile_count) return;
    float sum = 0.0;
    uvec2 total = uvec2(0u);
    uint light = 0u;
    uint gap = 0u;
    most = vec3(0.0);
    for (uint i = 0u; i < min(RUN_TILES, tile_count - run * RUN_TILES); ++i) {
        sum += logs[i];
        light += lights[i];
        total += pixels[8u * i];
        most = max(most, largest[8u * i]);
        gap += gaps[i];
    }
    float values[RUN_FLOATS] =
        float[](sum, float(light), float(total.y), float(total.x), most.x, most.y, most.z, float(gap));
    for (uint i = 0u; i < RUN_FLOATS; ++i) runs.v[run * RUN_FLOATS + i] = values[i];
}
