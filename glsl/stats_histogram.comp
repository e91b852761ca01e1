// A histogram of luminance (FLAG_COLOR) or depth (FLAG_DEPTH) by the upper bits of the float. Integer counts: any order
// gives the same bits.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/planes.glsl"
#include "shared/stats.glsl"

layout(local_size_x = 64) in;

#ifdef IMAGES
layout(set = 0, binding = 0) uniform texture2D color_image;
layout(set = 0, binding = 1) uniform texture2D depth_image;
#define PLANE Uints
#else
#define PLANE Plane
#endif

layout(push_constant) uniform Push {
    PLANE color;
    PLANE depth;
    Uints histogram;
    uint color_offset;
    uint color_pixel;
    uint color_row;
    uint color_channel;
    uint depth_offset;
    uint depth_pixel;
    uint depth_row;
    uint width;
    uint height;
    uint flags;
};

#include "shared/read_color.glsl"
#include "shared/read_depth.glsl"

void main() {
    uint index = group_index() * 64u + gl_LocalInvocationID.x;
    if (index >= width * height) return;
    uvec2 at = uvec2(index % width, index / width);
    if ((flags & FLAG_COLOR) != 0u) {
        vec3 radiance = read_color(at);
        float l = all(are_finite(radiance)) ? luminance(light_of(radiance)) : 0.0;
        if (l > 0.0) atomicAdd(histogram.v[floatBitsToUint(l) >> LUMINANCE_SHIFT], 1u);
    }
    if ((flags & FLAG_DEPTH) != 0u) {
        float d = read_depth(at);
        // Depths below the first bin are counted in it.
        uint bin = max(floatBitsToUint(d) >> DEPTH_SHIFT, DEPTH_FIRST) - DEPTH_FIRST;
        if (d > 0.0) atomicAdd(histogram.v[bin], 1u);
    }
}
