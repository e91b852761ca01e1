// Which squares of 16x16 pixels are to be denoised, and how many of them lie above and left of every corner, so that
// four loads tell whether there is one in a rectangle. One workgroup.
#version 460
#include "shared/storage.glsl"
#include "shared/planes.glsl"
#include "shared/converged.glsl"

layout(local_size_x = 256) in;

// Invocations read what others of the group wrote.
layout(buffer_reference, std430, buffer_reference_align = 4) coherent buffer Shared { uint v[]; };

layout(push_constant) uniform Push {
    ReadFloats src;       // relative noise
    Shared map;           // 1: to be denoised, 0: converged
    Shared sums;          // (columns + 1) x (rows + 1)
    Planes planes;
    uint columns;
    uint rows;
    uint left;            // the squares that are wanted, ends excluded
    uint top;
    uint right;
    uint bottom;
    float threshold;
    uint real_columns;    // squares beyond these are as the nearest of these
    uint real_rows;
    uint unused;
};

bool is_noisy(uint x, uint y) {
    return !(src.v[y * columns + x] <= threshold);
}

void main() {
    uint lane = gl_LocalInvocationID.x;
    // Whether the squares beside a noisy one are not converged.
    bool spread = (planes.noise.format & FORMAT_COUNTS) == 0u;
    for (uint i = lane; i < columns * rows; i += 256u) {
        uvec2 at = min(uvec2(i % columns, i / columns), uvec2(real_columns, real_rows) - 1u);
        bool noisy = is_noisy(at.x, at.y);
        if (spread) {
            uvec2 first = max(at, uvec2(1u)) - 1u;
            uvec2 last = min(at + 1u, uvec2(columns, rows) - 1u);
            for (uint y = first.y; y <= last.y; ++y) {
                for (uint x = first.x; x <= last.x; ++x) noisy = noisy || is_noisy(x, y);
            }
        }
        bool wanted = at.x >= left && at.x < right && at.y >= top && at.y < bottom;
        map.v[i] = noisy && wanted ? 1u : 0u;
    }
    memoryBarrierBuffer();
    barrier();
    for (uint y = lane; y <= rows; y += 256u) {
        uint sum = 0u;
        sums.v[y * (columns + 1u)] = 0u;
        for (uint x = 0u; x < columns; ++x) {
            if (y > 0u) sum += map.v[(y - 1u) * columns + x];
            sums.v[y * (columns + 1u) + x + 1u] = sum;
        }
    }
    memoryBarrierBuffer();
    barrier();
    for (uint x = lane; x <= columns; x += 256u) {
        uint sum = 0u;
        for (uint y = 0u; y <= rows; ++y) {
            sum += sums.v[y * (columns + 1u) + x];
            sums.v[y * (columns + 1u) + x] = sum;
        }
    }
}
