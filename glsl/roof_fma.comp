// As many multiply-adds as the device can do: CHAINS independent ones an invocation, all in registers, written as the
// kernels write theirs.
#version 460
#extension GL_EXT_control_flow_attributes : require
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#ifdef HALF
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#define REAL f16vec2
#else
#define REAL float
#endif

layout(local_size_x = 64) in;

layout(push_constant) uniform Push {
    Floats dst;
    uint rounds;
    float factor;
};

// Latency times width of a core, within 16 vector registers.
const int CHAINS = 12;

void main() {
    uint index = group_index() * 64u + gl_LocalInvocationID.x;
    REAL sums[CHAINS];
    [[unroll]] for (int i = 0; i < CHAINS; ++i) sums[i] = REAL(float(index + i) * 1e-3);
    REAL scale = REAL(factor);
    REAL shift = REAL(1.0 - factor);
    for (uint round = 0u; round < rounds; ++round) {
        [[unroll]] for (int repeat = 0; repeat < 4; ++repeat) {
            [[unroll]] for (int i = 0; i < CHAINS; ++i) sums[i] = sums[i] * scale + shift;
        }
    }
    REAL sum = REAL(0.0);
    [[unroll]] for (int i = 0; i < CHAINS; ++i) sum += sums[i];
#ifdef HALF
    dst.v[index] = float(sum.x + sum.y);
#else
    dst.v[index] = sum;
#endif
}
