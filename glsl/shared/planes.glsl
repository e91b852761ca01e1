// The caller's planes: samples of 32- or 16-bit floats with any strides, or images. A row of the table for each
// (src/kernels/planes.rs), written when planes are bound. A kernel that writes one includes target_plane.glsl before.
layout(buffer_reference, std430, buffer_reference_align = 4) readonly buffer Words { uint v[]; };
#ifndef TARGET_SAMPLES
#define TARGET_SAMPLES Words
#endif

struct Plane {
    Words words;          // of images not read, like offset and strides
    uint offset;          // in samples, like the strides
    uint pixel;
    uint row;
    uint channel;
    uint format;          // 0: there is no such plane
};

struct TargetPlane {
    TARGET_SAMPLES samples;
    uint offset;
    uint pixel;
    uint row;
    uint channel;
    uint format;
};

layout(buffer_reference, std430, buffer_reference_align = 8) readonly buffer Planes {
    Plane color;
    Plane albedo;
    Plane normal;
    Plane depth;
    Plane noise;
    TargetPlane result;
};

// Of a signal.
layout(buffer_reference, std430, buffer_reference_align = 8) readonly buffer SignalPlanes {
    Plane plane;
    TargetPlane result;
};

// Of a format: what a sample is, and how many lie in a word, as a power of two.
const uint FORMAT_KIND = 0xffu;
const uint FORMAT_F16 = 2u;
const uint FORMAT_SHARE_SHIFT = 8u;
// What is known of noise.
const uint FORMAT_VARIANCE = 1u << 16;
const uint FORMAT_COUNTS = 1u << 17;

const float MAX_FLOAT = 3.402823466e38;

#ifdef IMAGES
#extension GL_EXT_samplerless_texture_functions : require
#endif

bool is_present(uint format) {
    return format != 0u;
}

bool is_half(uint format) {
    return (format & FORMAT_KIND) == FORMAT_F16;
}

// Where the first channel of a pixel is, in samples.
uint plane_index(Plane plane, uvec2 at) {
    return plane.offset + at.y * plane.row + at.x * plane.pixel;
}

// One load, whatever the format: CPU drivers make both sides of a branch.
float plane_sample(Plane plane, uint index) {
    uint share = plane.format >> FORMAT_SHARE_SHIFT & 3u;
    uint word = plane.words.v[index >> share];
    uint bits = word >> (index & (1u << share) - 1u) * (32u >> share);
    return is_half(plane.format) ? unpackHalf2x16(bits).x : uintBitsToFloat(bits);
}

vec3 plane_samples(Plane plane, uvec2 at) {
    uint index = plane_index(plane, at);
    return vec3(
        plane_sample(plane, index),
        plane_sample(plane, index + plane.channel),
        plane_sample(plane, index + 2u * plane.channel));
}

#ifdef SAMPLE
// The first channel, or all three.
void store_target(TargetPlane plane, uvec2 at, vec3 value, bool all_three) {
    uint index = plane.offset + at.y * plane.row + at.x * plane.pixel;
    plane.samples.v[index] = SAMPLE(value.x);
    if (!all_three) return;
    plane.samples.v[index + plane.channel] = SAMPLE(value.y);
    plane.samples.v[index + 2u * plane.channel] = SAMPLE(value.z);
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
