// Products of a row of inputs with weights, four outputs at a time. Those of predicted kernels have rows of four
// outputs an input.
#ifdef LANES_SHARE
#include "shared/lanes.glsl"
#endif

const uint OUTPUTS_AT = HIDDEN_AT + 4u * HIDDEN * 40u;

// value[p] += the products of `count` inputs of each of TX tokens, `input(p, k)` being the k-th, with the rows from
// `base` on.
#ifdef LANES_SHARE
#define ADD_PRODUCTS(value, input, count, base) { \
    vec4 lane_weights[PER_LANE(count)]; \
    [[unroll]] for (int i = 0; i < PER_LANE(count); ++i) { \
        lane_weights[i] = LOAD_WEIGHTS(weights, (base) + min(LANE + uint(i * SHARING), uint((count) - 1))); \
    } \
    [[unroll]] for (int k = 0; k < (count); ++k) { \
        vec4 w = FROM_LANE(lane_weights[k / SHARING], uint(k % SHARING)); \
        [[unroll]] for (int p = 0; p < TX; ++p) value[p] += input(p, k) * w; \
    } }
#else
#define ADD_PRODUCTS(value, input, count, base) \
    [[unroll]] for (int k = 0; k < (count); ++k) { \
        vec4 w = LOAD_WEIGHTS(weights, (base) + k); \
        [[unroll]] for (int p = 0; p < TX; ++p) value[p] += input(p, k) * w; \
    }
#endif
