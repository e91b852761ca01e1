// Where maps live: rows of channels, channels last, four to a vector, behind device addresses.
// STORAGE_F16 makes the activations halves; the arithmetic stays in 32-bit floats. WIDE_ACCESS moves two floats at a time,
// for CPU drivers that turn a vector load into a loop over lanes and components.
#extension GL_EXT_buffer_reference : require
#ifdef STORAGE_F16
#extension GL_EXT_shader_16bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
layout(buffer_reference, std430, buffer_reference_align = 8) readonly buffer Source { f16vec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 8) writeonly buffer Target { f16vec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 2) writeonly buffer TargetScalars { float16_t v[]; };
#define STORE(target, index, value) target.v[index] = f16vec4(value)
#define STORE_SCALAR(target, index, value) target.v[index] = float16_t(value)
#elif defined(WIDE_ACCESS)
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Source { u64vec2 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Target { u64vec2 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) writeonly buffer TargetScalars { float v[]; };
vec4 widen(u64vec2 pair) {
    return vec4(uintBitsToFloat(unpackUint2x32(pair.x)), uintBitsToFloat(unpackUint2x32(pair.y)));
}
u64vec2 narrow(vec4 value) {
    return u64vec2(packUint2x32(floatBitsToUint(value.xy)), packUint2x32(floatBitsToUint(value.zw)));
}
#define STORE(target, index, value) target.v[index] = narrow(value)
#define STORE_SCALAR(target, index, value) target.v[index] = (value)
#define LOAD(source, index) widen(source.v[index])
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Weights { u64vec2 v[]; };
#define LOAD_WEIGHTS(weights, index) widen(weights.v[index])
#else
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Source { vec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Target { vec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) writeonly buffer TargetScalars { float v[]; };
#define STORE(target, index, value) target.v[index] = (value)
#define STORE_SCALAR(target, index, value) target.v[index] = (value)
#endif
#ifndef WIDE_ACCESS
#define LOAD(source, index) vec4(source.v[index])

// Weights and statistics are always 32-bit.
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Weights { vec4 v[]; };
#define LOAD_WEIGHTS(weights, index) weights.v[index]
#endif
layout(buffer_reference, std430, buffer_reference_align = 4) readonly buffer ReadFloats { float v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Floats { float v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Uints { uint v[]; };
