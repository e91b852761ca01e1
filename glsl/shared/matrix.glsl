// Products of matrices of halves, summed in 32-bit floats, each by the invocations of one subgroup. Sizes are the
// device's. Which invocation holds which element is undefined: what is not the same for all elements goes through
// shared memory.
#extension GL_KHR_cooperative_matrix : require
#extension GL_KHR_memory_scope_semantics : require
#extension GL_KHR_shader_subgroup_basic : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#extension GL_EXT_control_flow_attributes : require

layout(constant_id = 0) const uint INVOCATIONS = 128;  // of a workgroup
layout(constant_id = 1) const uint ROWS = 16;
layout(constant_id = 2) const uint COLUMNS = 16;
layout(constant_id = 3) const uint DEPTH = 16;
layout(local_size_x_id = 0, local_size_y = 1, local_size_z = 1) in;

#ifndef SUBGROUPS
#define SUBGROUPS 4u                                   // of a workgroup
#endif
const uint LANES = INVOCATIONS / SUBGROUPS;

#define MatrixA coopmat<float16_t, gl_ScopeSubgroup, ROWS, DEPTH, gl_MatrixUseA>
#define MatrixB coopmat<float16_t, gl_ScopeSubgroup, DEPTH, COLUMNS, gl_MatrixUseB>
#define MatrixSum coopmat<float, gl_ScopeSubgroup, ROWS, COLUMNS, gl_MatrixUseAccumulator>
// Sums rounded to halves.
#define MatrixHalves coopmat<float16_t, gl_ScopeSubgroup, ROWS, COLUMNS, gl_MatrixUseAccumulator>

// Eight halves.
uvec4 pack_halves(vec4 low, vec4 high) {
    return uvec4(packHalf2x16(low.xy), packHalf2x16(low.zw), packHalf2x16(high.xy), packHalf2x16(high.zw));
}
void unpack_halves(uvec4 halves, out vec4 low, out vec4 high) {
    low = vec4(unpackHalf2x16(halves.x), unpackHalf2x16(halves.y));
    high = vec4(unpackHalf2x16(halves.z), unpackHalf2x16(halves.w));
}
