// Key, exposure, noise and largest samples of the frame from its tiles, and the means of tiles that have none from
// those around. One workgroup, fixed order.
#version 460
#include "shared/storage.glsl"
#include "shared/planes.glsl"
#include "shared/stats.glsl"

layout(local_size_x = 256) in;

layout(buffer_reference, std430, buffer_reference_align = 4) coherent buffer TileStats { uint v[]; };

layout(push_constant) uniform Push {
    Planes planes;
    ReadFloats runs;
    TileStats tile_stats;
    Stats stats;
    ReadFloats depth_scale;   // where there is depth
    ReadFloats given;         // with FLAG_GIVEN: the exposure
    Floats told;              // with FLAG_TOLD
    uint run_count;
    uint tiles_x;
    uint tile_count;
    float fixed_exposure;     // 0: the frame's own
    uint flags;
    uint unused;
};

const uint FLAG_GIVEN = 1u;
const uint FLAG_TOLD = 2u;

const float MIDDLE_GREY = 0.18;
// Keys whose exposure and reciprocal are still finite, normal floats.
const float MIN_KEY = 1e-30;
const float MAX_KEY = 1e36;
// A mean that was found in this round: others do not see it yet.
const uint NEW = 0x80000000u;

shared float sums[256];
shared uvec4 counts[256];     // tiles with light, noisy pixels, lit ones, tiles with gaps
shared vec3 largest[256];
shared uint found;

bool is_normal(float x) {
    uint bits = floatBitsToUint(x);
    return bits >= 0x00800000u && bits < 0x7f800000u;
}

// The mean of the tiles around that have one.
uint mean_around(uint tile, uint channel) {
    uvec2 at = uvec2(tile % tiles_x, tile / tiles_x);
    uvec2 last = min(at + 1u, uvec2(tiles_x, tile_count / tiles_x) - 1u);
    float sum = 0.0;
    float count = 0.0;
    for (uint y = max(at.y, 1u) - 1u; y <= last.y; ++y) {
        for (uint x = max(at.x, 1u) - 1u; x <= last.x; ++x) {
            uint bits = tile_stats.v[(y * tiles_x + x) * TILE_WORDS + channel];
            if ((bits & NEW) != 0u) continue;
            sum += uintBitsToFloat(bits) / 8.0;
            count += 1.0;
        }
    }
    return count > 0.0 ? floatBitsToUint(sum * (8.0 / count)) : NO_SAMPLE;
}

// From the tiles that have means outwards, ring by ring.
void fill_gaps(uint lane) {
    for (;;) {
        if (lane == 0u) found = 0u;
        barrier();
        for (uint i = lane; i < 3u * tile_count; i += 256u) {
            uint word = i / 3u * TILE_WORDS + i % 3u;
            if (tile_stats.v[word] != NO_SAMPLE) continue;
            uint bits = mean_around(i / 3u, i % 3u);
            if (bits == NO_SAMPLE) continue;
            tile_stats.v[word] = bits | NEW;
            atomicOr(found, 1u);
        }
        memoryBarrierBuffer();
        barrier();
        bool more = found != 0u;
        for (uint i = lane; i < 3u * tile_count; i += 256u) {
            uint word = i / 3u * TILE_WORDS + i % 3u;
            uint bits = tile_stats.v[word];
            if (bits != NO_SAMPLE && (bits & NEW) != 0u) tile_stats.v[word] = bits & ~NEW;
        }
        memoryBarrierBuffer();
        barrier();
        if (!more) return;
    }
}

void main() {
    uint lane = gl_LocalInvocationID.x;
    float sum = 0.0;
    uvec4 count = uvec4(0u);
    vec3 most = vec3(0.0);
    for (uint i = lane; i < run_count; i += 256u) {
        uint at = i * RUN_FLOATS;
        sum += runs.v[at];
        count += uvec4(runs.v[at + 1u], runs.v[at + 2u], runs.v[at + 3u], runs.v[at + 7u]);
        most = max(most, vec3(runs.v[at + 4u], runs.v[at + 5u], runs.v[at + 6u]));
    }
    sums[lane] = sum;
    counts[lane] = count;
    largest[lane] = most;
    barrier();
    for (uint width = 128u; width > 0u; width /= 2u) {
        if (lane < width) {
            sums[lane] += sums[lane + width];
            counts[lane] += counts[lane + width];
            largest[lane] = max(largest[lane], largest[lane + width]);
        }
        barrier();
    }
    count = counts[0];
    if (lane == 0u) {
        float key = MIDDLE_GREY;
        if (count.x > 0u) key = clamp(stats.median * exp2(sums[0] / float(count.x)), MIN_KEY, MAX_KEY);
        float exposure = fixed_exposure > 0.0 ? fixed_exposure : MIDDLE_GREY / key;
        if ((flags & FLAG_GIVEN) != 0u && is_normal(given.v[0])) exposure = given.v[0];
        float noise = count.z > 0u ? float(count.y) / float(count.z) : 1.0;
        stats.key = key;
        stats.exposure = exposure;
        stats.noise = noise;
        for (uint i = 0u; i < 3u; ++i) stats.largest[i] = largest[0][i];
        if ((flags & FLAG_TOLD) != 0u) {
            told.v[0] = exposure;
            told.v[1] = is_present(planes.depth.format) ? depth_scale.v[0] : 0.0;
            told.v[2] = key;
            told.v[3] = noise;
        }
    }
    if (count.w > 0u) fill_gaps(lane);
}
