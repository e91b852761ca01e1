// The inner product all dense kernels share: an invocation holds PIXELS x 4*NV outputs in registers and adds four input
// channels at a time. Weights are packed as [output tile][tap][input channel / 4][4 input channels][PACKED_NV], vectors
// of four consecutive outputs, of which the first NV are computed; PACKED_NV is NV if nothing is said.
//
// LANES_SHARE: the lanes of a subgroup load a part of the block each and hand it round.
#extension GL_EXT_control_flow_attributes : require
#ifdef LANES_SHARE
#include "shared/lanes.glsl"
#endif

#ifndef PACKED_NV
#define PACKED_NV NV
#endif
const int BLOCK = 4 * PACKED_NV;      // vectors of weights for four input channels

vec4 accumulators[PIXELS * NV];

// Sets every output to its bias, the first vectors of the weights.
void clear_accumulators(Weights weights, uint tile_n) {
    [[unroll]] for (int n = 0; n < NV; ++n) {
        vec4 b = LOAD_WEIGHTS(weights, tile_n * NV + n);
        [[unroll]] for (int p = 0; p < PIXELS; ++p) accumulators[p * NV + n] = b;
    }
}

#ifdef LANES_SHARE
vec4 lane_weights[PER_LANE(4 * NV)];

void fetch_weights(Weights weights, uint base) {
    // All of a lane's are of one input channel.
    uint first = SHARED_FIRST(4 * NV);
    uint from = base + first / NV * PACKED_NV + first % NV;
    [[unroll]] for (int i = 0; i < PER_LANE(4 * NV); ++i) lane_weights[i] = LOAD_WEIGHTS(weights, from + i);
}
#define WEIGHT(weights, base, k, n) SHARED(lane_weights, 4 * NV, (k) * NV + (n))
#else
#define fetch_weights(weights, base)
#define WEIGHT(weights, base, k, n) LOAD_WEIGHTS(weights, (base) + (k) * PACKED_NV + (n))
#endif

// accumulators += activations (PIXELS vectors of four input channels) x the block of weights at `base`.
#define MULTIPLY_ADD(weights, base, activation) \
    fetch_weights(weights, base); \
    [[unroll]] for (int n = 0; n < NV; ++n) { \
        vec4 w0 = WEIGHT(weights, base, 0, n); \
        vec4 w1 = WEIGHT(weights, base, 1, n); \
        vec4 w2 = WEIGHT(weights, base, 2, n); \
        vec4 w3 = WEIGHT(weights, base, 3, n); \
        [[unroll]] for (int p = 0; p < PIXELS; ++p) { \
            vec4 a = activation(p); \
            accumulators[p * NV + n] += a.x * w0 + a.y * w1 + a.z * w2 + a.w * w3; \
        } \
    }
