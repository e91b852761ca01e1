// Radiance of a pixel, as the caller wrote it.
// Loaded once: CPU drivers load by an address lane after lane.
Plane color_plane = planes.color;

vec3 read_color(uvec2 at) {
#ifdef IMAGES
    return texelFetch(color_image, image_texel(color_plane, at), 0).rgb;
#else
    return float_samples(color_plane, at);
#endif
}
