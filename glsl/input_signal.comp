// A signal beside the colour to what predicted kernels read of it, padded by reflection: the reliability times the
// image, and the reliability; then what goes around the kernels.
//
// A part of the light (FLAG_LIGHT) is exposed and divided by the albedo as the colour is, and what the colour counts
// for decides what a part of it does, so that parts that add up to the colour still do: where the colour is mended,
// so is the part, from the same pixels; where it is negative and so counts as 0, so does the part; where the
// network's range ends, the part is cut by the same factor. Any other signal is taken as it is.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/planes.glsl"
#include "shared/stats.glsl"
#include "shared/log_exp.glsl"
#include "shared/input_grid.glsl"
#include "shared/kernels.glsl"
#include "shared/signals.glsl"

layout(local_size_x = 64) in;

#ifdef IMAGES
layout(set = 0, binding = 0) uniform texture2D color_image;
#endif

layout(push_constant) uniform Push {
    Planes planes;
    Stats stats;
    Uints tile_stats;
    SignalPlanes signal;
    Weights taps;         // the colour's
    Source albedo;
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint dst_width;
    uint strides;         // of taps | albedo << 8, in vectors of four
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    float blend;
};

#define tiles_x ((width + 7u) / 8u)
#include "shared/read_color.glsl"
#include "shared/read_signal.glsl"
#include "shared/samples.glsl"
#include "shared/mend.glsl"

// A sample of the light as a part of the colour counts: 0 where the colour is negative.
vec3 part_of(vec3 signal, vec3 color) {
    return mix(signal, vec3(0.0), bvec3(uvec3(lessThan(color, vec3(0.0))) & uvec3(are_finite(color))));
}

// By channel, the means of the signal and of the colour over the nearest ring of pixels that has good samples of
// both, the colour's exposed; of a signal that is no light, of its own samples that are finite.
struct Means {
    vec3 signal;
    vec3 color;
};

Means mended_signal(uvec2 at, bool light) {
    Means means = Means(vec3(0.0), vec3(0.0));
    bvec3 found = bvec3(false);
    for (uint reach = 1u; reach <= MEND_REACH && !all(found); ++reach) {
        vec3 sum = vec3(0.0);
        vec3 color_sum = vec3(0.0);
        vec3 count = vec3(0.0);
        uvec4 box = around(at, reach);
        for (uint y = box.y; y <= box.w; ++y) {
            for (uint x = box.x; x <= box.z; ++x) {
                uvec2 away = uvec2(abs(ivec2(x, y) - ivec2(at)));
                if (max(away.x, away.y) != reach) continue;
                vec3 own = read_signal(uvec2(x, y));
                vec3 color = vec3(0.0);
                bvec3 counts = are_finite(own);
                if (light) {
                    color = read_color(uvec2(x, y));
                    if (way_of(uvec2(x, y), color) != AS_IT_IS) continue;
                    own = part_of(own, color);
                    counts = bvec3(uvec3(counts) & uvec3(are_finite(color)));
                }
                sum += mix(vec3(0.0), own, counts);
                color_sum += mix(vec3(0.0), light_of(color) * stats.exposure, counts);
                count += vec3(counts);
            }
        }
        bvec3 takes = bvec3(uvec3(greaterThan(count, vec3(0.0))) & ~uvec3(found));
        means.signal = mix(means.signal, sum / max(count, 1.0), takes);
        means.color = mix(means.color, color_sum / max(count, 1.0), takes);
        found = bvec3(uvec3(found) | uvec3(takes));
    }
    return means;
}

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 to = tile_origin(slot, first_tile, flags, tiles);
    to += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uvec2 at = uvec2(reflect_index(to.x, width), reflect_index(to.y, height));
    uint pixel = to.y * dst_width + to.x;
    float b = LOAD_WEIGHTS(taps, pixel * (strides & 255u)).w;
    bool light = (flags & FLAG_LIGHT) != 0u;

    vec3 own = read_signal(at);
    vec3 color = light ? read_color(at) : vec3(0.0);
    bvec3 finite = are_finite(own);
    bvec3 finite_color = are_finite(color);
    bvec3 overflows = bvec3(uvec3(are_infinite(color)) & uvec3(are_infinite(own)));
    uint way = light ? way_of(at, color) : AS_IT_IS;
    bool lamp = false;
    float infinite = any(are_infinite(color)) ? infinite_light(at, lamp) : 0.0;
    float exposure = light ? stats.exposure : 1.0;

    // What the colour is given to the network as, and what this part of it is.
    vec3 exposed = mix(min(light_of(color) * exposure, MAX_FLOAT), vec3(infinite), are_infinite(color));
    vec3 given = clamp(part_of(own, color) * exposure, -MAX_FLOAT, MAX_FLOAT);
    bvec3 missing = way == AS_IT_IS
        ? bvec3(~(uvec3(finite_color) | uvec3(are_infinite(color))) & 1u | ~(uvec3(finite) | uvec3(overflows)) & 1u)
        : bvec3(true);
    vec3 counted = exposed;
    if (any(missing)) {
        Means means = mended_signal(at, light);
        given = mix(given, means.signal * exposure, missing);
        counted = mix(counted, means.color, missing);
    }
    given = mix(given, vec3(infinite), overflows);
    given *= min(RANGE / max(counted, RANGE), 1.0);

    // Its share of what goes around the network.
    vec3 beyond = vec3(0.0);
    if (way == KEPT || lamp || (way == AS_IT_IS && largest_of(counted) > RANGE)) {
        vec3 rest = max(exposed - min(counted, RANGE), 0.0);
        bvec3 shares = bvec3(uvec3(finite_color) & uvec3(finite) & uvec3(greaterThan(exposed, vec3(0.0))));
        beyond = mix(vec3(0.0), own * exposure * (rest / max(exposed, 1e-30)), shares);
        beyond = mix(beyond, rest, overflows);
    }
    bvec3 alone = bvec3(uvec3(overflows) & uint(lamp));
    vec3 direct = mix(blend * given + beyond, vec3(infinite), alone);
    vec3 divisor = light ? demodulator(LOAD(albedo, pixel * (strides >> 8u)).xyz) : vec3(1.0);
    STORE(dst, 2u * pixel, vec4(b * (given / divisor), b));
    STORE(dst, 2u * pixel + 1u, vec4(direct, dot(vec3(alone), vec3(1.0, 2.0, 4.0))));
}
