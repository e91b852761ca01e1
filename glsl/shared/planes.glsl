// The caller's planes: samples of 32- or 16-bit floats with any strides, or images.
const uint FLAG_COLOR_HALF = 1u << 8;
const uint FLAG_COLOR = 1u << 9;
const uint FLAG_ALBEDO_HALF = 1u << 10;
const uint FLAG_ALBEDO = 1u << 11;
const uint FLAG_NORMAL_HALF = 1u << 12;
const uint FLAG_NORMAL = 1u << 13;
const uint FLAG_DEPTH_HALF = 1u << 14;
const uint FLAG_DEPTH = 1u << 15;

const float MAX_FLOAT = 3.402823466e38;

#ifdef IMAGES
#extension GL_EXT_samplerless_texture_functions : require
#else
layout(buffer_reference, std430, buffer_reference_align = 4) readonly buffer Plane { uint v[]; };

float plane_sample(Plane plane, uint index, bool half_floats) {
    if (!half_floats) return uintBitsToFloat(plane.v[index]);
    vec2 both = unpackHalf2x16(plane.v[index / 2u]);
    return (index & 1u) == 0u ? both.x : both.y;
}
#endif

// By bits: a compiler may assume that NaN and Inf do not occur.
bool is_finite(float x) {
    return (floatBitsToUint(x) & 0x7f800000u) != 0x7f800000u;
}

bvec3 are_finite(vec3 color) {
    return bvec3(is_finite(color.x), is_finite(color.y), is_finite(color.z));
}

bvec3 are_infinite(vec3 color) {
    return equal(floatBitsToUint(color), uvec3(0x7f800000u));
}

float largest_of(vec3 color) {
    return max(color.x, max(color.y, color.z));
}

// Samples below 0 are 0, and so are those that are not finite.
vec3 light_of(vec3 color) {
    return mix(vec3(0.0), max(color, 0.0), are_finite(color));
}

float luminance(vec3 color) {
    return min(dot(color, vec3(0.2126, 0.7152, 0.0722)), MAX_FLOAT);
}
