// Norms of tokens whose channels several invocations of a subgroup share, side by side. A kernel defines before it
// includes this NORMED_VECTORS, vectors of eight channels, a power of two.
#extension GL_KHR_shader_subgroup_shuffle : require
#include "shared/norm.glsl"

const uint NORM_SHARE = NORMED_VECTORS < 4u ? NORMED_VECTORS : 4u; // invocations that share a token

// The sum over the invocations that share a token, the same bits in each.
vec4 norm_sum(vec4 sum) {
    if (NORM_SHARE > 1u) sum += subgroupShuffleXor(sum, 1u);
    if (NORM_SHARE > 2u) sum += subgroupShuffleXor(sum, 2u);
    return sum;
}
