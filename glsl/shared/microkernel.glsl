// The inner product all dense kernels share: an invocation holds PIXELS x 4*NV outputs in registers and adds four input
// channels at a time. Weights are packed as [output tile][tap][input channel / 4][4 input channels][NV], vectors of four
// consecutive outputs.
//
// WEIGHTS_SHARED: eight lanes load an eighth of the block each and hand it round. For drivers on which a load costs
// more than the arithmetic (CPU drivers: a load is one scalar load per lane).
#extension GL_EXT_control_flow_attributes : require
#ifdef WEIGHTS_SHARED
#extension GL_KHR_shader_subgroup_shuffle : require
#endif

const int BLOCK = 4 * NV;             // vectors of weights for four input channels

vec4 accumulators[PIXELS * NV];

// Sets every output to its bias, the first vectors of the weights.
void clear_accumulators(Weights weights, uint tile_n) {
    [[unroll]] for (int n = 0; n < NV; ++n) {
        vec4 b = LOAD_WEIGHTS(weights, tile_n * NV + n);
        [[unroll]] for (int p = 0; p < PIXELS; ++p) accumulators[p * NV + n] = b;
    }
}

#ifdef WEIGHTS_SHARED
// By subgroupShuffle, which is one instruction where its index is constant; subgroupBroadcast first looks for an active
// lane on some CPU drivers, in a loop.
const int PER_LANE = (BLOCK + 7) / 8;
vec4 lane_weights[PER_LANE];

void fetch_weights(Weights weights, uint base) {
    uint lane = gl_SubgroupInvocationID & (BLOCK / PER_LANE - 1);
    [[unroll]] for (int i = 0; i < PER_LANE; ++i) lane_weights[i] = LOAD_WEIGHTS(weights, base + lane * PER_LANE + i);
}
#define WEIGHT(weights, base, j) subgroupShuffle(lane_weights[(j) % PER_LANE], uint((j) / PER_LANE))
#else
#define fetch_weights(weights, base)
#define WEIGHT(weights, base, j) LOAD_WEIGHTS(weights, (base) + (j))
#endif

// accumulators += activations (PIXELS vectors of four input channels) x the block of weights at `base`.
#define MULTIPLY_ADD(weights, base, activation) \
    fetch_weights(weights, base); \
    [[unroll]] for (int n = 0; n < NV; ++n) { \
        vec4 w0 = WEIGHT(weights, base, n); \
        vec4 w1 = WEIGHT(weights, base, NV + n); \
        vec4 w2 = WEIGHT(weights, base, 2 * NV + n); \
        vec4 w3 = WEIGHT(weights, base, 3 * NV + n); \
        [[unroll]] for (int p = 0; p < PIXELS; ++p) { \
            vec4 a = activation(p); \
            accumulators[p * NV + n] += a.x * w0 + a.y * w1 + a.z * w2 + a.w * w3; \
        } \
    }
