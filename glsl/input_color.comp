// Colour to the network's input: samples mended, exposed, log1p, padded by reflection. The fourth channel, which has no
// weights, tells what goes around the network: 0 nothing, else 1 and log1p of what samples that are not finite count
// for; negative in a lamp of +Inf, which is nothing else in the result either.
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
#endif

layout(push_constant) uniform Push {
    Planes planes;
    Stats stats;
    Uints tile_stats;
    Target dst;
    TileList tiles;       // with FLAG_TILE_LIST
    uint width;
    uint height;
    uint tiles_x;
    uint dst_width;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    uint unused;
};

#include "shared/read_color.glsl"
#include "shared/samples.glsl"
#include "shared/mend.glsl"

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 to = tile_origin(slot, first_tile, flags, tiles);
    to += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    uvec2 at = uvec2(reflect_index(to.x, width), reflect_index(to.y, height));

    vec3 color = read_color(at);
    vec3 exposed = light_of(color) * stats.exposure;
    bvec3 finite = are_finite(color);
    bvec3 infinite = are_infinite(color);
    uint way = way_of(at, color);
    bvec3 missing = way == AS_IT_IS ? bvec3(~(uvec3(finite) | uvec3(infinite)) & 1u) : bvec3(true);
    if (any(missing)) exposed = mix(exposed, mended(at), missing);
    bool lamp = false;
    if (any(infinite)) exposed = mix(exposed, vec3(infinite_light(at, lamp)), infinite);

    float beyond = 0.0;
    if (way == KEPT || lamp || (way == AS_IT_IS && largest_of(exposed) > RANGE)) {
        beyond = 1.0 + log1p(min(largest_of(mix(exposed, vec3(0.0), finite)), MAX_FLOAT));
        if (lamp) beyond = -beyond;
    }
    exposed = min(exposed, vec3(RANGE));
    STORE(dst, to.y * dst_width + to.x, vec4(log1p(exposed.x), log1p(exposed.y), log1p(exposed.z), beyond));
}
