// Joint attention of one 8x8 window and one head on cooperative matrices, of what is staged as attention_sizes.glsl
// says: a subgroup computes as many queries as a matrix has rows. Scores, their product and the exponentials are 32-bit
// floats; queries, keys, values and probabilities are halves. Of the kernel's push constants it reads `bias`, for every
// head [query][key], and `scale`, 1 / sqrt(d).
#extension GL_KHR_shader_subgroup_shuffle : require

shared float inverse_sums[WINDOW];               // of exponentials, by query

// Scores of this subgroup's queries and a matrix of keys, the n-th, from the queries staged at `queries` and the keys
// behind them.
MatrixSum scores_of(uint queries, uint n) {
    MatrixSum sum = MatrixSum(0.0);
    [[unroll]] for (uint k = 0u; k < DEPTH_KEYS; k += DEPTH) {
        MatrixA rows;
        MatrixB columns;
        uint row = gl_SubgroupID * QUERIES;
        coopMatLoad(rows, staged, queries + row * KEY_STRIDE + k / 8u, KEY_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
        uint keys = queries + (WINDOW + n * COLUMNS) * KEY_STRIDE;
        coopMatLoad(columns, staged, keys + k / 8u, KEY_STRIDE, gl_CooperativeMatrixLayoutColumnMajor);
        sum = coopMatMulAdd(rows, columns, sum);
    }
    return sum;
}

// Invocations that share a row of scores.
const uint SHARE = LANES >= 64u ? 4u : LANES >= 32u ? 2u : 1u;
const uint EACH = WINDOW / 4u / SHARE;           // vectors of four scores

float share_max(float value) {
    if (SHARE > 1u) value = max(value, subgroupShuffleXor(value, 1u));
    if (SHARE > 2u) value = max(value, subgroupShuffleXor(value, 2u));
    return value;
}
float share_sum(float value) {
    if (SHARE > 1u) value += subgroupShuffleXor(value, 1u);
    if (SHARE > 2u) value += subgroupShuffleXor(value, 2u);
    return value;
}

// Where the rows of this subgroup's queries begin, once scores lie there.
uint own_scores = gl_SubgroupID * QUERIES * SCORE_STRIDE;

// From queries, keys and values to sums of values: those of this subgroup's queries lie as rows of 32-bit floats from
// `own_scores` on, to be multiplied by `inverse_sums`. Other subgroups may still read the values.
void attend(uint head) {
    MatrixSum scores[KEY_TILES];
    [[unroll]] for (uint n = 0u; n < KEY_TILES; ++n) {
        MatrixSum b;
        uint row = head * WINDOW + gl_SubgroupID * QUERIES;
        coopMatLoad(b, bias.v, row * WINDOW + n * COLUMNS, WINDOW, gl_CooperativeMatrixLayoutRowMajor);
        scores[n] = (scores_of(0u, n) * scale + b) * (scores_of(2u * WINDOW * KEY_STRIDE, n) * scale + b);
    }
    barrier();
    // From here on a subgroup works on its own rows alone.
    [[unroll]] for (uint n = 0u; n < KEY_TILES; ++n) {
        uint to = own_scores + n * COLUMNS / 4u;
        coopMatStore(scores[n], staged, to, SCORE_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
    }
    subgroupBarrier();

    // Softmax: SHARE invocations own a row; the order is fixed, so are the bits. The results are divided by the sum at
    // the end.
    uint part = gl_SubgroupInvocationID % SHARE * EACH;
    for (uint row = gl_SubgroupInvocationID / SHARE; row < QUERIES; row += LANES / SHARE) {
        uint from = own_scores + row * SCORE_STRIDE;
        vec4 e[EACH];
        vec4 top = vec4(-3.402823466e38);
        [[unroll]] for (uint i = 0u; i < EACH; ++i) {
            e[i] = uintBitsToFloat(staged[from + part + i]);
            top = max(top, e[i]);
        }
        float most = share_max(max(max(top.x, top.y), max(top.z, top.w)));
        vec4 sum = vec4(0.0);
        [[unroll]] for (uint i = 0u; i < EACH; ++i) {
            e[i] = exp(e[i] - most);
            sum += e[i];
        }
        float all = share_sum(sum.x + sum.y + sum.z + sum.w);
        // The others of the row have read it too: the shuffles waited for them.
        [[unroll]] for (uint i = 0u; i < EACH; i += 2u) {
            staged[from + (part + i) / 2u] = pack_halves(e[i], e[i + 1u]);
        }
        if (part == 0u) inverse_sums[gl_SubgroupID * QUERIES + row] = 1.0 / all;
    }
    subgroupBarrier();

    const uint VALUE_TILES = VALUES / COLUMNS;
    MatrixSum results[VALUE_TILES];
    [[unroll]] for (uint n = 0u; n < VALUE_TILES; ++n) results[n] = MatrixSum(0.0);
    [[unroll]] for (uint k = 0u; k < WINDOW; k += DEPTH) {
        MatrixA rows;
        coopMatLoad(rows, staged, own_scores + k / 8u, SCORE_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
        [[unroll]] for (uint n = 0u; n < VALUE_TILES; ++n) {
            MatrixB values;
            coopMatLoad(values, staged, VALUES_AT + k * VALUE_STRIDE + n * COLUMNS / 8u, VALUE_STRIDE,
                gl_CooperativeMatrixLayoutRowMajor);
            results[n] = coopMatMulAdd(rows, values, results[n]);
        }
    }
    subgroupBarrier();
    [[unroll]] for (uint n = 0u; n < VALUE_TILES; ++n) {
        uint to = own_scores + n * COLUMNS / 4u;
        coopMatStore(results[n], staged, to, SCORE_STRIDE, gl_CooperativeMatrixLayoutRowMajor);
    }
    subgroupBarrier();
}
