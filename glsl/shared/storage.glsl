// Where maps live: rows of channels, channels last, four to a vector, behind device addresses.
// STORAGE_F16 makes the activations halves; the arithmetic stays in 32-bit floats.
//
// TEXELS is for CPU drivers, some of which turn every load and store by address into a loop over lanes and components:
// loads go through texel buffers, which they fetch as whole vectors and transpose, and stores move two floats at a time.
// A kernel names what it loads with TEXELS_OF; LOAD and LOAD_WEIGHTS take those names.
#extension GL_EXT_buffer_reference : require
#ifdef STORAGE_F16
#extension GL_EXT_shader_16bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
layout(buffer_reference, std430, buffer_reference_align = 8) readonly buffer Source { f16vec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 8) writeonly buffer Target { f16vec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 2) writeonly buffer TargetScalars { float16_t v[]; };
#define STORE(target, index, value) target.v[index] = f16vec4(value)
#define STORE_SCALAR(target, index, value) target.v[index] = float16_t(value)
#elif defined(TEXELS)
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Source { vec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Target { u64vec2 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) writeonly buffer TargetScalars { float v[]; };
u64vec2 narrow(vec4 value) {
    return u64vec2(packUint2x32(floatBitsToUint(value.xy)), packUint2x32(floatBitsToUint(value.zw)));
}
#define STORE(target, index, value) target.v[index] = narrow(value)
#define STORE_SCALAR(target, index, value) target.v[index] = (value)
#else
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Source { vec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Target { vec4 v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) writeonly buffer TargetScalars { float v[]; };
#define STORE(target, index, value) target.v[index] = (value)
#define STORE_SCALAR(target, index, value) target.v[index] = (value)
#endif
// Weights and statistics are always 32-bit.
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Weights { vec4 v[]; };
#ifdef TEXELS
#define TEXELS_OF(slot, name) layout(set = 0, binding = slot) uniform samplerBuffer name##_texels;
#define LOAD(source, index) texelFetch(source##_texels, int(index))
#define LOAD_WEIGHTS(weights, index) texelFetch(weights##_texels, int(index))
#else
#define TEXELS_OF(slot, name)
#define LOAD(source, index) vec4(source.v[index])
#define LOAD_WEIGHTS(weights, index) weights.v[index]
#endif
layout(buffer_reference, std430, buffer_reference_align = 4) readonly buffer ReadFloats { float v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Floats { float v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Uints { uint v[]; };
