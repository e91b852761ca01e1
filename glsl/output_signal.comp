// A signal that went through the colour's kernels to the caller's plane, cropped to the frame: with what goes around
// the kernels, as the colour; where the colour's result is cut at the frame's largest sample, a part of the light is
// by the same factor. Where a map says what is converged, converged pixels are the caller's, but for a blend beside
// those that are not.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/stats.glsl"
#include "shared/target_plane.glsl"
#include "shared/planes.glsl"
#include "shared/converged.glsl"
#include "shared/energy.glsl"
#include "shared/signals.glsl"

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Weights filtered;
    Weights color;        // the colour's result
    Weights direct;       // what goes around the kernels, every second vector
    Stats stats;
    SignalPlanes signal;
    Uints map;            // with FLAG_CONVERGED
    TileList tiles;       // with FLAG_TILE_LIST
    Floats turned;        // with FLAG_TURNED and FLAG_UPRIGHT: the signal's channels for each pixel of the frame
    Weights gains;        // of the colour's result
    uint left;            // the pixels to write, ends excluded
    uint top;
    uint right;
    uint bottom;
    uint src_width;
    uint first_tile;      // x | y << 16, in half tiles
    uint tile_count;
    uint flags;
    float blend;
    uint width;           // of the frame
    uint height;
    uint pixels;
    uint gain_columns;
    uint unused;
};

#include "shared/read_signal.glsl"

const uint FLAG_CONVERGED = 16u;
#include "shared/converged_share.glsl"
#include "shared/ensemble.glsl"

void main() {
    uint slot = group_index();
    if (slot >= tiles_of(tile_count, flags, tiles)) return;
    uvec2 at = tile_origin(slot, first_tile, flags, tiles);
    at += uvec2(gl_LocalInvocationID.x % 8u, gl_LocalInvocationID.x / 8u);
    if (at.x < left || at.x >= right || at.y < top || at.y >= bottom) return;

    uint pixel = at.y * src_width + at.x;
    bool light = (flags & FLAG_LIGHT) != 0u;
    float converged = (flags & FLAG_CONVERGED) != 0u ? converged_share(at) : 0.0;
    vec3 result = vec3(0.0);
    if (converged < 1.0) {
        float inverse = light ? 1.0 / stats.exposure : 1.0;
        result = LOAD_WEIGHTS(filtered, pixel).xyz * inverse;
        if (light) {
            vec3 largest = vec3(stats.largest[0], stats.largest[1], stats.largest[2]);
            vec3 clean = min(max(LOAD_WEIGHTS(color, pixel).xyz, vec3(0.0)) * inverse, vec3(MAX_FLOAT));
            vec3 gain = energy_gain(gains, gain_columns, at, uvec2(width, height));
            vec3 factor = 1.0 + gain * energy_room(clean, largest);
            result *= factor;
            clean *= factor;
            for (int i = 0; i < 3; ++i) {
                if (clean[i] > largest[i]) result[i] *= largest[i] / clean[i];
            }
        }
        // Its last number tells the channels of which it is all.
        vec4 around = LOAD_WEIGHTS(direct, 2u * pixel + 1u);
        bvec3 alone = bvec3(uvec3(around.w) >> uvec3(0u, 1u, 2u) & 1u);
        result = mix((1.0 - blend) * result, vec3(0.0), alone) + around.xyz * inverse;
        result = clamp(result, -TARGET_MAX, TARGET_MAX);
    }
    if (converged > 0.0) {
        vec3 own = read_signal(at);
        own = mix(vec3(0.0), clamp(own, -TARGET_MAX, TARGET_MAX), are_finite(own));
        result = converged < 1.0 ? mix(result, own, converged) : own;
    }
    if ((flags & FLAG_ALPHA) != 0u) result = clamp(result, 0.0, 1.0);
    bool all_three = (flags & FLAG_SIGNAL_ONE) == 0u;
    if (is_averaged(at, all_three ? 3u : 1u, result)) store_target(signal.result, at, result, all_three);
}
