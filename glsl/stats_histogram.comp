// A histogram of luminance or depth by the upper bits of the float. Integer counts: any order
// gives the same bits. A workgroup counts its pixels in shared memory, where they fall into the bins that pixels mostly
// fall into, and adds what it has counted: one atomic operation in memory for each pixel would wait for the others of
// its bin.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/planes.glsl"
#include "shared/stats.glsl"

layout(local_size_x = 256) in;

#ifdef IMAGES
layout(set = 0, binding = 0) uniform texture2D color_image;
layout(set = 0, binding = 1) uniform texture2D depth_image;
#endif

layout(push_constant) uniform Push {
    Planes planes;
    Uints histogram;
    uint width;
    uint height;
    uint of_depth;        // else of luminance
    uint unused;
};

#include "shared/read_color.glsl"
#include "shared/read_depth.glsl"

const uint LANES = 256u;
const uint PIXELS = 4096u;                      // of a workgroup: its counts fit 16 bits
const uint WINDOW = 8192u;                      // bins in shared memory
// Luminance from 2^-32 to 2^32, depth from 2^-8 to 2^8.
const uint LUMINANCE_WINDOW = (127u - 32u) << 7;
const uint DEPTH_WINDOW = ((127u - 8u) << 9) - DEPTH_FIRST;

shared uint counts[WINDOW / 2u];                // two bins each

void count(uint bin, uint first) {
    uint at = bin - first;
    if (at < WINDOW) atomicAdd(counts[at / 2u], (at & 1u) == 0u ? 1u : 1u << 16);
    else atomicAdd(histogram.v[bin], 1u);
}

void main() {
    uint lane = gl_LocalInvocationID.x;
    for (uint i = lane; i < WINDOW / 2u; i += LANES) counts[i] = 0u;
    barrier();
    uint window = of_depth == 0u ? LUMINANCE_WINDOW : DEPTH_WINDOW;
    uint end = min((group_index() + 1u) * PIXELS, width * height);
    for (uint index = group_index() * PIXELS + lane; index < end; index += LANES) {
        uvec2 at = uvec2(index % width, index / width);
        if (of_depth == 0u) {
            vec3 radiance = read_color(at);
            float l = all(are_finite(radiance)) ? luminance(light_of(radiance)) : 0.0;
            if (l > 0.0) count(floatBitsToUint(l) >> LUMINANCE_SHIFT, window);
        } else {
            float d = read_depth(at);
            // Depths below the first bin are counted in it.
            if (d > 0.0) count(max(floatBitsToUint(d) >> DEPTH_SHIFT, DEPTH_FIRST) - DEPTH_FIRST, window);
        }
    }
    barrier();
    for (uint i = lane; i < WINDOW / 2u; i += LANES) {
        uint pair = counts[i];
        if ((pair & 0xffffu) != 0u) atomicAdd(histogram.v[window + 2u * i], pair & 0xffffu);
        if (pair >> 16 != 0u) atomicAdd(histogram.v[window + 2u * i + 1u], pair >> 16);
    }
}
