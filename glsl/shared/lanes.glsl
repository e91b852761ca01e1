// Eight lanes of a subgroup load different vectors and hand them round, for drivers on which a load costs more than the
// arithmetic it feeds (CPU drivers: a load is one scalar load a lane). Of larger subgroups the others load the same.
//
// BROADCAST: subgroupBroadcast is one instruction where its lane is constant; without it, subgroupShuffle is, and
// subgroupBroadcast may look for an active lane in a loop.
#ifndef LANES_GLSL
#define LANES_GLSL
#ifdef BROADCAST
#extension GL_KHR_shader_subgroup_ballot : require
#define FROM_LANE(value, lane) subgroupBroadcast(value, lane)
#else
#extension GL_KHR_shader_subgroup_shuffle : require
#define FROM_LANE(value, lane) subgroupShuffle(value, lane)
#endif

const int SHARING = 8;
// Number of this lane among those that share.
#define LANE (gl_SubgroupInvocationID & uint(SHARING - 1))
// Of `count` vectors a lane loads PER_LANE(count), which are neighbours, from SHARED_FIRST(count) on.
#define PER_LANE(count) (((count) + SHARING - 1) / SHARING)
#define SHARED_FIRST(count) (min(LANE, uint((count) / PER_LANE(count) - 1)) * PER_LANE(count))
#define SHARED(vectors, count, j) FROM_LANE(vectors[(j) % PER_LANE(count)], uint((j) / PER_LANE(count)))
#endif
