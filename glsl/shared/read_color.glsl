// Radiance of a pixel, as the caller wrote it.
vec3 read_color(uvec2 at) {
#ifdef IMAGES
    return texelFetch(color_image, ivec2(at), 0).rgb;
#else
    bool half_floats = (flags & FLAG_COLOR_HALF) != 0u;
    uint index = color_offset + at.y * color_row + at.x * color_pixel;
    return vec3(
        plane_sample(color, index, half_floats),
        plane_sample(color, index + color_channel, half_floats),
        plane_sample(color, index + 2u * color_channel, half_floats));
#endif
}
