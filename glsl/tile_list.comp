// The active tiles of one resolution, row by row, the others that are read, and the workgroups of the kernels that run
// over either list. One workgroup; positions come from sums in a fixed order.
#version 460
#include "shared/storage.glsl"
#include "shared/converged.glsl"

layout(local_size_x = 256) in;

layout(push_constant) uniform Push {
    Uints sums;           // of the map
    Uints list;           // length, then x | y << 16
    Uints idle;           // the same
    Uints groups;         // x, y, z by tiles a group (1, 2, 4, 8, 16) and by y; last for the idle
    Uints counts;
    // How far a tile looks on the map, by its place among eight squares, for being active and for being read: back | on
    // << 8 | back << 16 | on << 24.
    uint reach_0;
    uint reach_1;
    uint reach_2;
    uint reach_3;
    uint reach_4;
    uint reach_5;
    uint reach_6;
    uint reach_7;
    uint map_columns;
    uint map_rows;
    uint columns;
    uint rows;
    uint tile_pixels;     // a side
    uint max_y;
    uint slot;            // of the counts
    uint pitch;           // of the sample, whose squares are looked at like denoised ones; 0: none
    uint skew;
    uint real_columns;    // squares beyond these are not sampled
    uint real_rows;
    uint unused;
};

const uint MAX_GROUPS_X = 65535u;
const uint GROUP_SIZES = 5u;

shared uint positions[256];

uint sum_to(uint x, uint y) {
    return sums.v[y * (map_columns + 1u) + x];
}

const uint ACTIVE = 0u;
const uint READ = 16u;
const uint FAR = 255u;            // as far as the map goes

// The squares of the map that a row or column of tiles looks at, the end excluded.
uvec2 seen(uint tile, uint end, uint shift) {
    uint table[8] = uint[8](reach_0, reach_1, reach_2, reach_3, reach_4, reach_5, reach_6, reach_7);
    uint start = tile * tile_pixels / MAP_TILE;
    uint reach = table[start % 8u] >> shift;
    uint back = reach & 0xffu;
    uint on = reach >> 8 & 0xffu;
    return uvec2(back == FAR ? 0u : start - min(start, back), on == FAR ? end : min(start + on + 1u, end));
}

bool has_sample(uvec2 across, uvec2 down) {
    for (uint y = down.x; y < min(down.y, real_rows); ++y) {
        uint first = across.x + skew * y;
        uint next = (first + pitch - 1u) / pitch * pitch;
        if (across.x + next - first < min(across.y, real_columns)) return true;
    }
    return false;
}

bool sees(uint x, uint y, uint shift) {
    uvec2 across = seen(x, map_columns, shift);
    uvec2 down = seen(y, map_rows, shift);
    if (across.x >= across.y || down.x >= down.y) return false;
    if (sum_to(across.y, down.y) + sum_to(across.x, down.x) != sum_to(across.x, down.y) + sum_to(across.y, down.x)) {
        return true;
    }
    return pitch > 0u && has_sample(across, down);
}

void write_groups(uint entry, uint x, uint y) {
    uint z = max((x + MAX_GROUPS_X - 1u) / MAX_GROUPS_X, 1u);
    groups.v[3u * entry] = (x + z - 1u) / z;
    groups.v[3u * entry + 1u] = y;
    groups.v[3u * entry + 2u] = z;
}

void main() {
    uint lane = gl_LocalInvocationID.x;
    uint active_count = 0u;
    uint idle_count = 0u;
    for (uint first = 0u; first < columns * rows; first += 256u) {
        uint tile = first + lane;
        uint x = tile % columns;
        uint y = tile / columns;
        bool live = tile < columns * rows && sees(x, y, ACTIVE);
        bool idle_read = tile < columns * rows && !live && sees(x, y, READ);
        // Both counts at once.
        positions[lane] = (live ? 1u : 0u) | (idle_read ? 1u << 16 : 0u);
        barrier();
        for (uint step = 1u; step < 256u; step *= 2u) {
            uint before = lane >= step ? positions[lane - step] : 0u;
            barrier();
            positions[lane] += before;
            barrier();
        }
        uint position = positions[lane];
        uint total = positions[255];
        if (live) list.v[active_count + (position & 0xffffu)] = x | y << 16;
        if (idle_read) idle.v[idle_count + (position >> 16)] = x | y << 16;
        active_count += total & 0xffffu;
        idle_count += total >> 16;
        barrier();
    }
    if (lane == 0u) {
        list.v[0] = active_count;
        idle.v[0] = idle_count;
        counts.v[slot] = active_count;
        write_groups(GROUP_SIZES * max_y, idle_count, 1u);
    }
    for (uint i = lane; i < GROUP_SIZES * max_y; i += 256u) {
        uint tiles_a_group = 1u << (i / max_y);
        write_groups(i, (active_count + tiles_a_group - 1u) / tiles_a_group, i % max_y + 1u);
    }
}
