// The caller's planes: samples of floats or integers with any strides, or images. A row of the table for each
// (src/kernels/planes.rs), written when planes are bound. A kernel that writes one includes target_plane.glsl before.
layout(buffer_reference, std430, buffer_reference_align = 4) readonly buffer Words { uint v[]; };
#ifndef TARGET_SAMPLES
#define TARGET_SAMPLES Words
#endif

struct Plane {
    Words words;          // of images not read
    uint offset;          // in samples, like the strides; of images see image_texel
    uint pixel;
    uint row;
    uint channel;
    uint format;          // 0: there is no such plane
    float scale;          // of depth buffers
    float bias;
};

struct TargetPlane {
    TARGET_SAMPLES samples;
    uint offset;
    uint pixel;
    uint row;
    uint channel;
    uint format;
    float scale;
    float bias;
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

// Of a format: what a sample is; how many lie in a word, as a power of two; the bits of integers.
const uint FORMAT_KIND = 0xffu;
const uint FORMAT_F32 = 1u;
const uint FORMAT_F16 = 2u;
const uint FORMAT_UNORM = 3u;
const uint FORMAT_SHARE_SHIFT = 8u;
const uint FORMAT_WIDTH_SHIFT = 10u;
const uint FORMAT_PACKED = 1u << 16;        // a word has all channels
const uint FORMAT_VARIANCE = 1u << 17;      // what is known of noise
const uint FORMAT_COUNTS = 1u << 18;
const uint FORMAT_HALVED = 1u << 19;        // normals: x * 0.5 + 0.5
const uint FORMAT_OCTAHEDRAL = 1u << 20;
const uint FORMAT_ORTHOGRAPHIC = 1u << 21;  // depth buffers: linear in the distance, or in one over it
const uint FORMAT_PERSPECTIVE = 1u << 22;
const uint FORMAT_REVERSED = 1u << 23;      // 0 is far

const float MAX_FLOAT = 3.402823466e38;

#ifdef IMAGES
#extension GL_EXT_samplerless_texture_functions : require

// Where a pixel is in an image: of a frame that is turned by half a circle counted from the last one back.
ivec2 image_texel(uint column, uint across, uint row, uint down, uvec2 at) {
    return ivec2(column + at.x * across, row + at.y * down);
}

ivec2 image_texel(Plane plane, uvec2 at) {
    return image_texel(plane.offset, plane.pixel, plane.channel, plane.row, at);
}
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

// One load, whatever the format: CPU drivers make both sides of a branch. What lies above the sample's bits is of its
// neighbours.
uint sample_bits(Plane plane, uint index) {
    uint share = plane.format >> FORMAT_SHARE_SHIFT & 3u;
    uint word = plane.words.v[index >> share];
    return word >> (index & (1u << share) - 1u) * (32u >> share);
}

// Of floats.
float float_sample(Plane plane, uint index) {
    uint bits = sample_bits(plane, index);
    return is_half(plane.format) ? unpackHalf2x16(bits).x : uintBitsToFloat(bits);
}

// Of any format.
float any_sample(Plane plane, uint index, uint channel) {
    uint bits = sample_bits(plane, index + channel * plane.channel);
    uint kind = plane.format & FORMAT_KIND;
    if (kind == FORMAT_F32) return uintBitsToFloat(bits);
    if (kind == FORMAT_F16) return unpackHalf2x16(bits).x;
    uint width = plane.format >> FORMAT_WIDTH_SHIFT & 63u;
    if ((plane.format & FORMAT_PACKED) != 0u) bits >>= channel * width;
    if (kind == FORMAT_UNORM) return float(bitfieldExtract(bits, 0, int(width))) / float((1u << width) - 1u);
    float signed_value = float(bitfieldExtract(int(bits), 0, int(width)));
    return max(signed_value / float((1u << (width - 1u)) - 1u), -1.0);
}

vec3 float_samples(Plane plane, uvec2 at) {
    uint index = plane_index(plane, at);
    return vec3(
        float_sample(plane, index),
        float_sample(plane, index + plane.channel),
        float_sample(plane, index + 2u * plane.channel));
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
