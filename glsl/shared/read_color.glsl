// Radiance of a pixel, as the caller wrote it.
#ifndef IMAGES
// Loaded once: CPU drivers load by an address lane after lane.
Plane color_plane = planes.color;
#endif

vec3 read_color(uvec2 at) {
#ifdef IMAGES
    return texelFetch(color_image, ivec2(at), 0).rgb;
#else
    return float_samples(color_plane, at);
#endif
}
