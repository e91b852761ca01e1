// Depth of a pixel; 0 for background: non-finite, not above 0, or as large as renderers write for "nothing".
float read_depth(uvec2 at) {
#ifdef IMAGES
    float d = texelFetch(depth_image, ivec2(at), 0).r;
#else
    float d = plane_sample(depth, depth_offset + at.y * depth_row + at.x * depth_pixel, (flags & FLAG_DEPTH_HALF) != 0u);
#endif
    float background = (flags & FLAG_DEPTH_HALF) != 0u ? 65000.0 : 1e9;
    return is_finite(d) && d > 0.0 && d < background ? d : 0.0;
}
