// Depth of a pixel; 0 for background: non-finite, not above 0, at the far plane of a projection, or as large as
// renderers write for "nothing".
Plane depth_plane = planes.depth;

float read_depth(uvec2 at) {
    uint format = depth_plane.format;
#ifdef IMAGES
    float d = texelFetch(depth_image, image_texel(depth_plane, at), 0).r;
#else
    float d = any_sample(depth_plane, plane_index(depth_plane, at), 0u);
#endif
    bool is_projected = (format & (FORMAT_ORTHOGRAPHIC | FORMAT_PERSPECTIVE)) != 0u;
    if (is_projected) {
        bool is_far = (format & FORMAT_REVERSED) != 0u ? d <= 0.0 : d >= 1.0;
        precise float linear = depth_plane.bias + d * depth_plane.scale;
        d = (format & FORMAT_PERSPECTIVE) != 0u ? 1.0 / linear : linear;
        if (is_far) d = 0.0;
    }
    float background = is_half(format) && !is_projected ? 65000.0 : 1e9;
    return is_finite(d) && d > 0.0 && d < background ? d : 0.0;
}
