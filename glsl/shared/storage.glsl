// Where maps live: rows of channels, channels last, four to a vector, behind device addresses.
// SRC_F16 and DST_F16 make the elements of sources and targets halves; the arithmetic stays in 32-bit floats.
//
// TEXELS is for CPU drivers, some of which turn every load and store by address into a loop over lanes and components:
// loads go through texel buffers, which they fetch as whole vectors and transpose, and stores move eight bytes at a
// time. A kernel names what it loads with TEXELS_OF; LOAD and LOAD_WEIGHTS take those names.
#extension GL_EXT_buffer_reference : require
vec4 widen(vec4 value) {
    return value;
}
// Four halves.
vec4 widen(uvec2 value) {
    return vec4(unpackHalf2x16(value.x), unpackHalf2x16(value.y));
}
#ifdef SRC_F16
layout(buffer_reference, std430, buffer_reference_align = 8) readonly buffer Source { uvec2 v[]; };
#else
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Source { vec4 v[]; };
#endif
// Residual: a map that is stored as the target is, and read.
#ifdef DST_F16
#extension GL_EXT_shader_16bit_storage : require
layout(buffer_reference, std430, buffer_reference_align = 8) readonly buffer Residual { uvec2 v[]; };
#ifdef TEXELS
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
layout(buffer_reference, std430, buffer_reference_align = 2) writeonly buffer TargetScalars { uint16_t v[]; };
#define STORE_COMPONENT(target, index, component, value) \
    TargetScalars(target).v[(index) * 4u + (component)] = uint16_t(half_bits(vec4(value)).x)
// As packHalf2x16 rounds: to the nearest, ties to even, infinity from 65520 on. lavapipe takes 90 instructions and
// branches for eight numbers, where the CPU has one; this takes 16.
uvec4 half_bits(vec4 value) {
    uvec4 bits = floatBitsToUint(value);
    uvec4 magnitude = bits & 0x7fffffffu;
    uvec4 bounded = min(magnitude, uvec4(floatBitsToUint(65536.0)));
    // 112: between the exponents' biases. Half of the last place less one, and one more where the place before is odd.
    uvec4 normal = (bounded - (112u << 23) + 0xfffu + (bounded >> 13 & 1u)) >> 13;
    // Beside 0.5 the last place of a float is that of a subnormal half.
    uvec4 subnormal = floatBitsToUint(uintBitsToFloat(magnitude) + 0.5) - floatBitsToUint(0.5);
    uvec4 rounded = mix(normal, subnormal, lessThan(magnitude, uvec4(113u << 23)));
    rounded = mix(rounded, uvec4(0x7e00u), greaterThan(magnitude, uvec4(0x7f800000u)));
    return rounded | (bits >> 16 & 0x8000u);
}
uvec2 narrow(vec4 value) {
    uvec4 halves = half_bits(value);
    return halves.xz | halves.yw << 16;
}
layout(buffer_reference, std430, buffer_reference_align = 8) writeonly buffer Target { uint64_t v[]; };
#define STORE(target, index, value) target.v[index] = packUint2x32(narrow(value))
#else
layout(buffer_reference, std430, buffer_reference_align = 2) writeonly buffer TargetScalars { float16_t v[]; };
#define STORE_COMPONENT(target, index, component, value) \
    TargetScalars(target).v[(index) * 4u + (component)] = float16_t(value)
uvec2 narrow(vec4 value) {
    return uvec2(packHalf2x16(value.xy), packHalf2x16(value.zw));
}
layout(buffer_reference, std430, buffer_reference_align = 8) writeonly buffer Target { uvec2 v[]; };
#define STORE(target, index, value) target.v[index] = narrow(value)
#endif
#else
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Residual { vec4 v[]; };
#ifdef TEXELS
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
layout(buffer_reference, std430, buffer_reference_align = 4) writeonly buffer TargetScalars { float v[]; };
#define STORE_COMPONENT(target, index, component, value) \
    TargetScalars(target).v[(index) * 4u + (component)] = (value)
layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Target { u64vec2 v[]; };
u64vec2 narrow(vec4 value) {
    return u64vec2(packUint2x32(floatBitsToUint(value.xy)), packUint2x32(floatBitsToUint(value.zw)));
}
#define STORE(target, index, value) target.v[index] = narrow(value)
#else
layout(buffer_reference, std430, buffer_reference_align = 16) writeonly buffer Target { vec4 v[]; };
// Not by a reference of another type: SwiftShader's compiler overruns its stack over a store through one made from
// Target.
#define STORE_COMPONENT(target, index, component, value) target.v[index][component] = (value)
#define STORE(target, index, value) target.v[index] = (value)
#endif
#endif
// Weights and statistics are always 32-bit.
layout(buffer_reference, std430, buffer_reference_align = 16) readonly buffer Weights { vec4 v[]; };
#ifdef TEXELS
#define TEXELS_OF(slot, name) layout(set = 0, binding = slot) uniform samplerBuffer name##_texels;
#define LOAD(source, index) texelFetch(source##_texels, int(index))
#define LOAD_WEIGHTS(weights, index) texelFetch(weights##_texels, int(index))
#else
#define TEXELS_OF(slot, name)
#define LOAD(source, index) widen(source.v[index])
#define LOAD_WEIGHTS(weights, index) weights.v[index]
#endif
// A load that may be made in any case, zeros where it does not count. No branch: on CPU drivers a branch by lanes costs
// more than the load.
#define LOAD_WHERE(counts, source, index) mix(vec4(0.0), LOAD(source, index), bvec4(counts))
layout(buffer_reference, std430, buffer_reference_align = 4) readonly buffer ReadFloats { float v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Floats { float v[]; };
layout(buffer_reference, std430, buffer_reference_align = 4) buffer Uints { uint v[]; };
