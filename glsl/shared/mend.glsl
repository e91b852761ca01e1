// What takes the place of missing samples, and which bright pixels go around the network: needs samples.glsl, the
// statistics of the frame and of its tiles.
const uint FLAG_MEND_FIREFLIES = 2u;
const uint FLAG_KEEP_FIREFLIES = 4u;

// A firefly that is kept: more than so many keys, and so many times the second-brightest of the neighbours.
const float KEPT_KEYS = 8.0;
const float KEPT_RATIO = 8.0;
// The farthest ring of pixels that mends one; beyond it whole tiles do.
const uint MEND_REACH = 4u;
// It is noisy where more than so large a share of the lit pixels of the 3x3 tiles around is; of fewer than so many, of
// the frame's.
const float NOISY_SHARE = 0.25;
const uint ENOUGH_LIT = 32u;

// The network's range, exposed: emitters of training reach it, the noise of one sample a pixel hardly does.
const float RANGE = 2048.0;

// A pixel as the network is to take it.
const uint AS_IT_IS = 0u;
const uint MENDED = 1u;
const uint KEPT = 2u;     // mended, and the rest of its light added to the result

// Whether what surrounds a pixel is noisy.
bool is_noisy_around(uvec2 at) {
    uvec2 last = uvec2(tiles_x - 1u, (height - 1u) / 8u);
    uvec2 first = max(at / 8u, uvec2(1u)) - 1u;
    uvec2 end = min(at / 8u + 1u, last);
    uint sum = 0u;
    for (uint y = first.y; y <= end.y; ++y) {
        for (uint x = first.x; x <= end.x; ++x) sum += tile_stats.v[(y * tiles_x + x) * TILE_WORDS + 3u];
    }
    uint lit = sum & 0xffffu;
    return (lit >= ENOUGH_LIT ? float(sum >> 16) / float(lit) : stats.noise) > NOISY_SHARE;
}

bool keeps_fireflies(uvec2 at) {
    if ((flags & (FLAG_MEND_FIREFLIES | FLAG_KEEP_FIREFLIES)) != 0u) return (flags & FLAG_KEEP_FIREFLIES) != 0u;
    return !is_noisy_around(at);
}

uint way_of(uvec2 at, vec3 color) {
    float light = brightness(color);
    bool mends = (flags & FLAG_MEND_FIREFLIES) != 0u;
    if (light <= (mends ? FIREFLY_KEYS : KEPT_KEYS) * stats.key || any(are_infinite(color))) return AS_IT_IS;
    bool keeps = keeps_fireflies(at);
    if (!keeps && light <= FIREFLY_KEYS * stats.key) return AS_IT_IS;
    vec2 neighbours = brightest_around(at);
    if (is_absurd(light, stats.key, neighbours)) return MENDED;
    if (keeps) return light > KEPT_RATIO * neighbours.y ? KEPT : AS_IT_IS;
    return is_firefly(light, stats.key, neighbours) ? MENDED : AS_IT_IS;
}

// The exposed mean, by channel, of the nearest ring of pixels that has good samples; far from all, that of the nearest
// tiles.
vec3 mended(uvec2 at) {
    vec3 mean = vec3(0.0);
    bvec3 found = bvec3(false);
    for (uint reach = 1u; reach <= MEND_REACH; ++reach) {
        vec3 sum = vec3(0.0);
        vec3 count = vec3(0.0);
        uvec4 box = around(at, reach);
        for (uint y = box.y; y <= box.w; ++y) {
            for (uint x = box.x; x <= box.z; ++x) {
                uvec2 away = uvec2(abs(ivec2(x, y) - ivec2(at)));
                if (max(away.x, away.y) != reach) continue;
                vec3 color = read_color(uvec2(x, y));
                if (way_of(uvec2(x, y), color) != AS_IT_IS) continue;
                sum += light_of(color) * stats.exposure;       // exposed: many large values may exceed a float
                count += vec3(are_finite(color));
            }
        }
        bvec3 has = greaterThan(count, vec3(0.0));
        mean = mix(mean, sum / max(count, 1.0), bvec3(uvec3(has) & ~uvec3(found)));
        found = bvec3(uvec3(found) | uvec3(has));
        if (all(found)) return mean;
    }
    uint tile = (at.y / 8u * tiles_x + at.x / 8u) * TILE_WORDS;
    for (uint i = 0u; i < 3u; ++i) {
        uint bits = tile_stats.v[tile + i];
        if (!found[i] && bits != NO_SAMPLE) mean[i] = uintBitsToFloat(bits) * stats.exposure;
    }
    return mean;
}

// What +Inf counts for, exposed: one pixel or two take the brightest sample around; more are a lamp, as bright as
// anything in the frame.
float infinite_light(uvec2 at, out bool lamp) {
    float largest = 0.0;
    uint others = 0u;
    bool finite = false;
    uvec4 box = around(at, 1u);
    for (uint y = box.y; y <= box.w; ++y) {
        for (uint x = box.x; x <= box.z; ++x) {
            vec3 color = read_color(uvec2(x, y));
            bool self = uvec2(x, y) == at;
            if (any(are_infinite(color)) && !self) ++others;
            if (way_of(uvec2(x, y), color) != AS_IT_IS) continue;
            if (any(are_finite(color))) finite = true;
            largest = max(largest, largest_of(light_of(color)));
        }
    }
    lamp = others >= 2u || !finite;
    if (lamp) largest = max(stats.largest[0], max(stats.largest[1], stats.largest[2]));
    return min(largest * stats.exposure, MAX_FLOAT);
}
