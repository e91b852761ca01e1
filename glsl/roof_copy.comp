// A buffer copied, four vectors of four an invocation.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Source src;
    Target dst;
};

void main() {
    uint first = group_index() * 256u + gl_LocalInvocationID.x;
    [[unroll]] for (uint i = 0u; i < 4u; ++i) STORE(dst, first + i * 64u, LOAD(src, first + i * 64u));
}
