// Work is cut into tiles of 8x8 tokens, the attention window: one size for every kernel of a resolution, so that one
// list of active tiles serves them all: its length, then for each tile x | y << 16, in tiles. Without a list the tiles
// are those of a rectangle, whose columns are the upper half of the flags; it begins at any half tile, x | y << 16.
layout(buffer_reference, std430, buffer_reference_align = 4) readonly buffer TileList { uint v[]; };

const uint FLAG_TILE_LIST = 1u;

// How many tiles there are, of which the host knows `count`: with a list, its capacity.
uint tiles_of(uint count, uint flags, TileList list) {
    return (flags & FLAG_TILE_LIST) != 0u ? list.v[0] : count;
}

// The first token of a tile.
uvec2 tile_origin(uint slot, uint first, uint flags, TileList list) {
    if ((flags & FLAG_TILE_LIST) != 0u) {
        uint packed_tile = list.v[1u + slot];
        return uvec2(packed_tile & 0xffffu, packed_tile >> 16) * 8u;
    }
    uint columns = flags >> 16;
    return uvec2(first & 0xffffu, first >> 16) * 4u + uvec2(slot % columns, slot / columns) * 8u;
}

// Vulkan guarantees 65535 groups in x only; the rest goes to z.
uint group_index() {
    return gl_WorkGroupID.z * gl_NumWorkGroups.x + gl_WorkGroupID.x;
}

// Lanes without a tile leave at once; where those of a subgroup share what they load, as soon as none of them has one.
#ifdef LANES_SHARE
#extension GL_KHR_shader_subgroup_vote : require
#define LEAVE_UNLESS(live) if (!subgroupAny(live)) return;
#else
#define LEAVE_UNLESS(live) if (!live) return;
#endif
