// What every square of 64x64 pixels has to get back of the light that came in: one workgroup a square, four invocations
// for each of its columns. A square is a tile of tokens of 8x8 pixels.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/stats.glsl"
#include "shared/log_exp.glsl"
#include "shared/converged.glsl"
#include "shared/energy.glsl"
TEXELS_OF(0, result)
TEXELS_OF(1, log_color)

const uint LANES = 256u;
layout(local_size_x = LANES) in;

layout(push_constant) uniform Push {
    Source result;        // exposed radiance
    Source log_color;     // what the network was given, before the logarithm
    Target dst;
    Stats stats;
    TileList tiles;       // with FLAG_TILE_LIST
    Uints map;            // with FLAG_CONVERGED: pixels of converged squares do not count
    uint width;           // of the maps, in pixels
    uint frame_width;     // pixels that count
    uint frame_height;
    uint result_stride;   // strides in vectors of four
    uint log_color_stride;
    uint dst_width;
    uint dst_stride;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
};

const uint FLAG_CONVERGED = 16u;
const float BOUND = 0.125;
// More than 1, so that one pixel alone is never enough.
const float CAUTION = 1.5;

// By invocation: what is missing of the light, the square of it pixel by pixel, and the light that has room.
shared vec4 missing_of[LANES];
shared vec4 squares_of[LANES];
shared vec4 room_of[LANES];

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 block = tile_origin(slot, first_tile, flags, tiles) / 8u;
    uint lane = gl_LocalInvocationID.x;
    uint x = block.x * BLOCK + lane % BLOCK;
    float inverse = 1.0 / stats.exposure;
    vec3 largest = vec3(stats.largest[0], stats.largest[1], stats.largest[2]);
    vec3 missing = vec3(0.0);
    vec3 squares = vec3(0.0);
    vec3 room = vec3(0.0);
    uint end = min((block.y + 1u) * BLOCK, frame_height);
    if (x >= frame_width) end = 0u;
    for (uint y = block.y * BLOCK + lane / BLOCK; y < end; y += LANES / BLOCK) {
        if ((flags & FLAG_CONVERGED) != 0u && map.v[y / MAP_TILE * (width / MAP_TILE) + x / MAP_TILE] == 0u) continue;
        uint pixel = y * width + x;
        vec3 has = max(LOAD(result, pixel * result_stride).xyz, vec3(0.0));
        vec3 given = LOAD(log_color, pixel * log_color_stride).xyz;
        vec3 lacks = vec3(expm1(given.x), expm1(given.y), expm1(given.z)) - has;
        missing += lacks;
        squares += lacks * lacks;
        room += has * energy_room(has * inverse, largest);
    }
    missing_of[lane] = vec4(missing, 0.0);
    squares_of[lane] = vec4(squares, 0.0);
    room_of[lane] = vec4(room, 0.0);
    for (uint others = LANES / 2u; others > 0u; others /= 2u) {
        barrier();
        if (lane < others) {
            missing_of[lane] += missing_of[lane + others];
            squares_of[lane] += squares_of[lane + others];
            room_of[lane] += room_of[lane + others];
        }
    }
    if (lane > 0u) return;
    vec4 gains = vec4(0.0);
    for (int i = 0; i < 3; ++i) {
        float lacks = missing_of[0][i];
        float by_chance = CAUTION * squares_of[0][i];
        if (lacks * lacks > by_chance && room_of[0][i] > 0.0) {
            gains[i] = clamp((lacks - by_chance / lacks) / room_of[0][i], -BOUND, BOUND);
        }
    }
    STORE(dst, (block.y * dst_width + block.x) * dst_stride, gains);
}
