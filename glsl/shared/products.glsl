// Products of a row of inputs with weights, four outputs at a time, and where the weights of predicted kernels lie:
// [biases of what is predicted from, by phase | the reliability's row | biases of the outputs | the former's, by phase
// | the latter's], rows of four outputs an input.
#ifdef LANES_SHARE
#include "shared/lanes.glsl"
#endif

const int HIDDEN = 8;                          // vectors of four
const uint ROW_AT = 4u * HIDDEN;
const uint BIASES_AT = ROW_AT + HIDDEN;
const uint RELIABILITY_AT = BIASES_AT + 6u;    // the reliability's bias is the second there
const uint HIDDEN_AT = BIASES_AT + 12u;
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
