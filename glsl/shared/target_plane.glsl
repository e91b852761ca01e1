// The samples of the plane that a kernel writes: 32-bit floats, or with TARGET_F16 halves.
#ifdef TARGET_F16
#extension GL_EXT_shader_16bit_storage : require
#extension GL_EXT_shader_explicit_arithmetic_types_float16 : require
#define SAMPLE float16_t
#define TARGET_MAX 65504.0
layout(buffer_reference, std430, buffer_reference_align = 2) writeonly buffer TargetSamples { float16_t v[]; };
#else
#define SAMPLE float
layout(buffer_reference, std430, buffer_reference_align = 4) writeonly buffer TargetSamples { float v[]; };
#endif
#ifndef TARGET_MAX
#define TARGET_MAX 3.402823466e38
#endif
#define TARGET_SAMPLES TargetSamples
