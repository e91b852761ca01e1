// As many products of matrices as the device can do: CHAINS independent sums a subgroup.
#version 460
#include "shared/storage.glsl"
#include "shared/tiles.glsl"
#include "shared/matrix.glsl"

layout(push_constant) uniform Push {
    Floats dst;
    uint rounds;
    float factor;
};

const int CHAINS = 8;

void main() {
    uint index = group_index() * SUBGROUPS + gl_SubgroupID;
    MatrixA a = MatrixA(float16_t(factor));
    MatrixB b = MatrixB(float16_t(1.0 - factor));
    MatrixSum sums[CHAINS];
    [[unroll]] for (int i = 0; i < CHAINS; ++i) sums[i] = MatrixSum(float(index + i) * 1e-3);
    for (uint round = 0u; round < rounds; ++round) {
        [[unroll]] for (int i = 0; i < CHAINS; ++i) sums[i] = coopMatMulAdd(a, b, sums[i]);
        // Compilers for CPUs take a product that stays the same out of the loop.
        b = -b;
    }
    MatrixSum sum = sums[0];
    [[unroll]] for (int i = 1; i < CHAINS; ++i) sum += sums[i];
    coopMatStore(sum, dst.v, index * ROWS * COLUMNS, COLUMNS, gl_CooperativeMatrixLayoutRowMajor);
}
